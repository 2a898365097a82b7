"""The curves of a fit's report: the cost, each parameter's way, 95 % ellipses and profile likelihoods."""

import itertools
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, MaxNLocator

from raytrace_jax.inverse.result import ELLIPSE_95, PROFILE_95, FitResult, FitStep, Profile
from raytrace_jax.report.fit_report.summary import level_labels, power_of_ten, typeset
from raytrace_jax.report.panels import drawable
from raytrace_jax.util.digits import value_and_error

LINE, START, ESTIMATE, OTHERS = "#1f4e79", "#8a8a8a", "#f2b134", "#d9c7b8"


def winning_steps(result: FitResult) -> list[FitStep]:
    """The steps that led to the estimate: those taken, of the winning candidate."""
    return [step for step in result.history.steps if step.accepted and step.candidate == result.history.candidate]


class _Powers(LogFormatter):
    """Costs with plain raised exponents: matplotlib's own formula takes longer than the rest of the panel."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return typeset(super().__call__(x, pos).replace("−", "-")).removeprefix("1 × ")


def draw_cost(ax: Axes, result: FitResult) -> None:
    """Draw the cost against the steps that led to the estimate, one line a level; other candidates thin and pale."""
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
        # Between the title and the panel, where it covers no line.
        where = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.02), "borderaxespad": 0, "borderpad": 0}
        looks = {"fontsize": 7, "frameon": False, "handlelength": 1.2, "labelspacing": 0.2, "columnspacing": 1.0}
        ax.legend(ncols=2, **where, **looks)
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
    set_looks(ax, pad)


def shown_pairs(result: FitResult) -> list[tuple[int, int]]:
    """The pairs that have an ellipse, the most correlated first: each determined; of many parameters the first six."""
    error, correlation = result.total_error, result.total_correlation
    known = [k for k in range(len(result.names)) if np.isfinite(error[k]) and error[k] > 0]
    pairs = [pair for pair in itertools.combinations(known, 2) if np.isfinite(correlation[pair])]
    return sorted(pairs, key=lambda pair: -abs(correlation[pair]))[: None if len(result.names) <= 6 else 6]


def ellipse(result: FitResult, pair: tuple[int, int], of_noise: bool = False) -> np.ndarray:
    """The outline "2 points" of a pair's 95 % ellipse, in all or of noise alone, as deviations from the estimate."""
    error = (result.standard_error if of_noise else result.total_error)[list(pair)]
    slope = np.clip((result.uncertainty.correlation if of_noise else result.total_correlation)[pair], -1, 1)
    angle = np.linspace(0, 2 * np.pi, 181)
    # The Cholesky factor of the correlation matrix turns a circle into the ellipse; it exists at a slope of 1, too.
    unit = np.stack([np.cos(angle), slope * np.cos(angle) + np.sqrt(1 - slope**2) * np.sin(angle)])
    return math.sqrt(ELLIPSE_95) * error[:, None] * unit


def draw_ellipse(ax: Axes, result: FitResult, pair: tuple[int, int]) -> None:
    """Draw a pair's 95 % ellipse about the estimate, dotted that of noise alone, and each one's own error as a bar."""
    outline = ellipse(result, pair)
    exponents = [_exponent(float(extent)) for extent in np.abs(outline).max(axis=1)]
    units = 10.0 ** np.array(exponents)
    x, y = outline / units[:, None]
    ax.fill(x, y, facecolor=LINE, alpha=0.13, linewidth=0)
    ax.plot(x, y, color=LINE, linewidth=1.2)
    if np.any(result.systematic_error[list(pair)] > 0):
        ax.plot(*(ellipse(result, pair, of_noise=True) / units[:, None]), color=LINE, linewidth=1.0, linestyle=":")
    errors = result.total_error[list(pair)] / units
    ax.errorbar(0, 0, xerr=errors[0], yerr=errors[1], fmt="o", color=ESTIMATE, markersize=3.5, linewidth=1.4)
    x_label, y_label = (_axis_label(result.labels[k], exponent) for k, exponent in zip(pair, exponents, strict=True))
    ax.set(xlabel=x_label, ylabel=y_label)
    _finish(ax)


def draw_profile(ax: Axes, result: FitResult, profile: Profile) -> None:
    """Draw chi-square against a parameter's deviation, with its 95 % interval and the standard error's parabola."""
    column = result.names.index(profile.name)
    value, error = float(result.value[column]), float(result.standard_error[column])
    extent = max(abs(float(profile.value[0]) - value), abs(float(profile.value[-1]) - value))
    exponent = _exponent(extent)
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
    ax.legend(fontsize=7, frameon=False, handlelength=1.5, labelspacing=0.2, loc="upper center")
    _finish(ax)


def interval_text(result: FitResult, profile: Profile) -> str:
    """The 95 % interval of a profile in words."""
    error = float(result.standard_error[result.names.index(profile.name)])
    ends = [typeset(value_and_error(end, error)[0]) for end in profile.interval]
    lower, upper = np.isfinite(profile.interval)
    if lower:
        return f"95 %: {ends[0]} to {ends[1]}" if upper else f"95 %: above {ends[0]}"
    return f"95 %: below {ends[1]}" if upper else "95 %: not bounded within these values"


def _exponent(extent: float) -> int:
    """The power of ten that an axis of deviations is counted in; 0 where plain numbers are short enough."""
    exponent = math.floor(math.log10(extent)) if extent > 0 else 0
    return 0 if -2 <= exponent <= 3 else exponent


def _axis_label(name: str, exponent: int) -> str:
    return f"Δ {drawable(name, 20)}" + (f" [{power_of_ten(exponent)}]" if exponent else "")


def _finish(ax: Axes) -> None:
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.yaxis.set_major_locator(MaxNLocator(5))
    ax.ticklabel_format(useOffset=False)
    set_looks(ax)


def set_looks(ax: Axes, pad: float = 6) -> None:
    """Small letters, and a title that stands `pad` points above."""
    ax.tick_params(which="both", labelsize=7)
    ax.spines[["top", "right"]].set_visible(False)
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set(fontsize=8, parse_math=False)
    ax.set_title("", fontsize=9, pad=pad, y=1.0)
