"""Any of our values as strict JSON: what is infinite or not a number is null."""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from raytrace_jax.errors import RaytraceError


def json_text(value: object, *, indent: int | None = 2) -> str:
    """The JSON text of a value, as `strict` has it, with a line end.

    Raises:
        RaytraceError: there is something that JSON cannot hold.
    """
    return json.dumps(strict(value), indent=indent, allow_nan=False) + "\n"


def strict(value: object) -> object:
    """Plain Python values, without the NaN and Infinity that JSON does not have; arrays are lists, paths are texts.

    Raises:
        RaytraceError: there is something that JSON cannot hold.
    """
    if isinstance(value, Mapping):
        return {key: strict(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [strict(entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if not hasattr(value, "__array__"):
        raise RaytraceError(f"JSON cannot hold {value!r}.")
    return strict(np.asarray(value).tolist())
