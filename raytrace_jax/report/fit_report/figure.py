"""A fit's report on one sheet: its pictures, what is left of them, how the search went and how sure it is."""

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.transforms import Bbox
from PIL import Image

from ...inverse.result import FitResult
from ..films import screen_transfer
from ..panels import as_pixels, data_address, draw_signed_values, drawable, letter_panels, png_bytes
from . import curves
from .summary import facts, typeset


class ResidualMap(NamedTuple):
    """Fit minus target in units of 1/255: of each pixel's three differences the largest with its sign.

    Pixels that do not count are masked. The colour scale ends at `limit`; it `extends` if some pixels lie beyond.
    """

    picture: np.ma.MaskedArray
    limit: float
    extends: bool


def residual_of(result: FitResult, image: np.ndarray) -> ResidualMap:
    """The signed residual of a fit's picture, with a scale that a few bright pixels at edges do not spoil."""
    pictures = result.pictures
    difference = np.where(pictures.weights > 0, 255 * (image - pictures.target), 0)
    worst = np.argmax(np.abs(difference), axis=0)[None]
    picture = np.ma.masked_where(~pictures.counts, np.take_along_axis(difference, worst, axis=0)[0])
    sizes = np.abs(picture.compressed())
    if not sizes.size:
        return ResidualMap(picture, 1.0, False)
    limit = float(np.quantile(sizes, 0.995)) or float(sizes.max()) or 1.0
    return ResidualMap(picture, limit, bool(sizes.max() > limit))


