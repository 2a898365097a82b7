"""How a picture was made, as one text of JSON in its file, whatever the format."""

import json
import os
from collections.abc import Mapping

import jax
import numpy as np

from raytrace_jax.errors import PictureError

KEY = "raytrace_jax"
"""The attribute of an OpenEXR file, and the keyword of a PNG file's text, that holds it."""


def to_json(path: str | os.PathLike[str], metadata: Mapping[str, object]) -> str:
    """Anything JSON can hold, NumPy and JAX numbers and arrays too. Raises PictureError, naming the file, else."""
    try:
        return json.dumps(dict(metadata), allow_nan=False, default=_plain)
    except (TypeError, ValueError) as cause:
        raise PictureError(f"{path}: cannot be written: the metadata cannot be stored as JSON: {cause}") from cause


def _plain(value: object) -> object:
    """Return a NumPy or JAX number or array as Python numbers."""
    if isinstance(value, (np.generic, np.ndarray, jax.Array)):
        return value.tolist()
    raise TypeError(f"{value!r} is a {type(value).__name__}")
