"""The curves of a fit's report: the cost, each parameter's way, the corner plot and profile likelihoods."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, MaxNLocator

from ...inverse.result import ELLIPSE_95, PROFILE_95, FitResult, FitStep, Profile
from ...util.digits import value_and_error
from ..panels import drawable
from .summary import correlation_text, level_labels, power_of_ten, typeset

STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelsize": 8,
    "axes.titlesize": 9,
    "axes.titley": 1.0,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "text.parse_math": False,
}
"""The looks of all panels of curves, for `matplotlib.rc_context`."""

LINE, START, ESTIMATE, OTHERS = "#1f4e79", "#8a8a8a", "#f2b134", "#d9c7b8"


def winning_steps(result: FitResult) -> list[FitStep]:
    """The steps that led to the estimate: those taken, of the winning candidate."""
    return [step for step in result.steps if step.accepted and step.candidate == result.candidate]


class _Powers(LogFormatter):
    """Costs with plain raised exponents: matplotlib's own formula takes longer than the rest of the panel."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return typeset(super().__call__(x, pos).replace("−", "-")).removeprefix("1 × ")


def draw_cost(ax: Axes, result: FitResult) -> None:
    """Draw the cost against the steps that led to the estimate, one line a level; other candidates thin and pale."""
    steps = winning_steps(result)
    labels = level_labels(steps)
    others = [step for step in result.steps if step.accepted and step.candidate != result.candidate]
    for candidate, level in sorted({(step.candidate, step.level) for step in others}):
        its_steps = [step for step in others if step.candidate == candidate]
        _draw_level(ax, its_steps, level, color=OTHERS, linewidth=0.8, zorder=1)
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
        # Between the title and the panel, where it covers no line.
        tight = {"handlelength": 1.2, "labelspacing": 0.2, "columnspacing": 1.0, "borderaxespad": 0, "borderpad": 0}
        ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.02), **tight)
    # In points: the legend's rows of two entries are 10 high each.
    _finish_steps(ax, steps, pad=5 + 10 * math.ceil((len(levels) + bool(others)) / 2))


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
    _finish_steps(ax, steps, pad=13)  # Numbers that differ in their last digits alone have an offset below the title.


def _draw_level(ax: Axes, steps: list[FitStep], level: int, **style: object) -> None:
    places = [i for i, step in enumerate(steps) if step.level == level]
    # A cost of exactly zero has no logarithm.
    ax.plot(places, [steps[i].cost or np.nan for i in places], **style)  # pyright: ignore[reportArgumentType]


def _finish_steps(ax: Axes, steps: list[FitStep], pad: float) -> None:
    """Mark where a new level begins, and set the axes' looks."""
    for i in range(1, len(steps)):
        if steps[i].level != steps[i - 1].level:
            ax.axvline(i - 0.5, color="0.85", linewidth=0.8, zorder=0)
    ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_xlabel("accepted step")
    ax.set_title("", pad=pad)


def corner_columns(result: FitResult) -> list[int]:
    """The columns of the parameters of the corner plot: those determined, at most the six that are most correlated."""
    error, correlation = result.total_error, result.total_correlation
    known = np.flatnonzero(np.isfinite(error) & (error > 0)).tolist()
    pairs = [pair for pair in itertools.combinations(known, 2) if np.isfinite(correlation[pair])]
    pairs.sort(key=lambda pair: -abs(correlation[pair]))
    return sorted(list(dict.fromkeys(itertools.chain.from_iterable(pairs)))[:6])


def ellipse(result: FitResult, pair: tuple[int, int], of_noise: bool = False) -> np.ndarray:
    """The outline "2 points" of a pair's 95 % ellipse, in all or of noise alone, as deviations from the estimate."""
    error = (result.standard_error if of_noise else result.total_error)[list(pair)]
    slope = np.clip((result.uncertainty.correlation if of_noise else result.total_correlation)[pair], -1, 1)
    angle = np.linspace(0, 2 * np.pi, 181)
    # The Cholesky factor of the correlation matrix turns a circle into the ellipse; it exists at a slope of 1, too.
    unit = np.stack([np.cos(angle), slope * np.cos(angle) + np.sqrt(1 - slope**2) * np.sin(angle)])
    return math.sqrt(ELLIPSE_95) * error[:, None] * unit


def draw_corner(axes: np.ndarray, result: FitResult, columns: Sequence[int]) -> None:
    """Draw in axes "count count" each pair's 95 % ellipse, and on the diagonal each parameter's normal density.

    All are deviations from the estimate: those of a column share the axis below, those of a row the axis at the left.
    """
    for (i, row), (j, column) in itertools.product(enumerate(columns), repeat=2):
        ax = axes[i, j]
        if j > i:
            ax.set_visible(False)
            continue
        ax.spines[:].set(visible=True, color="0.5", linewidth=0.6)
        ax.tick_params(length=2.5, width=0.6, color="0.5")
        for axis in (ax.xaxis, ax.yaxis):
            axis.label.set_size(7)
        ax.set(**_deviations(result, "x", column, i == len(columns) - 1))
        if j < i:
            ax.set(**_deviations(result, "y", row, j == 0))
            _draw_ellipse(ax, result, (column, row))
        else:
            ax.set(ylim=(0, 1.15), yticks=[])
            _draw_density(ax, result, column)
    # In the empty triangle; the layout needs no place for it.
    where = {"loc": "upper right", "bbox_to_anchor": (1, 1), "bbox_transform": axes[0, -1].transAxes}
    axes[0, 0].legend(*axes[1, 0].get_legend_handles_labels(), **where).set_in_layout(False)


