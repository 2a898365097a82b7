"""A fit's report on one sheet shows its pictures, what is left of them, how the search went and how sure it is."""

import io
import math
import textwrap
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.fit_report import curves
from raytrace_jax.report.fit_report.summary import correlation_text, estimate_lines, in_steps_of_8_bits
from raytrace_jax.report.panels import (
    as_pixels,
    data_address,
    draw_signed_values,
    drawable,
    letter_panels,
    remove_ticks,
)


class ResidualMap(NamedTuple):
    """Fit minus target in units of 1/255: of each pixel's three differences the largest with its sign.

    Pixels that do not count are masked. The colour scale ends at `limit`; it `extends` if some pixels lie beyond.
    """

    picture: np.ma.MaskedArray
    limit: float
    extends: bool


def residual_of(result: FitResult, image: np.ndarray) -> ResidualMap:
    """The signed residual of a fit's picture, with a scale that a few bright pixels at edges do not spoil."""
    difference = 255 * (image - result.pictures.target)
    worst = np.argmax(np.abs(difference), axis=0)[None]
    picture = np.ma.masked_where(result.pictures.weights == 0, np.take_along_axis(difference, worst, axis=0)[0])
    sizes = np.abs(picture.compressed())
    if not sizes.size:
        return ResidualMap(picture, 1.0, False)
    limit = float(np.quantile(sizes, 0.995)) or float(sizes.max()) or 1.0
    return ResidualMap(picture, limit, bool(sizes.max() > limit))


class Embedded(NamedTuple):
    """An image of a page: its data address, its size in pixels, and whether its pixels are to stay visible."""

    address: str
    width: int
    height: int
    coarse: bool = False


