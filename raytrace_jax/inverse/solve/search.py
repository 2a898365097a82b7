"""The search: places from a scan of small pictures, the best of them solved coarse to fine, and what they led to."""

import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.inverse.judge.goodness_of_fit import explains
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.result import Minimum
from raytrace_jax.inverse.solve.levels import SAME_MINIMUM, Levels, binning_to, descend
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.scan import scan
from raytrace_jax.inverse.solve.solution import LocalMinimum
from raytrace_jax.scene.setting_words import EdgeMode

SCAN_PIXELS = 5_000
"""About how many pixels the pictures of the scan have: 80 x 60, in which a ball still has an outline."""

LEAST_SOLVES, MOST_SOLVES = 2, 5
"""How many places are solved: until the picture is explained, but never only one, lest a second answer is missed.
Only one takes half the steps and leads three of three starts to the truth too, four take three times as many
(experiments/tuning)."""

SAME_START = 0.1
"""Starts nearer to each other than this, in natural scales of the parameters, are one. Half and double do the same
(experiments/tuning)."""


def find_minima(
    problem: Problem,
    levels: Levels,
    edges: EdgeMode,
    scanned: bool,
    recorder: Recorder,
    on_first: Callable[[LocalMinimum], None] = lambda minimum: None,
) -> list[LocalMinimum]:
    """Minima on the small pictures, best first.

    A start that leads to a picture which is not finite is left out, with a warning.

    Args:
        problem: what is fitted.
        levels: the levels to solve on.
        edges: how pictures are sampled.
        scanned: whether to look for starts; if not, the scene's values are the only one.
        recorder: is told of everything.
        on_first: called with the first minimum, of the most promising start, while others are still to come.

    Raises:
        PictureError: no start leads to a picture that is finite.
    """
    starts = recorder.stage("scan", lambda: find_starts(problem, scanned, recorder))
    minima: list[LocalMinimum] = []
    tried: list[np.ndarray] = []
    for start in map(np.asarray, starts):
        enough = len(tried) >= LEAST_SOLVES and any(minimum.summary.explained for minimum in minima)
        if enough or len(tried) >= MOST_SOLVES:
            break
        if any(problem.scaled_distance(start, other) < SAME_START for other in tried):
            continue
        candidate = len(tried)
        recorder.phase(f"solving from start {candidate + 1}")
        known = [minimum.summary.value for minimum in minima]

        def solve(start=start, candidate=candidate, known=known):
            return descend(problem, start, levels, edges, candidate, recorder, known).tolist()

        y = problem.array(recorder.stage(f"candidate {candidate}", solve))
        tried.append(start)
        minimum = assess(problem, y, levels, edges, candidate)
        if minimum is None:
            place = ", ".join(f"{name} {value:.6g}" for name, value in zip(problem.unknowns.names, start, strict=True))
            warnings.warn(
                f"start {candidate + 1} ({place}) is left out: its picture, or a derivative of it, is not finite.",
                PictureWarning,
                stacklevel=2,
            )
            continue
        is_first = not minima
        minima = with_minimum(problem, minima, minimum)
        recorder.answer = minima[0].y
        if is_first:
            on_first(minima[0])
    if not minima:
        raise PictureError(
            "the fit has nowhere to begin: the picture of every start, or a derivative of it, is not finite. Look at "
            "the scene's numbers, or start elsewhere."
        )
    return [minima[0], *(minimum.judged_against(minima[0].residual) for minimum in minima[1:])]


def find_starts(problem: Problem, scanned: bool, recorder: Recorder) -> list[list[float]]:
    """The places to solve from, most promising first."""
    if not scanned:
        return [problem.unknowns.initial(problem.scene).tolist()]
    done = 0

    def tell(pictures: int) -> None:
        nonlocal done
        done += pictures
        recorder.phase(f"scanning, {done} pictures")

    recorder.phase("scanning: compiling")
    return [values.tolist() for _, values in scan(problem, binning_to(problem, SCAN_PIXELS), tell)]


def assess(
    problem: Problem, y: Float[Array, " parameters"], levels: Levels, edges: EdgeMode, candidate: int
) -> LocalMinimum | None:
    """What there is to say of the place that a solve led to; None where its picture or a derivative is not finite."""
    binning = levels.binning
    linearization = problem.linearize(y, Comparison(edges, binning=binning))
    if not linearization.is_finite:
        return None
    summary = Minimum(
        candidate=candidate,
        value=problem.values(y),
        rms_residual=problem.rms_residual(linearization, binning),
        level=len(levels.blurs) - 1,
        explained=explains(problem, linearization, binning),
        evidence=0.0,
    )
    return LocalMinimum(summary, y, np.asarray(problem.residual_of(linearization, binning)))


def with_minimum(problem: Problem, minima: list[LocalMinimum], new: LocalMinimum) -> list[LocalMinimum]:
    """The minima and a new one, best first; of those that are one only the best."""

    def size(minimum: LocalMinimum) -> float:
        return minimum.summary.rms_residual

    def is_same(minimum: LocalMinimum) -> bool:
        return problem.scaled_distance(new.summary.value, minimum.summary.value) < SAME_MINIMUM

    best = min([*filter(is_same, minima), new], key=size)
    return sorted([*(minimum for minimum in minima if not is_same(minimum)), best], key=size)