def embed(image: Image.Image, colours: int | None = None) -> dict[str, object]:
    """An 8-bit picture on a page, in so few colours if it is one of lines: its data address, its size in pixels."""
    # Pictures above 1600 pixels are reduced: a page has no room for more, and a mail no patience.
    image = image.reduce(-(-max(image.size) // 1600))
    image = image.quantize(colours) if colours else image
    # Pictures below 200 pixels are shown with visible pixels rather than smoothed.
    size = {"width": image.width, "height": image.height, "coarse": image.width < 200}
    return {"address": data_address(png_bytes(image)), **size}


KEY = """\
start dotted, estimate in orange with a band of ± its standard error; Δ is the deviation from the estimate
n/255: n in linear light, of which white is 255; 1.337(2) means 1.337 ± 0.002; levels go from blurred to sharp"""
COLOURS = {
    "converged": "#1a7f37",
    "ambiguous": "#9a6700",
    "degenerate": "#bc4c00",
    "model_incomplete": "#8250df",
    "not_converged": "#cf222e",
    "interrupted": "#57606a",
}
"""The colour of each status, dark enough for white text on it and for text on white."""


class Sheet(NamedTuple):
    """The figure, drawn once in 300 dots an inch; of each group of curves names, remarks and panels cut out of it."""

    figure: Figure
    image: Image.Image
    cut: dict[str, list[tuple[str, str, Image.Image]]]


def draw_report(result: FitResult, long: bool = False) -> Sheet:
    """Draw target, start, fit and residual, the cost, the way of every parameter, the corner plot and profiles."""
    # Wide pictures stand in two rows; all heights are inches.
    _, height, width = result.pictures.target.shape
    picture_columns = 2 if width / height > 2.2 else 4
    picture_height = min(6.0, 10.8 / picture_columns * height / width) + 0.35
    # Beside the corner plot stand all or the ways, three in a row; what is left stands below, at most five in a row.
    corner, drawn = curves.corner_columns(result), _curves(result, long)
    side = 1.6 + 0.7 * len(corner)
    room = 3 * round(side / 2.2) if corner else 0
    beside = drawn if len(drawn) <= room else drawn[: min(1 + len(result.names), room)]
    below = drawn[len(beside) :]
    message = [drawable(line, 150) for line in textwrap.wrap(result.message, 150)]
    heights = [0.45 + 0.15 * len(message) + 4 // picture_columns * picture_height]
    heights += [side] * bool(corner) + [2.2 * math.ceil(len(below) / 5)] * bool(below)
    heights[1] += 0.4

    figure = Figure(figsize=(12.0, 0.25 + sum(heights)), dpi=300, layout="constrained")
    canvas, title = FigureCanvasAgg(figure), result.status.replace("_", " ")
    figure.suptitle(title, fontsize=12, fontweight="bold", color=COLOURS[result.status])
    pictures, *bands = figure.subfigures(len(heights), squeeze=False, height_ratios=heights).ravel()
    told = facts(result)
    (rms, few), typical, steps = told["rms residual"], told["typical residual"][0], told["steps"][0]
    judged = f"rms residual {rms} ({few}), typical {typical}, {steps} steps"
    pictures.suptitle("\n".join([*message, judged]), fontsize=9, parse_math=False)
    no_ticks = {"xticks": [], "yticks": []}
    _draw_pictures(pictures.subplots(4 // picture_columns, picture_columns, subplot_kw=no_ticks).ravel(), result)
    bands[0].suptitle(KEY, fontsize=8, color="0.35")
    shown = []
    if corner:
        left, right = bands[0].subfigures(1, 2, width_ratios=(12 - side, side))
        shown += _draw_curves(left, beside, 3)
        axes = right.subplots(len(corner), len(corner))
        curves.draw_corner(axes, result, corner)
        axes[0, 0].title.set(text="95 % ellipses and densities", x=1)
        right.align_labels()
        shown.append(("ellipses", "", "", axes[np.tril_indices_from(axes)]))
    shown += _draw_curves(bands[-1], below, 5) if below else []
    letter_panels(figure.axes)

    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    cut = {"traces": [], "ellipses": [], "profiles": []}
    for group, name, remark, axes in shown:
        # A page says the title in its own words.
        title, box = axes[0].title.get_window_extent(), Bbox.union([ax.get_tightbbox() for ax in axes])
        box = (round(box.x0), round(image.height - title.y0), round(box.x1), round(image.height - box.y0))
        cut[group].append((name, remark, image.crop(box)))
    return Sheet(figure, image, cut)


def _curves(result: FitResult, long: bool) -> list[tuple[str, str, str, str, Callable[[Axes], None]]]:
    """The panels of curves: group, name and remark of each, its title on the sheet, and what draws it."""
    cost = "cost of each level"
    drawn = [("traces", cost, "", cost, partial(curves.draw_cost, result=result))]
    for k, row in enumerate(result.rows):
        name, line = row.label, typeset(row.text(long))
        draw = partial(curves.draw_trace, result=result, column=k)
        drawn.append(("traces", name, line, f"{drawable(name, 22)}\n{line}", draw))
    for profile in result.profiles:
        remark = curves.interval_text(result, profile)
        draw = partial(curves.draw_profile, result=result, profile=profile)
        drawn.append(("profiles", profile.name, remark, f"profile likelihood\n{remark}", draw))
    return drawn


def _draw_curves(part: SubFigure, drawn: Sequence[tuple], most: int) -> list[tuple[str, str, str, list[Axes]]]:
    """Draw panels of curves in rows of at most so many; group, name, remark and axes of each."""
    rows = math.ceil(len(drawn) / most)
    axes = part.subplots(rows, math.ceil(len(drawn) / rows), squeeze=False).ravel()
    for ax, (*_, title, draw) in zip(axes, drawn, strict=False):
        draw(ax)
        ax.title.set(text=title, parse_math=False)
    for ax in axes[len(drawn) :]:
        ax.set_visible(False)
    return [(*said[:3], [ax]) for ax, said in zip(axes, drawn, strict=False)]


def _draw_pictures(axes: Sequence[Axes], result: FitResult) -> None:
    pictures = result.pictures
    shown = {"target": pictures.target, "start": pictures.start, "fit": pictures.estimate}
    for ax, (name, image) in zip(axes, shown.items(), strict=False):
        if image is not None:
            ax.imshow(as_pixels(image, screen_transfer(result.settings)), interpolation="nearest")
        ax.set_title(name if image is not None else f"{name}: not rendered", fontsize=9)
    axes[3].set_visible(pictures.estimate is not None)
    if pictures.estimate is not None:
        draw_signed_values(axes[3], *residual_of(result, pictures.estimate), "1/255")
        axes[3].set_title("fit − target, worst channel", fontsize=9)
