"""A calibration board on a sheet of paper, on a screen, and as the blocks of a scene."""

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from ..errors import RaytraceError
from ..photo.boards import LEAST, Pattern
from ..util.text import PAPERS, PaperName

MARGIN = 10.0
"""Millimetres of paper that many printers cannot print on."""
FOOTER = 12.0
"""Millimetres below the board for the ruler and the line of text, and white between them and the board."""


def paper_room(paper: PaperName) -> tuple[float, float]:
    """The width and height in millimetres that a sheet of paper has for the squares."""
    width, height = PAPERS[paper]
    return width - 2 * MARGIN, height - 2 * MARGIN - FOOTER


def squares_within(
    room: tuple[float, float], side: float, wanted: tuple[int, int] | None, where: str
) -> tuple[int, int]:
    """The columns and rows of squares of such a side: those that are wanted, else as many as there is room for.

    Raises RaytraceError, which says `where` that room is, if there is not so much, or none for `LEAST` squares a side.
    """
    # A length in inches may miss the last square by a rounding.
    columns, rows = (math.floor(length / side + 1e-9) for length in room)
    across, down = wanted or (LEAST, LEAST)
    if across > columns or down > rows:
        raise RaytraceError(f"{across} x {down} squares are too many: {where} has room for {columns} x {rows} squares.")
    return wanted or (columns, rows)


def size_words(pattern: Pattern) -> str:
    sizes = f"{pattern.columns} x {pattern.rows} squares of {pattern.square:.6g} mm, markers {pattern.marker:.6g} mm"
    return f"{sizes}, {pattern.dictionary}"


def draw_sheet(pattern: Pattern, paper: PaperName) -> Figure:
    """Draw a board on a figure of the paper's size, with a ruler and its own description below.

    Its squares must have room (`squares_within`). Save it as it is: `bbox_inches="tight"` would cut the paper. Raises
    RaytraceError without OpenCV.
    """
    width, height = PAPERS[paper]
    figure = Figure(figsize=(width / 25.4, height / 25.4))  # in inches
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set_axis_off()
    ax.set(xlim=(0, width), ylim=(0, height))
    cells = pattern.cells()
    cell = pattern.square / pattern.lattice
    left = (width - cell * cells.shape[1]) / 2
    top = height - MARGIN - (paper_room(paper)[1] - cell * cells.shape[0]) / 2
    # One path for all: where its parts touch, renderers add up their shares of a pixel, and no hairline shows.
    corners = rectangles(cells)[:, [[0, 1], [0, 3], [2, 3], [2, 1]]]
    outline = Outline.make_compound_path_from_polys(np.array([left, top]) + cell * np.array([1, -1]) * corners)
    ax.add_patch(PathPatch(outline, facecolor="black", edgecolor="none", linewidth=0, snap=False))
    ruler, tick = 100.0, 2.0  # millimetres
    # A tick every 10 mm, a longer one every 50; the line of text stands 6 mm above the ruler.
    marks = np.arange(0, ruler + 1, 10)
    pen = {"colors": "black", "linewidths": 0.4, "capstyle": "butt"}
    ax.hlines(MARGIN, MARGIN, MARGIN + ruler, **pen)
    ax.vlines(MARGIN + marks, MARGIN, MARGIN + np.where(marks % 50, tick, 3.0), **pen)
    style = {"fontsize": 8.0, "color": "black", "parse_math": False}
    ax.text(MARGIN + ruler + tick, MARGIN, f"check: {ruler:g} mm", **style)
    ax.text(MARGIN, MARGIN + 6.0, sheet_words(pattern, paper), **style)
    return figure


def sheet_words(pattern: Pattern, paper: PaperName) -> str:
    return f"raytrace-jax board: {size_words(pattern)}, {paper_words(paper)}; print at 100 %"


def paper_words(paper: PaperName) -> str:
    return paper.upper() if paper[0] == "a" else paper


def rectangles(cells: np.ndarray) -> np.ndarray:
    """The black cells, where `cells` is True, as a rectangle for each run of a row: left, top, right, bottom."""
    steps = np.diff(np.pad(cells.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (row, left), (_, right) = np.nonzero(steps > 0), np.nonzero(steps < 0)
    return np.stack([left, row, right, row + 1], axis=1)


def screen_picture(pattern: Pattern, pixels: tuple[int, int], scale: int) -> np.ndarray:
    """A board amid a white screen of `pixels`, in 8-bit grey, `scale` pixels a cell; else as `draw_sheet`."""
    board = pattern_picture(pattern, scale)
    across, down = pixels[0] - board.shape[1], pixels[1] - board.shape[0]
    return np.pad(board, ((down // 2, -(-down // 2)), (across // 2, -(-across // 2))), constant_values=255)


def pattern_picture(pattern: Pattern, scale: int = 4) -> np.ndarray:
    """The pattern alone in 8-bit grey, `scale` pixels a cell of the lattice. Raises RaytraceError without OpenCV."""
    return np.where(pattern.cells(), np.uint8(0), np.uint8(255)).repeat(scale, axis=0).repeat(scale, axis=1)


def board_blocks(pattern: Pattern, texture: str, where: str) -> str:
    """The board as blocks of a scene, in millimetres around its middle, facing +z.

    `texture` is the name of the file with its picture, `where` what it is on, for the comment at the top.
    """
    right, up = (count * pattern.square / 2 for count in (pattern.columns, pattern.rows))
    return (
        f"# A board by `raytrace-jax board`: {size_words(pattern)}, on {where}. Lengths are in millimetres.\n"
        f"texture print {{ kind image file {texture} transfer course }}\n"
        "material board { emission 1 1 1 texture print }\n"
        f"rectangle board {{ material board center 0 0 0 right {right:.12g} 0 0 up 0 {up:.12g} 0 }}\n"
    )
