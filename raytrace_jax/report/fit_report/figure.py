"""The figure of a fit's report on one sheet: pictures, what is left of them, how the search went, how sure it is."""

import math
import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.fit_report.certainty import correlated_pairs, draw_ellipse
from raytrace_jax.report.fit_report.pictures import draw_residual
from raytrace_jax.report.fit_report.text import (
    correlation_text,
    drawable,
    estimate_lines,
    in_steps_of_8_bits,
    letter_panels,
)
from raytrace_jax.report.fit_report.traces import draw_cost, draw_trace
from raytrace_jax.report.panels import as_pixels, remove_ticks

WIDTH, LINE_HEIGHT = 12.0, 0.18  # inches
LONGEST_LINE = 150
KEY = "start dotted, estimate in orange with a band of ± its standard error; Δ is the deviation from the estimate"
NOTE = "n/255: n steps of an 8-bit picture; 1.337(2) means 1.337 ± 0.002; levels go from blurred to sharp"
COLOURS = {
    "converged": "#1a7f37",
    "ambiguous": "#9a6700",
    "degenerate": "#bc4c00",
    "model_incomplete": "#8250df",
    "not_converged": "#cf222e",
    "interrupted": "#57606a",
}
"""The colour of each status, dark enough for white text on it and for text on white."""


def draw_report(result: FitResult, long: bool = False) -> Figure:
    """Draw target, start, fit and residual, the cost, the way of every parameter and a row of 95 % ellipses.

    Pictures are shown as the course stores them, linear without gamma. The ellipses are those of the most correlated
    pairs, as many as one row holds. `long` writes estimates as `with_error` does then.
    """
    _, height, width = result.pictures.target.shape
    # Wide pictures stand in two rows.
    picture_columns = 2 if width / height > 2.2 else 4
    picture_rows = 4 // picture_columns
    cell_width = WIDTH / picture_columns
    pictures_height = picture_rows * (min(6.0, 0.9 * cell_width * height / width) + 0.4)

    panels = 1 + len(result.names)
    trace_rows = math.ceil(panels / 5)
    trace_columns = math.ceil(panels / trace_rows)
    pairs = correlated_pairs(result)[:trace_columns]
    message = [drawable(line, LONGEST_LINE) for line in textwrap.wrap(result.message, LONGEST_LINE)]

    # In inches; a row of traces takes 1.75, the legend of the cost 0.25, the row of ellipses 2.1.
    heights = [_title_height(message), pictures_height, trace_rows * 1.75 + 0.55]
    heights += [2.1] if pairs else []
    figure = Figure(figsize=(WIDTH, sum(heights)), dpi=150, layout="constrained")
    parts = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    _draw_title(parts[0], result, message)
    _draw_pictures(parts[1], result, picture_rows, picture_columns)
    _draw_traces(parts[2], result, trace_rows, trace_columns, long)
    if pairs:
        _draw_ellipses(parts[3], result, pairs, trace_columns)
    letter_panels(ax for part in parts for ax in part.axes)
    return figure


def _draw_title(figure: SubFigure, result: FitResult, message: list[str]) -> None:
    # Lines are placed in inches from the top, since the part's height depends on their number.
    inch = 1 / _title_height(message)
    rms, typical = (
        in_steps_of_8_bits(result.pictures.rms_residual),
        in_steps_of_8_bits(result.pictures.typical_residual),
    )
    facts = f"rms residual {rms}, typical {typical}, {len(result.history.steps)} steps"
    lines = [(line, 9, "black") for line in (*message, facts)] + [(KEY, 8, "0.35"), (NOTE, 8, "0.35")]
    status = figure.text(0.5, 1 - 0.17 * inch, result.status.replace("_", " "), fontsize=12, fontweight="bold")
    status.set_color(COLOURS[result.status])
    for i, (line, size, colour) in enumerate(lines):
        text = figure.text(0.5, 1 - (0.42 + LINE_HEIGHT * i) * inch, line, fontsize=size, color=colour)
        text.set_parse_math(False)
    for text in figure.texts:
        text.set(ha="center", va="center")


def _title_height(message: list[str]) -> float:
    return 0.98 + LINE_HEIGHT * len(message)


def _draw_pictures(figure: SubFigure, result: FitResult, rows: int, columns: int) -> None:
    axes = figure.subplots(rows, columns).ravel()
    shown = (("target", result.pictures.target), ("start", result.pictures.start), ("fit", result.pictures.estimate))
    for ax, (name, image) in zip(axes, shown, strict=False):
        if image is not None:
            ax.imshow(as_pixels(image, screen_transfer(result.settings)))
        ax.set_title(name if image is not None else f"{name}: not rendered", fontsize=9)
    if result.pictures.estimate is None:
        _hide(axes[3:4])
    else:
        draw_residual(axes[3], result, result.pictures.estimate)
        axes[3].set_title("fit − target, worst channel", fontsize=9)
    remove_ticks(axes)


def _draw_traces(figure: SubFigure, result: FitResult, rows: int, columns: int, long: bool) -> None:
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    panels = 1 + len(result.names)
    draw_cost(axes[0], result, "cost of each level")
    for column, (name, line) in enumerate(zip(result.names, estimate_lines(result, long), strict=True)):
        draw_trace(axes[1 + column], result, column)
        title = f"{drawable(name, 24)}\n{line}"
        axes[1 + column].set_title(title, fontsize=9, parse_math=False)
    # The lowest panel of each column names the axis that the column shares.
    for ax in axes[: max(0, panels - columns)]:
        ax.set_xlabel("")
    for ax in axes[max(0, panels - columns) : panels]:
        ax.tick_params(labelbottom=True)
    _hide(axes[panels:])


def _draw_ellipses(figure: SubFigure, result: FitResult, pairs: list[tuple[int, int]], columns: int) -> None:
    axes = figure.subplots(1, columns, squeeze=False).ravel()
    for ax, pair in zip(axes, pairs, strict=False):
        draw_ellipse(ax, result, pair)
        correlation = correlation_text(float(result.total_correlation[pair]))
        ax.set_title(f"95 % ellipse\ncorrelation {correlation}", fontsize=9)
    _hide(axes[len(pairs) :])


def _hide(axes: np.ndarray) -> None:
    for ax in axes:
        assert isinstance(ax, Axes)
        ax.set_visible(False)
