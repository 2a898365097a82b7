"""The numbers of a fit as files, which need no matplotlib: they come first, before the pictures."""

import contextlib
import os

from ...inverse.result import FitResult
from ...inverse.result_file import FILE, SCENE_FILE
from ...scene.writer import save_scene
from ...util.files import as_path, json_text, write_text
from .summary import summarize

REST = (FILE, "fit.exr", "residual.exr", "estimates.csv", "estimates.tex", "methods.txt")
REST += ("report.png", "report.pdf", "report.html")
"""All files of a report but the numbers, which are small and come first."""


def write_numbers(result: FitResult, folder: str | os.PathLike[str], comments: str = "") -> str:
    """Write `result.json`, whose text is returned, and `fit.txt`, and take away pictures of an earlier fit.

    `comments` is the text of a scene's file whose comments are kept.
    """
    folder = as_path(folder)
    for name in REST:
        with contextlib.suppress(OSError):  # One that cannot be removed cannot be replaced, which is told then.
            (folder / name).unlink()
    scene_text = save_scene(result.scene, folder / SCENE_FILE, model=result.settings.model, comments=comments)
    text = json_text(summarize(result, scene_text))
    write_text(folder / "result.json", text)
    return text
