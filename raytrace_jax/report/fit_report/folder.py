"""The report of a fit: a folder with the estimates, the pictures, the fitted scene, a figure and a page to read."""

import contextlib
import os
from pathlib import Path

from raytrace_jax.images.exr import write_exr
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import how_made
from raytrace_jax.report.fit_report.figure import draw_report
from raytrace_jax.report.fit_report.page import render_page
from raytrace_jax.report.fit_report.summary import summarize
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.util.files import atomic_write, write_text
from raytrace_jax.util.json_text import json_text

PICTURES = ("fit.exr", "residual.exr", "report.png", "report.html")
"""All files but the numbers, which are small and come first."""


def write_report(result: FitResult, folder: str | os.PathLike[str]) -> None:
    """Write the report of a fit into a folder.

    The files are `result.json` and `fit.txt`, and then `fit.exr`, `residual.exr`, `report.png` and `report.html`.
    Each appears only when it is whole, and one of an earlier fit is replaced. `residual.exr` is signed, the fit minus
    the target; a fit that was stopped before it rendered its picture has neither of the two EXR files. `report.html`
    needs no other file and no network. `result.json` has null for what is infinite or not a number.

    Args:
        result: what `fit` returned.
        folder: where to write; it is made if it is missing.

    Raises:
        RaytraceError: the folder or a file in it cannot be written, or a picture holds NaN.
    """
    write_numbers(result, folder)
    write_pictures(result, folder)


def write_numbers(result: FitResult, folder: str | os.PathLike[str]) -> str:
    """Write `result.json`, whose text is returned, and `fit.txt`, and take away pictures of an earlier fit."""
    folder, scene_text = Path(folder), format_scene(result.scene, model=result.settings.model)
    for name in PICTURES:
        with contextlib.suppress(OSError):  # One that cannot be removed cannot be replaced, which is told then.
            (folder / name).unlink()
    text = json_text(summarize(result, scene_text))
    write_text(folder / "result.json", text)
    write_text(folder / "fit.txt", scene_text)
    return text


def write_pictures(result: FitResult, folder: str | os.PathLike[str]) -> None:
    """Write all but the numbers; as `write_report`."""
    folder, scene_text = Path(folder), format_scene(result.scene, model=result.settings.model)
    metadata = how_made(result.scene, result.settings)
    residual = None if result.image is None else result.image - result.target
    for name, image in (("fit.exr", result.image), ("residual.exr", residual)):
        if image is not None:
            write_exr(folder / name, dict(zip("RGB", image, strict=True)), metadata=metadata)
    with atomic_write(folder / "report.png") as temporary:
        draw_report(result).savefig(temporary)
    with atomic_write(folder / "report.html") as temporary:
        temporary.write_text(render_page(result, scene_text), encoding="utf-8")
