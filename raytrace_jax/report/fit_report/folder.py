"""The report of a fit: a folder with the estimates, pictures, the fitted scene, a figure and a page to read."""

import os
from pathlib import Path

import matplotlib

from ...images.exr import write_exr
from ...inverse.result import FitResult
from ...inverse.result_file import SCENE_FILE, save_record
from ...util.files import atomic_write, read_bytes, write_text
from ..films import how_made
from .figure import draw_report
from .methods import methods_text
from .numbers import write_numbers
from .page import render_page
from .summary import csv_table, tex_table

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
    if (image := result.pictures.estimate) is not None:
        write_exr(folder / "fit.exr", image, metadata=metadata)
        write_exr(folder / "residual.exr", image - result.pictures.target, metadata=metadata)
    save_record(result, folder)
    for name, text in TEXTS.items():
        write_text(folder / name, text(result, long))
    with atomic_write(folder / "report.png") as temporary:
        sheet = draw_report(result, long)
        sheet.image.reduce(2).save(temporary, "PNG", compress_level=1)
    if pdf:
        # Journals want fonts of type 42, which is TrueType; without a date the same fit gives the same file.
        with atomic_write(folder / "report.pdf") as temporary, matplotlib.rc_context({"pdf.fonttype": 42}):
            sheet.figure.savefig(temporary, metadata={"CreationDate": None})
    with atomic_write(folder / "report.html") as temporary:
        temporary.write_text(render_page(result, scene_text, sheet, long), encoding="utf-8")