def _deviations(result: FitResult, axis: str, column: int, outer: bool) -> dict[str, object]:
    """What an axis of the corner plot is set to; only an outer one has words."""
    extent, name = math.sqrt(ELLIPSE_95) * float(result.total_error[column]), result.labels[column]
    exponent = _exponent(extent)
    ticks = MaxNLocator(3).tick_values(-extent, extent)[1:-1]
    label, numbers = _axis_label(name, exponent), [typeset(f"{tick / 10.0**exponent:g}") for tick in ticks]
    if len(label) > 13 and "." in name:
        # A panel is narrow: two lines, of which the first ends with the dot next to the middle.
        dots = [i for i, sign in enumerate(name, 1) if sign == "."]
        middle = min(dots, key=lambda i: abs(2 * i - len(name) - 1))
        label = f"Δ {drawable(name[:middle], 12)}\n{_axis_label(name[middle:], exponent, 9).removeprefix('Δ ')}"
    words = {f"{axis}ticklabels": numbers if outer else [], f"{axis}label": label if outer else ""}
    return {f"{axis}lim": (-1.4 * extent, 1.4 * extent), f"{axis}ticks": ticks, **words}


def _draw_density(ax: Axes, result: FitResult, column: int) -> None:
    error, noise = float(result.total_error[column]), float(result.standard_error[column])
    x = np.linspace(*ax.get_xlim(), 181)
    density = np.exp(-((x / error) ** 2) / 2)
    ax.axvspan(-error, error, color=ESTIMATE, alpha=0.35, linewidth=0, zorder=0)
    ax.axvline(0, color=ESTIMATE, linewidth=1.0)
    ax.fill_between(x, density, facecolor=LINE, alpha=0.13, linewidth=0)
    ax.plot(x, density, color=LINE, linewidth=1.2)
    if 0 < noise < error:
        ax.plot(x, np.exp(-((x / noise) ** 2) / 2), color=LINE, linewidth=1.0, linestyle=":")


def _draw_ellipse(ax: Axes, result: FitResult, pair: tuple[int, int]) -> None:
    outline, (x, y) = ellipse(result, pair), result.total_error[list(pair)]
    ax.fill(*outline, facecolor=LINE, alpha=0.13, linewidth=0)
    ax.plot(*outline, color=LINE, linewidth=1.2, label="95 % ellipse")
    if np.any(result.systematic_error[list(pair)] > 0):
        ax.plot(*ellipse(result, pair, of_noise=True), color=LINE, linewidth=1.0, linestyle=":", label="noise alone")
    ax.errorbar(0, 0, yerr=y, xerr=x, fmt="o", color=ESTIMATE, markersize=3, linewidth=1.3, label="estimate ± error")
    # In the upper corner that an ellipse with a slope leaves free.
    correlation = float(result.total_correlation[pair])
    place, side = (0.04, "left") if correlation > 0 else (0.96, "right")
    ax.text(place, 0.96, correlation_text(correlation), ha=side, va="top", fontsize=7, transform=ax.transAxes)


def draw_profile(ax: Axes, result: FitResult, profile: Profile) -> None:
    """Draw chi-square against a parameter's deviation, with its 95 % interval and the standard error's parabola."""
    estimate = result[profile.name]
    value, error = estimate.value, estimate.standard_error
    exponent = _exponent(float(np.abs(profile.value[[0, -1]] - value).max()))
    unit = 10.0**exponent
    deviation = (profile.value - value) / unit
    finite = profile.chi_square[np.isfinite(profile.chi_square)]
    top = 1.1 * max(PROFILE_95, float(finite.max(initial=0)))
    bottom = min(-0.04 * top, 1.1 * float(finite.min(initial=0)))
    lower, upper = (np.clip(profile.interval, profile.value[0], profile.value[-1]) - value) / unit
    ax.axvspan(lower, upper, color=ESTIMATE, alpha=0.22, linewidth=0, zorder=0)
    ax.axhline(PROFILE_95, color=START, linewidth=0.9, linestyle="--", label="3.84: 95 %")
    if math.isfinite(error) and error > 0:
        dense = np.linspace(deviation[0], deviation[-1], 201)
        parabola = (dense * unit / error) ** 2
        ax.plot(dense, parabola, color=START, linewidth=1.0, linestyle=":", label="standard error")
    ax.plot(deviation, profile.chi_square, ".-", color=LINE, markersize=4, linewidth=1.2, label="profile")
    ax.set(ylim=(bottom, top), xlabel=_axis_label(profile.name, exponent), ylabel="chi-square")
    ax.legend(handlelength=1.5, labelspacing=0.2, loc="upper center")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    ax.ticklabel_format(useOffset=False)


def interval_text(result: FitResult, profile: Profile) -> str:
    """The 95 % interval of a profile in words."""
    error = result[profile.name].standard_error
    ends = [typeset(value_and_error(end, error)[0]) for end in profile.interval]
    lower, upper = np.isfinite(profile.interval)
    if lower:
        return f"95 %: {ends[0]} to {ends[1]}" if upper else f"95 %: above {ends[0]}"
    return f"95 %: below {ends[1]}" if upper else "95 %: not bounded within these values"


def _exponent(extent: float) -> int:
    """The power of ten that an axis of deviations is counted in; 0 where plain numbers are short enough."""
    exponent = math.floor(math.log10(extent)) if extent > 0 else 0
    return 0 if -2 <= exponent <= 3 else exponent


def _axis_label(name: str, exponent: int, longest: int = 20) -> str:
    return f"Δ {drawable(name, longest)}" + (f" [{power_of_ten(exponent)}]" if exponent else "")
