"""A result as a file, and as text."""

import html
import json
import os
from pathlib import Path
from typing import Any

import cattrs
import jax
import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.errors import RaytraceError
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.scene.reader import load_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.digits import value_and_error, with_error
from raytrace_jax.util.files import atomic_write, read_bytes
from raytrace_jax.util.text import aligned

Rows = list[tuple[str, ...]]


def estimate_rows(result: FitResult, long: bool = False) -> tuple[list[str], Rows]:
    """The heads and rows of a table of the estimates: name, start, estimate with the error to publish, and its parts.

    `long` writes `1.337 +- 0.002` in place of `1.337(2)`.
    """
    # The parts are shown only if there are several, and no error at all if none is known.
    parts = {}
    if np.any(result.systematic_error > 0):
        parts = {"of noise": result.standard_error, "of the model": result.systematic_error}
    is_unknown = np.all(np.isnan(result.standard_error))
    rows = []
    for k, name in enumerate(result.labels):
        value, error = float(result.value[k]), float(result.total_error[k])
        shown = f"{value:.8g}" if is_unknown else with_error(value, error, long)
        texts = [value_and_error(0.0, float(part[k]))[1] for part in parts.values() if not is_unknown]
        rows.append((name, f"{result.initial[k]:.8g}", shown, *texts))
    return ["parameter", "initial", "estimate", *({} if is_unknown else parts)], rows


def last_word(result: FitResult) -> str:
    """The fit's ending, its reason, advice, and what the answer rests on, a sentence each."""
    sentences = f"{result.status}: {result.message}", as_sentence(result.advice), as_sentence(result.rests_on)
    return " ".join(f"{words.rstrip('.')}." for words in sentences if words)


def as_sentence(words: str) -> str:
    """Words with a capital letter, unless they begin with a name."""
    return words if "." in words.partition(" ")[0] else words[:1].upper() + words[1:]


def summary(result: FitResult) -> str:
    """The estimates, a line each, and the last word."""
    heads, rows = estimate_rows(result)
    return "\n".join([*aligned([heads, *rows]), last_word(result)])


def as_html(result: FitResult) -> str:
    """The estimates as a table of HTML, and the last word, for a notebook."""
    heads, rows = estimate_rows(result)
    cells = [[f"<th>{html.escape(text)}</th>" for text in heads]]
    cells += [[f"<td>{html.escape(text)}</td>" for text in row] for row in rows]
    table = "".join(f"<tr>{''.join(row)}</tr>" for row in cells)
    return f"<table>{table}</table><p>{html.escape(last_word(result))}</p>"


FILE, SCENE_FILE = "result.npz", "fit.txt"
"""The names of the file and of the scene's beside it, in the folder of a report."""


def save_result(result: FitResult, folder: str | os.PathLike[str]) -> None:
    """Write all of a result but its scene, which `fit.txt` has, into a folder.

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
    fields = json.dumps({"version": __version__, "result": converter.unstructure(result)})
    with atomic_write(Path(folder) / FILE) as temporary:
        np.savez(temporary, **arrays, fields=np.array(fields))  # type: ignore[arg-type]


def load_result(folder: str | os.PathLike[str]) -> FitResult:
    """The result whose report lies in a folder; its scene is in float32 where JAX computes in that.

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

    # As `save_result` wrote it: arrays by their entry or their numbers, the scene from its own file.
    converter = cattrs.Converter()
    converter.register_structure_hook_func(_is_array, array)
    converter.register_structure_hook(
        Scene,
        lambda value, _: load_scene(
            Path(folder) / SCENE_FILE, dtype=jax.dtypes.canonicalize_dtype(value["dtype"]), model=value["model"]
        ),
    )
    try:
        return converter.structure(kept["result"], FitResult)
    except cattrs.BaseValidationError as cause:
        raise RaytraceError(f"{path}: is broken: {cattrs.transform_error(cause)[0]}") from cause


def _is_array(kind: Any) -> bool:
    """Whether a type is an array's, or jaxtyping's of one."""
    return kind is np.ndarray or getattr(kind, "array_type", None) is np.ndarray
