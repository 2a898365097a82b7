"""The report of a fit: a folder with the estimates, the pictures, the fitted scene and a figure."""

import dataclasses
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from raytrace_jax._files import atomic_write
from raytrace_jax._report_figure import draw_report
from raytrace_jax._version import __version__
from raytrace_jax.errors import RaytraceError
from raytrace_jax.exr import write_exr
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.modelfile import format_scene

LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")


def write_fit(result: FitResult, folder: str | os.PathLike[str]) -> None:
    """Write `fit.txt`, `fit.exr`, `residual.exr`, `report.png` and, last of all, `result.json` into a folder.

    Each file appears only when it is whole, and one of an earlier fit is replaced. `residual.exr` is signed, the fit
    minus the target. `result.json` has null for what is infinite or not a number.

    Args:
        result: what `fit` returned.
        folder: where to write; it is made if it is missing.

    Raises:
        RaytraceError: the folder or a file in it cannot be written, or a picture holds NaN.
    """
    folder = Path(folder)
    scene_text = format_scene(result.scene)
    summary = summarize(result, scene_text)
    how_made = {"scene": scene_text, "settings": summary["settings"], "version": __version__}
    with atomic_write(folder / "fit.txt") as temporary:
        temporary.write_text(scene_text, encoding="utf-8")
    for name, image in (("fit.exr", result.image), ("residual.exr", result.image - result.target)):
        write_exr(folder / name, dict(zip("RGB", image, strict=True)), metadata=how_made)
    with atomic_write(folder / "report.png") as temporary:
        draw_report(result).savefig(temporary)
    with atomic_write(folder / "result.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def summarize(result: FitResult, scene_text: str) -> dict[str, object]:
    """The numbers of a fit as plain, strict JSON values: what is infinite or not a number is None."""
    rows = zip(result.names, result.value, result.initial, result.standard_error, strict=True)
    summary = {
        "status": result.status,
        "message": result.message,
        "parameters": {
            name: {"value": value, "initial": initial, "standard_error": error} for name, value, initial, error in rows
        },
        "correlation": {"names": result.names, "matrix": result.correlation},
        "rms_residual": result.rms_residual,
        "history": [dataclasses.asdict(step) for step in result.history],
        "settings": dataclasses.asdict(result.settings),
        "versions": versions(),
        "scene": scene_text,
    }
    return {key: _strict(value) for key, value in summary.items()}


def versions() -> dict[str, str]:
    """The versions of everything that can change a number of the result."""
    libraries = {name: importlib.metadata.version(name) for name in LIBRARIES}
    return {"raytrace_jax": __version__, **libraries, "python": platform.python_version()}


def _strict(value: object) -> object:
    """Plain Python values, without the NaN and Infinity that JSON does not have."""
    if isinstance(value, Mapping):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(entry) for entry in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if not hasattr(value, "__array__"):
        raise RaytraceError(f"result.json cannot hold {value!r}.")
    return _strict(np.asarray(value).tolist())
