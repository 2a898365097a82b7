"""Which minimum is the answer: the best and its rivals, solved on the whole picture."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.findings import LocalMinimum
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine import refine
from raytrace_jax.inverse.solve.refine_options import RefineOptions
from raytrace_jax.inverse.solve.target_grid import Sampling
from raytrace_jax.inverse.statistics.goodness_of_fit import EVIDENCE
from raytrace_jax.util.numerics import finite_or_last


@dataclasses.dataclass(frozen=True)
class RivalLimits:
    """Which minima are solved to the end beside the best; other values were tried on two scenes with two minima.

    Args:
        most: how many runner-ups are solved to the end, when the small pictures do not tell them from the best. 0 to 4
            give the same answers and words (experiments/tuning).
        first_evidence: evidence on small pictures, which are a coarse model, below which a runner-up is solved to the
            end. Anything from 1.5 to infinity gives the same answers and words (experiments/tuning).
        same_end: ends nearer to each other than this, in natural scales of the parameters, are one: far above where
            solves stop. Nothing from 1e-5 to 0.1 changes anything (experiments/tuning).
    """

    most: int = 2
    first_evidence: float = 2 * EVIDENCE
    same_end: float = 1e-3


RIVALS = RivalLimits()


def select_solution(
    problem: Problem,
    minima: list[LocalMinimum],
    level: int,
    options: FitOptions,
    recorder: Recorder,
    tell: Callable[[Float[Array, " parameters"]], Sampling],
) -> tuple[list[LocalMinimum], FitState]:
    """Solve the best minimum to the end, and those that the small pictures do not tell from it; the best comes first.

    Args:
        problem: what is fitted.
        minima: minima of the small pictures, best first.
        level: number of this level in the history.
        options: what the user asked for.
        recorder: is told of everything, and of the best minimum's solution as soon as there is one.
        tell: tells near the answer how the target was sampled, if the user has not said.

    Returns:
        All minima, those that were solved to the end with their values and evidence there; and the best one.
    """
    sampling = options.known_sampling
    if sampling == "auto":
        recorder.phase("telling how the target was sampled")
        sampling = tell(minima[0].y)
    recorder.phase("solving on the whole picture")

    # Solve the best minimum and its rivals to the end.
    close = [m for m in minima[1:] if m.summary.explained and m.summary.evidence < RIVALS.first_evidence]
    rivals = close[: RIVALS.most]
    solutions: list[FitState] = []
    for minimum in (minima[0], *rivals):
        how = RefineOptions.of(options, sampling, level, minimum.summary.candidate)
        solutions.append(refine(problem, minimum.y, how, recorder))
        recorder.found(solution=solutions[0])

    # The best is now the one with the least loss. Losses compare at one scale only.
    loss_scale = max(solution.comparison.loss_scale for solution in solutions)
    ends = [
        (minimum.summary.candidate, solution, solution.under_loss("residual", loss_scale))
        for minimum, solution in zip((minima[0], *rivals), solutions, strict=True)
    ]
    ends.sort(key=lambda end: finite_or_last(float(np.sum(end[2] ** 2))))
    _, winner, least = ends[0]

    def at_end(candidate: int, solution: FitState, residual: Float[np.ndarray, "3 height width"]) -> LocalMinimum:
        minimum = LocalMinimum.of(solution, candidate, level)
        return dataclasses.replace(minimum, residual=residual).judged_against(least)

    best, *others = (at_end(*end) for end in ends)
    # Starts that came together on the whole picture are one minimum.
    distinct = [m for m in others if problem.scaled_distance(m.summary.value, best.summary.value) > RIVALS.same_end]
    untouched = [minimum for minimum in minima[1:] if all(minimum is not rival for rival in rivals)]
    return [best, *distinct, *untouched], winner
