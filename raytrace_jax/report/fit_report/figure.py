"""A fit's report on one sheet: its pictures, what is left of them, how the search went and how sure it is."""

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.transforms import Bbox
from PIL import Image

from ...inverse.result import FitResult
from ..films import screen_transfer
from ..panels import as_pixels, data_address, draw_signed_values, drawable, letter_panels, png_bytes, remove_ticks
from . import curves
from .summary import facts, typeset


class ResidualMap(NamedTuple):
    """Fit minus target in units of 1/255: of each pixel's three differences the largest with its sign.

    Pixels that do not count are masked. The colour scale ends at `limit`; it `extends` if some pixels lie beyond.
    """

    picture: np.ma.MaskedArray
    limit: float
    extends: bool


def residual_of(result: FitResult) -> ResidualMap | None:
    """The signed residual of a fit's picture, with a scale that a few bright pixels at edges do not spoil."""
    if result.image is None:
        return None
    difference = np.where(result.weights > 0, 255 * (result.image - result.target), 0)
    worst = np.argmax(np.abs(difference), axis=0)[None]
    picture = np.ma.masked_where(~result.counts, np.take_along_axis(difference, worst, axis=0)[0])
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
    width, height = image.size
    # Pictures below 200 pixels are shown with visible pixels rather than smoothed.
    return {"address": data_address(png_bytes(image)), "width": width, "height": height, "coarse": width < 200}


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
    # Beside the corner plot stand all or the ways, three in a row; what is left stands below, at most five in a row.
    corner, drawn = curves.corner_columns(result), _curves(result, long)
    side = 1.6 + 0.7 * len(corner)
    room = 3 * round(side / 2.2) if corner else 0
    beside = drawn if len(drawn) <= room else drawn[: min(1 + len(result.names), room)]
    below = drawn[len(beside) :]
    message = [drawable(line, 150) for line in textwrap.wrap(result.message, 150)]
    views, steps = result.views, facts(result)["steps"][0]
    message += [_judged(view, camera if len(views) > 1 else "") for camera, view in views.items()]
    message[-1:] = [f"{message[-1]}, {steps} steps"] if len(views) == 1 else [message[-1], f"{steps} steps"]
    places = [_picture_places(view) for view in views.values()]
    heights = [rows * height for rows, _, height in places]
    heights[0] += 0.3 + 0.15 * len(message)
    heights += [side] * bool(corner) + [2.2 * math.ceil(len(below) / 5)] * bool(below)
    heights[len(views)] += 0.4

    figure = Figure(figsize=(12.0, 0.25 + sum(heights)), dpi=300, layout="constrained")
    canvas, title = FigureCanvasAgg(figure), result.status.replace("_", " ")
    figure.suptitle(title, fontsize=12, fontweight="bold", color=COLOURS[result.status])
    parts = figure.subfigures(len(heights), squeeze=False, height_ratios=heights).ravel()
    parts[0].suptitle("\n".join(message), fontsize=9, parse_math=False)
    for part, (camera, view), (rows, columns, _) in zip(parts, views.items(), places, strict=False):
        axes = part.subplots(rows, columns).ravel()
        remove_ticks(axes)
        _draw_pictures(axes, view, f"{drawable(camera, 16)}: " if len(views) > 1 else "")
    bands = parts[len(views) :]
    bands[0].suptitle(KEY, fontsize=8, color="0.35")
    shown = []
    with matplotlib.rc_context(curves.STYLE):
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
        left, right, top, bottom = map(round, (box.x0, box.x1, image.height - title.y0, image.height - box.y0))
        cut[group].append((name, remark, image.crop((left, top, right, bottom))))
    return Sheet(figure, image, cut)


def _judged(view: FitResult, camera: str) -> str:
    """What the residual of a view says of its fit, in a line."""
    numbers = facts(view)
    (rms, few), typical = numbers["rms residual"], numbers["typical residual"][0]
    return f"{drawable(camera, 16)}{': ' * bool(camera)}rms residual {rms} ({few}), typical {typical}"


def _picture_places(view: FitResult) -> tuple[int, int, float]:
    """Rows and columns of a view's four pictures, and the height of a row in inches; wide ones stand in two rows."""
    _, height, width = view.target.shape
    columns = 2 if width / height > 2.2 else 4
    return 4 // columns, columns, min(6.0, 10.8 / columns * height / width) + 0.35


def _curves(result: FitResult, long: bool) -> list[tuple[str, str, str, Callable[[Axes], None]]]:
    """The panels of curves: group, name and remark of each, and what draws it."""
    drawn = [("traces", "cost of each level", "", partial(curves.draw_cost, result=result))]
    for k, row in enumerate(result.parameters.values()):
        draw = partial(curves.draw_trace, result=result, column=k)
        drawn.append(("traces", row.label, typeset(row.text(long)), draw))
    for profile in result.profiles:
        draw = partial(curves.draw_profile, result=result, profile=profile)
        drawn.append(("profiles", profile.name, curves.interval_text(result, profile), draw))
    return drawn


def _draw_curves(part: SubFigure, drawn: Sequence[tuple], most: int) -> list[tuple[str, str, str, list[Axes]]]:
    """Draw panels of curves in rows of at most `most`; returns group, name, remark and axes of each."""
    rows = math.ceil(len(drawn) / most)
    axes = part.subplots(rows, math.ceil(len(drawn) / rows), squeeze=False).ravel()
    for ax in axes[len(drawn) :]:
        ax.set_visible(False)
    shown = []
    for ax, (group, name, remark, draw) in zip(axes, drawn, strict=False):
        draw(ax)
        heading = drawable(name, 22) if group == "traces" else "profile likelihood"
        ax.title.set_text(f"{heading}\n{remark}".strip())
        shown.append((group, name, remark, [ax]))
    return shown


def _draw_pictures(axes: Sequence[Axes], result: FitResult, camera: str) -> None:
    shown, residual = screen_pictures(result), residual_of(result)
    for ax, name in zip(axes, ("target", "start", "fit"), strict=False):
        if name in shown:
            ax.imshow(shown[name], interpolation="nearest")
        ax.set_title(camera + (name if name in shown else f"{name}: not rendered"), fontsize=9)
    axes[3].set_visible(residual is not None)
    if residual is not None:
        draw_signed_values(axes[3], *residual, "1/255")
        axes[3].set_title(f"{camera}fit − target, worst channel", fontsize=9)


def screen_pictures(result: FitResult) -> dict[str, np.ndarray]:
    """The 8-bit pixels of target, start and fit; a fit that was stopped has not rendered all."""
    images = {"target": result.target, "start": result.start_image, "fit": result.image}
    return {
        name: as_pixels(image, screen_transfer(result.settings)) for name, image in images.items() if image is not None
    }
