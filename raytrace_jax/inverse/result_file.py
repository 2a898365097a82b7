"""A record of a fit as a file: arrays, plain values, and the scene beside them."""

import json
from pathlib import Path
from typing import Any

import cattrs
import jax
import numpy as np

from .._version import __version__
from ..errors import RaytraceError
from ..scene.reader import load_scene
from ..scene.scene import Scene
from ..util.files import StrPath, atomic_write, read_bytes

FILE, SCENE_FILE = "result.npz", "fit.txt"
"""The names of the file and of the scene's beside it, in the folder of a report."""


def save_record(record: object, folder: StrPath) -> None:
    """Write all of a record, a dataclass, but its scene, which `fit.txt` has, into a folder.

    Arrays of more than 1000 numbers are entries of their own. The entry `fields` has all else, as JSON in which NaN and
    Infinity may stand.

    Raises:
        RaytraceError: the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}

    def plain(array: np.ndarray) -> Any:
        if array.size > 1000:
            key = f"array_{len(arrays)}"
            arrays[key] = array
            return {"entry": key}
        return {"dtype": array.dtype.str, "shape": array.shape, "numbers": array.ravel().tolist()}

    converter = cattrs.Converter()
    converter.register_unstructure_hook_func(_is_array, plain)
    converter.register_unstructure_hook(
        Scene, lambda scene: {"dtype": scene.camera.viewpoint.dtype.str, "model": scene.model}
    )
    fields = json.dumps({"version": __version__, "result": converter.unstructure(record)})
    with atomic_write(Path(folder) / FILE) as temporary:
        np.savez(temporary, **arrays, fields=np.array(fields))  # type: ignore[arg-type]


def load_record(folder: StrPath, kind: type[Any]) -> Any:
    """The record of a kind that `save_record` wrote into a folder; its scene is in float32 where JAX computes in that.

    Raises:
        RaytraceError: there is none, it is broken, or another version wrote it.
    """
    # A missing file is told by its own error; what is no archive of ours is broken.
    path = Path(folder) / FILE
    read_bytes(path, count=1)
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = dict(stored)
        kept = json.loads(str(arrays.pop("fields")))
    except (ValueError, KeyError, OSError) as cause:
        raise RaytraceError(f"{path}: is broken: it is not what a fit's report has.") from cause
    if kept.get("version") != __version__:
        raise RaytraceError(f"{path}: was written by version {kept.get('version')}; this is {__version__}.")

    def array(value: Any, _: object) -> np.ndarray:
        if "entry" in value:
            return arrays[value["entry"]]
        return np.array(value["numbers"], value["dtype"]).reshape(value["shape"])

    # As `save_record` wrote it: arrays by their entry or their numbers, the scene from its own file.
    converter = cattrs.Converter()
    converter.register_structure_hook_func(_is_array, array)
    converter.register_structure_hook(
        Scene,
        lambda value, _: load_scene(
            Path(folder) / SCENE_FILE, dtype=jax.dtypes.canonicalize_dtype(value["dtype"]), model=value["model"]
        ),
    )
    try:
        return converter.structure(kept["result"], kind)
    except cattrs.BaseValidationError as cause:
        raise RaytraceError(f"{path}: is broken: {cattrs.transform_error(cause)[0]}") from cause


def _is_array(kind: Any) -> bool:
    return kind is np.ndarray or getattr(kind, "array_type", None) is np.ndarray
