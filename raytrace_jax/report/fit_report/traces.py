"""Panels on how the search went: the cost of every level, and the way of every parameter."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, MaxNLocator

from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.report.fit_report.text import level_labels, typeset

LINE, START, ESTIMATE, OTHERS = "#1f4e79", "#8a8a8a", "#f2b134", "#d9c7b8"


def winning_steps(result: FitResult) -> list[FitStep]:
    """The steps that led to the estimate: those taken, of the winning candidate."""
    return [step for step in result.history.steps if step.accepted and step.candidate == result.history.candidate]


def legend_rows(result: FitResult) -> int:
    """The rows of the legend of the cost: two entries in each, of which one may be for other starts."""
    return math.ceil((1 + len({step.level for step in winning_steps(result)})) / 2)


class _Powers(LogFormatter):
    """Costs with plain raised exponents: matplotlib's own formula takes longer than the rest of the panel."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return typeset(super().__call__(x, pos).replace("−", "-")).removeprefix("1 × ")


def draw_cost(ax: Axes, result: FitResult) -> None:
    """Draw the cost against the steps that led to the estimate, one line a level; other candidates thin and pale.

    The legend stands between the title and the panel, where it covers no line.
    """
    steps = winning_steps(result)
    labels = level_labels(steps)
    others = [step for step in result.history.steps if step.accepted and step.candidate != result.history.candidate]
    for candidate in sorted({step.candidate for step in others}):
        own = [step for step in others if step.candidate == candidate]
        for level in sorted({step.level for step in own}):
            _draw_level(ax, own, level, color=OTHERS, linewidth=0.8, zorder=1)
    if others:
        ax.plot([], [], color=OTHERS, linewidth=0.8, label="other starts")
    levels = sorted({step.level for step in steps})
    for number, level in enumerate(levels):
        shade = str(0.75 - 0.6 * number / max(len(levels) - 1, 1))
        _draw_level(ax, steps, level, marker=".", color=shade, markersize=4, linewidth=1.2, label=labels[level])
    if any(step.cost > 0 for step in (*steps, *others)):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(_Powers())
        ax.yaxis.set_minor_formatter(_Powers(labelOnlyBase=False, minor_thresholds=(1, 0.4)))
    if levels:
        where = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.02), "borderaxespad": 0, "borderpad": 0}
        looks = {"fontsize": 7, "frameon": False, "handlelength": 1.2, "labelspacing": 0.2, "columnspacing": 1.0}
        ax.legend(ncols=2, **where, **looks)
    # In points: a row of the legend is 10 high.
    _finish(ax, steps, pad=5 + 10 * legend_rows(result))


def draw_trace(ax: Axes, result: FitResult, column: int) -> None:
    """Draw one parameter's way from the start (dotted) to the estimate (with a band of ± its standard error)."""
    value, error = float(result.value[column]), float(result.standard_error[column])
    steps = winning_steps(result)
    ax.plot([step.value[column] for step in steps], ".-", color=LINE, markersize=4, linewidth=1.2)
    ax.axhline(result.initial[column], color=START, linewidth=0.8, linestyle=":")
    ax.axhline(value, color=ESTIMATE, linewidth=1.0, zorder=1)
    if math.isfinite(error):
        ax.axhspan(value - error, value + error, color=ESTIMATE, alpha=0.35, linewidth=0, zorder=0)
    ax.yaxis.set_major_locator(MaxNLocator(5))
    _finish(ax, steps, pad=13)  # Numbers that differ in their last digits alone have an offset below the title.


def _draw_level(ax: Axes, steps: list[FitStep], level: int, **style: object) -> None:
    places = [i for i, step in enumerate(steps) if step.level == level]
    # A cost of exactly zero has no logarithm.
    cost = np.array([steps[i].cost or np.nan for i in places])
    ax.plot(places, cost, **style)  # pyright: ignore[reportArgumentType]


def _finish(ax: Axes, steps: list[FitStep], pad: float) -> None:
    """Mark where a new level begins, and set the axes' looks."""
    for i in range(1, len(steps)):
        if steps[i].level != steps[i - 1].level:
            ax.axvline(i - 0.5, color="0.85", linewidth=0.8, zorder=0)
    ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_xlabel("accepted step")
    set_looks(ax, pad)


def set_looks(ax: Axes, pad: float = 6) -> None:
    """Small letters, and a title that stands `pad` points above."""
    ax.tick_params(which="both", labelsize=7)
    ax.spines[["top", "right"]].set_visible(False)
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set(fontsize=8, parse_math=False)
    ax.set_title("", fontsize=9, pad=pad, y=1.0)
