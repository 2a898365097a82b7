"""A contact sheet of many pictures, each above the words that tell it from the others."""

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont, ImageOps

from raytrace_jax.errors import RaytraceError
from raytrace_jax.images.animation import shortened
from raytrace_jax.images.pictures import read_picture
from raytrace_jax.report.panels import as_pixels

LARGEST = 4800
"""The most pixels that the sheet is wide, however many pictures there are."""
LEAST_LABELLED = 80
"""Pixels of a cell; below a narrower one no words can be read."""
GAP, LINE = 6, 15


class LabelledPicture(NamedTuple):
    """A picture's file, and the lines below it; None, or a file that cannot be read, leaves a grey box."""

    path: Path | None
    lines: Sequence[str]


class Layout(NamedTuple):
    """The columns and rows of cells, the box for a picture, and the number of lines of text below it."""

    columns: int
    rows: int
    box: tuple[int, int]
    lines: int

    @property
    def pitch(self) -> tuple[int, int]:
        """The distance from one cell to the next, in pixels to the right and down."""
        return self.box[0] + GAP, self.box[1] + GAP + self.lines * LINE


def layout(count: int, size: tuple[int, int], lines: int, group: int = 1) -> Layout:
    """Cells for pictures of one size with so many lines below and, where these can be read, whole groups in a row."""
    columns = group * max(1, round(math.sqrt(count) / group))
    if group in (1, count) or columns > LARGEST // LEAST_LABELLED:
        columns = math.ceil(math.sqrt(count))
    width = min(max(size[0], 160), 320, LARGEST // columns - GAP)
    # A tall picture is narrower than its cell, so that the sheet stays bounded.
    height = max(1, round(width * min(1.5, size[1] / size[0])))
    shown = min(lines, 4) if width >= LEAST_LABELLED else 0
    return Layout(columns, math.ceil(count / columns), (width, height), shown)


def draw_contact_sheet(cells: Sequence[LabelledPicture], group: int = 1) -> Image.Image:
    """Draw a sheet with a cell for each picture, row by row, `group` of which go together; there is at least one."""
    sizes = [picture.size for cell in cells[:1000] if (picture := _opened(cell.path))]
    largest = max(sizes, key=lambda size: size[1] / size[0], default=(4, 3))
    plan = layout(len(cells), largest, max(len(cell.lines) for cell in cells), group)
    right, down = plan.pitch
    sheet = Image.new("RGB", (plan.columns * right + GAP, plan.rows * down + GAP), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for number, cell in enumerate(cells):
        row, column = divmod(number, plan.columns)
        left, top = GAP + column * right, GAP + row * down
        picture = _opened(cell.path)
        if picture is None:
            draw.rectangle((left, top, left + plan.box[0] - 1, top + plan.box[1] - 1), "#d0d0d0")
        else:
            # As large as fits; the pixels of a small one are seen as squares.
            is_small = picture.width < plan.box[0] and picture.height < plan.box[1]
            way = Image.Resampling.NEAREST if is_small else Image.Resampling.LANCZOS
            sheet.paste(ImageOps.contain(picture, plan.box, way), (left, top))
        for line, text in enumerate(cell.lines[: plan.lines]):
            place = left, top + plan.box[1] + 2 + line * LINE
            draw.text(place, shortened(text, font, plan.box[0]), "black", font)
    return sheet


def _opened(path: Path | None) -> Image.Image | None:
    """A picture as a screen shows it; None where there is none."""
    with contextlib.suppress(RaytraceError):
        return None if path is None else Image.fromarray(as_pixels(read_picture(path), "srgb"))
    return None
