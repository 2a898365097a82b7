"""Which minimum is the answer: the best and its rivals, solved on the whole picture."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.options import FitOptions, LossName, TargetSampling
from raytrace_jax.inverse.problem.comparison import evaluate
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.result import Minimum
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine import refine
from raytrace_jax.inverse.solve.state import FitState, LocalMinimum, RefineOptions
from raytrace_jax.inverse.solve.target_grid import Sampling
from raytrace_jax.inverse.statistics.goodness_of_fit import EVIDENCE, explains, vuong_evidence
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
        recorder: is told of everything; its `solution` is the best minimum's as soon as there is one.
        tell: tells near the answer how the target was sampled, if the user has not said.

    Returns:
        All minima, those that were solved to the end with their values and evidence there; and the best one.
    """
    sampling = options.known_sampling
    if sampling == "auto":
        recorder.phase("telling how the target was sampled")
        sampling = recorder.stage("sampling", lambda: tell(minima[0].y))
    recorder.phase("solving on the whole picture")

    # Solve the best minimum and its rivals to the end.
    close = [m for m in minima[1:] if m.summary.explained and m.summary.evidence < RIVALS.first_evidence]
    rivals = close[: RIVALS.most]
    solutions: list[FitState] = []
    for minimum in (minima[0], *rivals):
        how = refine_options(options, sampling, level, minimum.summary.candidate)
        solutions.append(refine(problem, minimum.y, how, recorder))
        recorder.solution = solutions[0]

    # The best is now the one with the least loss. Losses compare at one scale only.
    loss_scale = max(solution.comparison.loss_scale for solution in solutions)
    ends = [
        (minimum.summary.candidate, solution, residual_under_loss(solution, loss_scale))
        for minimum, solution in zip((minima[0], *rivals), solutions, strict=True)
    ]
    ends.sort(key=lambda end: finite_or_last(float(np.sum(end[2] ** 2))))
    _, winner, least = ends[0]

    def at_end(candidate: int, solution: FitState, residual: Float[np.ndarray, "3 height width"]) -> LocalMinimum:
        summary = Minimum(
            candidate=candidate,
            value=problem.values(solution.y),
            rms_residual=solution.problem.rms_residual(solution.linearization),
            level=level,
            explained=explains(solution.problem, solution.linearization),
            evidence=vuong_evidence(least, residual),
        )
        return LocalMinimum(summary, solution.y, residual)

    best, *others = (at_end(*end) for end in ends)
    # Starts that came together on the whole picture are one minimum.
    distinct = [m for m in others if problem.scaled_distance(m.summary.value, best.summary.value) > RIVALS.same_end]
    untouched = [minimum for minimum in minima[1:] if all(minimum is not rival for rival in rivals)]
    return [best, *distinct, *untouched], winner


def refine_options(options: FitOptions, sampling: TargetSampling, level: int = 0, candidate: int = 0) -> RefineOptions:
    """How the whole picture is solved, given how the target was sampled."""
    suited: LossName = "cauchy" if sampling == "point" else "l2"
    edges = "point" if sampling == "point" else options.edges
    loss = suited if options.loss == "auto" else options.loss
    how = RefineOptions(edges, loss, options.sigma, options.max_steps, level, candidate, options.target_samples)
    return dataclasses.replace(how, is_own=sampling == "aware")


def residual_under_loss(solution: FitState, scale: float) -> Float[np.ndarray, "3 height width"]:
    """The weighted residual, transformed so that its squares are twice the loss at a scale."""
    residual = solution.problem.residual_of(solution.linearization)
    return evaluate(solution.comparison.loss, "residual", residual, scale)