def embed(image: Image.Image, colours: int | None = None) -> Embedded:
    """Embed an 8-bit picture, in so few colours if it is one of lines."""
    # Pictures above 1600 pixels are reduced: a page has no room for more, and a mail no patience.
    image = image.reduce(-(-max(image.size) // 1600))
    image = image.quantize(colours) if colours else image
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=1)
    # Pictures below 200 pixels are shown with visible pixels rather than smoothed.
    return Embedded(data_address(file.getvalue()), *image.size, coarse=image.width < 200)


WIDTH, LINE_HEIGHT = 12.0, 0.18  # inches
KEY = "start dotted, estimate in orange with a band of ± its standard error; Δ is the deviation from the estimate"
NOTE = "n/255: n in linear light, of which white is 255; 1.337(2) means 1.337 ± 0.002; levels go from blurred to sharp"
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
    """Draw target, start, fit and residual, the cost, the way of every parameter, ellipses and profiles.

    Pictures are shown as the course stores them, linear without gamma. `long` writes estimates as `with_error` does
    then.
    """
    _, height, width = result.pictures.target.shape
    # Wide pictures stand in two rows.
    picture_columns = 2 if width / height > 2.2 else 4
    cell_width = (WIDTH - 0.6) / picture_columns  # Beside the last stands its scale.
    picture_height = min(6.0, 0.9 * cell_width * height / width) + 0.4

    drawn = _curves(result, long)
    rows = math.ceil(len(drawn) / 5)
    columns = math.ceil(len(drawn) / rows)
    # Two lines of a title, or one and the legend of the cost, stand above a panel of curves.
    above = max(0.52, (18 + 10 * curves.legend_rows(result)) / 72)
    row_height = above + 1.65
    message = [drawable(line, 150) for line in textwrap.wrap(result.message, 150)]
    title_height = 0.98 + LINE_HEIGHT * len(message)
    pictures_height = 4 // picture_columns * picture_height
    total = title_height + pictures_height + row_height * rows

    # A layout in inches from the top left is known beforehand; one that measures all labels takes longer than drawing.
    figure = Figure(figsize=(WIDTH, total), dpi=300)
    canvas = FigureCanvasAgg(figure)

    def axes(left: float, top: float, width: float, height: float) -> Axes:
        return figure.add_axes((left / WIDTH, 1 - (top + height) / total, width / WIDTH, height / total))

    _draw_title(figure, result, message, total)
    pictures = []
    for k in range(4):
        row, column = divmod(k, picture_columns)
        place = (column * cell_width + 0.05, title_height + row * picture_height + 0.3)
        pictures.append(axes(*place, cell_width - 0.1, picture_height - 0.4))
    _draw_pictures(pictures, result)
    size = (WIDTH / columns - 0.7, row_height - above - 0.42)
    corners = [
        (k % columns * WIDTH / columns, title_height + pictures_height + k // columns * row_height)
        for k in range(len(drawn))
    ]
    panels = [axes(left + 0.6, top + above, *size) for left, top in corners]
    for ax, (_, _, _, title, draw) in zip(panels, drawn, strict=True):
        draw(ax)
        ax.title.set(text=title, parse_math=False)
        ax.xaxis.set_label_coords(0.5, -0.25 / size[1])
        # A long name ends at the panel's upper end: what is cut out begins there.
        ax.yaxis.set_label_coords(-0.44 / size[0], 1.0)
        ax.yaxis.label.set(horizontalalignment="right", fontsize=7)
    letter_panels(figure.axes)

    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    cut = {"traces": [], "ellipses": [], "profiles": []}
    for ax, (left, top), (group, name, remark, *_) in zip(panels, corners, drawn, strict=True):
        # A page says the title in its own words.
        upper = round(image.height - ax.title.get_window_extent().y0)
        box = (round(300 * left), upper, round(300 * (left + WIDTH / columns)), round(300 * (top + row_height)))
        cut[group].append((name, remark, image.crop(box)))
    return Sheet(figure, image, cut)


def _curves(result: FitResult, long: bool) -> list[tuple[str, str, str, str, Callable[[Axes], None]]]:
    """The panels of curves: group, name and remark of each, its title on the sheet, and what draws it."""
    cost = "cost of each level"
    drawn = [("traces", cost, "", cost, partial(curves.draw_cost, result=result))]
    for k, (name, line) in enumerate(zip(result.labels, estimate_lines(result, long), strict=True)):
        draw = partial(curves.draw_trace, result=result, column=k)
        drawn.append(("traces", name, line, f"{drawable(name, 24)}\n{line}", draw))
    for pair in curves.shown_pairs(result):
        remark = f"correlation {correlation_text(float(result.total_correlation[pair]))}"
        draw = partial(curves.draw_ellipse, result=result, pair=pair)
        name = " and ".join(result.labels[k] for k in pair)
        drawn.append(("ellipses", name, remark, f"95 % ellipse\n{remark}", draw))
    for profile in result.profiles:
        remark = curves.interval_text(result, profile)
        draw = partial(curves.draw_profile, result=result, profile=profile)
        drawn.append(("profiles", profile.name, remark, f"profile likelihood\n{remark}", draw))
    return drawn


def _draw_title(figure: Figure, result: FitResult, message: list[str], height: float) -> None:
    rms = in_steps_of_8_bits(result.pictures.rms_residual)
    typical = in_steps_of_8_bits(result.pictures.typical_residual)
    facts = f"rms residual {rms}, typical {typical}, {len(result.history.steps)} steps"
    lines = [(line, 9, "black") for line in (*message, facts)] + [(KEY, 8, "0.35"), (NOTE, 8, "0.35")]
    looks = {"ha": "center", "va": "center", "parse_math": False}
    status, colour = result.status.replace("_", " "), COLOURS[result.status]
    figure.text(0.5, 1 - 0.17 / height, status, fontsize=12, fontweight="bold", color=colour, **looks)
    for i, (line, size, colour) in enumerate(lines):
        figure.text(0.5, 1 - (0.42 + LINE_HEIGHT * i) / height, line, fontsize=size, color=colour, **looks)


def _draw_pictures(axes: list[Axes], result: FitResult) -> None:
    shown = (("target", result.pictures.target), ("start", result.pictures.start), ("fit", result.pictures.estimate))
    for ax, (name, image) in zip(axes, shown, strict=False):
        if image is not None:
            ax.imshow(as_pixels(image, screen_transfer(result.settings)), interpolation="nearest")
        ax.set_title(name if image is not None else f"{name}: not rendered", fontsize=9, y=1.0)
    if result.pictures.estimate is None:
        axes[3].set_visible(False)
    else:
        residual = residual_of(result, result.pictures.estimate)
        draw_signed_values(axes[3], residual.picture, residual.limit, residual.extends, "1/255")
        axes[3].set_title("fit − target, worst channel", fontsize=9, y=1.0)
    remove_ticks(axes)
