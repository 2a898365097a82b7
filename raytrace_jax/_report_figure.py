"""The figure of a fit's report: the pictures, what is left of them, and how the search went."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from raytrace_jax._estimates import value_and_error
from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.png import encode_course

WIDTH = 12.0  # inches, at 150 dots each
DPI = 150
PANEL_HEIGHT = 1.75
MOST_COLUMNS = 5
LONGEST_VALUE = 11
LONGEST_NAME = 26
WIDE, TALLEST = 2.2, 6.0
LINE, START, BAND = "#1f4e79", "#8a8a8a", "#f2b134"


def draw_report(result: FitResult) -> Figure:
    """Draw target, start, fit and signed residual, the cost of every level and the trace of every parameter.

    Pictures are shown as the course stores them, linear without gamma.
    """
    _, height, width = result.target.shape
    picture_columns = 2 if width / height > WIDE else 4
    picture_rows = 4 // picture_columns
    cell_width = WIDTH / picture_columns
    pictures_height = picture_rows * (min(TALLEST, 0.9 * cell_width * height / width) + 0.4)

    panels = 1 + len(result.names)
    panel_rows = math.ceil(panels / MOST_COLUMNS)
    panel_columns = math.ceil(panels / panel_rows)
    panels_height = panel_rows * PANEL_HEIGHT + 0.3

    heights = (0.55, pictures_height, panels_height)
    figure = Figure(figsize=(WIDTH, sum(heights)), dpi=DPI, layout="constrained")
    parts = figure.subfigures(3, 1, squeeze=False, height_ratios=heights)[:, 0]
    _draw_title(parts[0], result)
    _draw_pictures(parts[1], result, picture_rows, picture_columns)
    _draw_traces(parts[2], result, panel_rows, panel_columns)
    return figure


def _draw_title(figure: SubFigure, result: FitResult) -> None:
    rms = f"rms residual {255 * result.rms_residual:.3g}/255" if math.isfinite(result.rms_residual) else ""
    text = "   ".join([result.status.replace("_", " "), rms, f"{len(result.history)} steps"])
    figure.text(0.5, 0.72, text, ha="center", va="center", fontsize=11)
    key = "parameters: start dotted, estimate in orange with a band of ± its standard error"
    figure.text(0.5, 0.22, key, ha="center", va="center", fontsize=8, color="0.35")


def _draw_pictures(figure: SubFigure, result: FitResult, rows: int, columns: int) -> None:
    axes = figure.subplots(rows, columns).ravel()
    shown = (("target", result.target), ("start", result.start_image), ("fit", result.image))
    for ax, (name, image) in zip(axes, shown, strict=False):
        ax.imshow(np.moveaxis(encode_course(image), 0, -1))
        ax.set_title(name, fontsize=9)
    _draw_residual(axes[3], 255 * (result.image - result.target))
    for ax in axes:
        ax.set_xticks([])
        ax.set_yticks([])


def _draw_residual(ax: Axes, residual: np.ndarray) -> None:
    """Show, of each pixel's three differences in units of 1/255, the largest with its sign."""
    worst = np.argmax(np.abs(residual), axis=0)[None]
    largest = np.take_along_axis(residual, worst, axis=0)[0]
    # A few bright pixels at edges must not hide all the rest; the colour bar then has arrows.
    limit = float(np.quantile(np.abs(largest), 0.995)) or float(np.abs(largest).max()) or 1.0
    extend = "both" if np.abs(largest).max() > limit else "neither"
    mesh = ax.imshow(largest, cmap="RdBu_r", vmin=-limit, vmax=limit)
    ax.set_title("fit − target, largest channel", fontsize=9)
    bar = ax.figure.colorbar(mesh, ax=ax, extend=extend, fraction=0.046, pad=0.03)
    bar.set_label("1/255", fontsize=8)
    bar.ax.tick_params(labelsize=7)


def _draw_traces(figure: SubFigure, result: FitResult, rows: int, columns: int) -> None:
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    steps = [step for step in result.history if step.accepted]
    starts = [i for i, step in enumerate(steps) if i and step.level != steps[i - 1].level]
    _draw_cost(axes[0], steps)
    for column, ax in enumerate(axes[1 : 1 + len(result.names)]):
        _draw_parameter(ax, result, column, steps)
    for ax in axes[: 1 + len(result.names)]:
        for start in starts:
            ax.axvline(start - 0.5, color="0.85", linewidth=0.8, zorder=0)
        ax.tick_params(which="both", labelsize=7)
        ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[1 + len(result.names) :]:
        ax.set_visible(False)
    # The lowest panel of each column names the axis that the column shares.
    for ax in axes[max(0, 1 + len(result.names) - columns) : 1 + len(result.names)]:
        ax.set_xlabel("accepted step", fontsize=8)
        ax.tick_params(labelbottom=True)


def _draw_cost(ax: Axes, steps: list[FitStep]) -> None:
    levels = sorted({step.level for step in steps})
    for level in levels:
        places = [i for i, step in enumerate(steps) if step.level == level]
        cost = np.array([steps[i].cost for i in places])
        shade = 0.75 - 0.6 * level / max(levels[-1], 1)
        blur = steps[places[0]].blur
        label = f"blur {blur:g} px" if blur else "no blur"
        # A cost of exactly zero has no logarithm.
        cost = np.where(cost > 0, cost, np.nan)
        ax.plot(places, cost, ".-", color=str(shade), markersize=4, linewidth=1.2, label=label)
    ax.set_title("cost of each level", fontsize=9)
    if any(step.cost > 0 for step in steps):
        ax.set_yscale("log")
    if levels:
        ax.legend(fontsize=7, frameon=False, handlelength=1.2, labelspacing=0.2)


def _draw_parameter(ax: Axes, result: FitResult, column: int, steps: list[FitStep]) -> None:
    value, error = float(result.value[column]), float(result.standard_error[column])
    ax.plot([step.value[column] for step in steps], ".-", color=LINE, markersize=4, linewidth=1.2)
    ax.axhline(result.initial[column], color=START, linewidth=0.8, linestyle=":")
    ax.axhline(value, color=BAND, linewidth=1.0, zorder=1)
    if math.isfinite(error):
        ax.axhspan(value - error, value + error, color=BAND, alpha=0.35, linewidth=0, zorder=0)
    name = result.names[column]
    shown = name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME // 2]}…{name[-LONGEST_NAME // 2 :]}"
    value_text, error_text = value_and_error(value, error)
    if len(value_text) > LONGEST_VALUE:  # More digits than the panel is wide.
        value_text, error_text = f"{value:.8g}", f"{error:.1g}"
    certainty = f" ± {error_text}" if math.isfinite(error) else ", not determined"
    ax.set_title(f"{shown}\n{value_text.replace('-', '−')}{certainty}", fontsize=9)
    ax.ticklabel_format(axis="y", useOffset=False)
