"""The report of a fit: a folder with the estimates, the pictures, the fitted scene, a figure and a page to read."""

import os
from pathlib import Path

from raytrace_jax.images.exr import write_exr
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import how_made
from raytrace_jax.report.fit_report.figure import draw_report
from raytrace_jax.report.fit_report.page import render_page
from raytrace_jax.report.fit_report.summary import as_json, summarize
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.util.files import atomic_write, write_text


def write_report(result: FitResult, folder: str | os.PathLike[str]) -> None:
    """Write the report of a fit into a folder.

    The files are `fit.txt`, `fit.exr`, `residual.exr`, `report.png`, `report.html` and, last of all, `result.json`.
    Each appears only when it is whole, and one of an earlier fit is replaced. `residual.exr` is signed, the fit minus
    the target; a fit that was stopped before it rendered its picture has neither of the two EXR files. `report.html`
    needs no other file and no network. `result.json` has null for what is infinite or not a number.

    Args:
        result: what `fit` returned.
        folder: where to write; it is made if it is missing.

    Raises:
        RaytraceError: the folder or a file in it cannot be written, or a picture holds NaN.
    """
    folder = Path(folder)
    scene_text = format_scene(result.scene, model=result.settings.model)
    metadata = how_made(result.scene, result.settings)
    write_text(folder / "fit.txt", scene_text)
    residual = None if result.image is None else result.image - result.target
    for name, image in (("fit.exr", result.image), ("residual.exr", residual)):
        if image is None:
            (folder / name).unlink(missing_ok=True)  # That of an earlier fit.
        else:
            write_exr(folder / name, dict(zip("RGB", image, strict=True)), metadata=metadata)
    with atomic_write(folder / "report.png") as temporary:
        draw_report(result).savefig(temporary)
    with atomic_write(folder / "report.html") as temporary:
        temporary.write_text(render_page(result, scene_text), encoding="utf-8")
    write_text(folder / "result.json", as_json(summarize(result, scene_text)))
