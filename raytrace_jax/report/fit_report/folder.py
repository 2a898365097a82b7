"""The report of a fit: a folder with estimates, pictures, scene and figure, and a page that needs no other file."""

import math
import os
import re
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from ...images.exr import write_exr
from ...inverse.judge.model_check import WHAT_IF
from ...inverse.judge.structure import EVIDENCE
from ...inverse.result import FitResult, Minimum
from ...inverse.result_file import SCENE_FILE, save_record
from ...util.files import atomic_write, read_bytes, write_text
from ..films import how_made
from ..panels import SIGNED, page_template, save_figure, signed_pixels
from . import summary
from .curves import corner_columns
from .figure import COLOURS, ResidualMap, Sheet, draw_report, embed, residual_of, screen_pictures
from .methods import methods_text
from .summary import csv_table, tex_table, write_numbers

TEXTS = {"estimates.csv": csv_table, "estimates.tex": tex_table, "methods.txt": methods_text}


def write_report(result: FitResult, folder: str | os.PathLike[str], long: bool = False, pdf: bool = False) -> None:
    """Write the report of a fit into a folder: what `FitResult.save` says."""
    write_numbers(result, folder)
    write_pictures(result, folder, long, pdf)


def write_pictures(result: FitResult, folder: str | os.PathLike[str], long: bool = False, pdf: bool = False) -> None:
    """Write all but the numbers, which are there; as `write_report`."""
    folder = Path(folder)
    scene_text = read_bytes(folder / SCENE_FILE).decode()
    metadata = how_made(scene_text, result.settings)  # A texture that came as numbers has its file in that text alone.
    for end, view in summary.views_of(result).items():
        if (image := view.image) is not None:
            seen = {"camera": view.scene.camera.name} if end else {}
            write_exr(folder / f"fit{end}.exr", image, metadata=metadata | seen)
            write_exr(folder / f"residual{end}.exr", image - view.target, metadata=metadata | seen)
    save_record(result, folder)
    for name, text in TEXTS.items():
        write_text(folder / name, text(result, long))
    with atomic_write(folder / "report.png") as temporary:
        sheet = draw_report(result, long)
        sheet.image.reduce(2).save(temporary, "PNG", compress_level=1)
    if pdf:
        # Journals want fonts of type 42, which is TrueType; without a date the same fit gives the same file.
        with matplotlib.rc_context({"pdf.fonttype": 42}):
            save_figure(folder / "report.pdf", sheet.figure, metadata={"CreationDate": None})
    with atomic_write(folder / "report.html") as temporary:
        temporary.write_text(render_page(result, scene_text, sheet, long), encoding="utf-8")


def provenance_rows(result: FitResult) -> list[tuple[str, str]]:
    """The origin of a fit: its target, command, date and time."""
    labels = {
        "target": "target",
        "target_size": "its size [pixels]",
        "target_bytes": "its file [bytes]",
        "target_sha256": "SHA-256 of it",
        "command": "command",
        "date": "date",
        "seconds": "time to the last step [s]",
        "stages": "time by stage",
    }
    known = summary.provenance_of(result)
    stages = "; ".join(f"{stage}: {seconds:.3g} s" for stage, seconds in known["stages"].items())
    sizes = [summary.facts(view)["pixels"][0] + summary.place_words(view) for view in result.views.values()]
    known |= {"target_size": ", ".join(sizes), "stages": stages or "none"}
    labels |= {name: name.replace("_", " ") for name in known if name not in labels}
    return [(label, known[name]) for name, label in labels.items() if name in known]


def setting_text(value: object) -> str:
    """A setting in a user's words."""
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return "not set" if value is None else str(value)


def _embedded_pictures(view: FitResult) -> tuple[list[tuple[str, dict[str, object]]], ResidualMap | None]:
    """The pictures of a view by their captions, and the residual that the last of them shows, if there is one."""
    images, residual = screen_pictures(view), residual_of(view)
    if residual is not None:
        images["fit − target"] = signed_pixels(residual.picture, residual.limit)
    return [(name, embed(Image.fromarray(pixels))) for name, pixels in images.items()], residual


def render_page(result: FitResult, scene_text: str, sheet: Sheet, long: bool = False) -> str:
    """The report of a fit as the text of one HTML file; `long` writes estimates as `with_error` does then."""
    filters = {"number": summary.number_text, "error": summary.error_text, "typeset": summary.typeset}
    filters["correlation"] = summary.correlation_text
    # Lines may break behind a name's dots and underscores, but not before a last letter.
    filters["pieces"] = re.compile("(?<=[._])(?=..)").split
    template = page_template("report/fit_report/page.html.jinja", filters)
    known = np.isfinite(result.standard_error)
    estimate = Minimum(result.candidate, result.value, result.rms_residual, 0, True, math.nan)
    used = {"loss": result.loss} | summary.used_settings(result.settings)
    return template.render(
        {group: [(*said, embed(image, 64)) for *said, image in cut] for group, cut in sheet.cut.items()},
        result=result,
        corner=[result.labels[k] for k in corner_columns(result)],
        long=long,
        colour=COLOURS[result.status],
        summary=summary,
        views={camera: (view, *_embedded_pictures(view)) for camera, view in result.views.items()},
        stops=[f"rgb({r}, {g}, {b})" for r, g, b, _ in SIGNED(np.linspace(0, 1, 11), bytes=True)],
        correlation=np.where(known & known[:, None], result.uncertainty.correlation, np.nan).tolist(),
        what_if=WHAT_IF,
        minima=[estimate, *result.runner_ups[:5]],
        convincing=EVIDENCE,
        settings=[(name.replace("_", " "), setting_text(value)) for name, value in used.items()],
        provenance=provenance_rows(result),
        uncounted=not all(view.counts.all() for view in result.views.values()),
        alone=summary.alone_table(result, long),
        methods=methods_text(result, long),
        scene=scene_text,
    )
