"""The last level: the minima of the small pictures, refined on the whole picture."""

from typing import Literal

import jax.numpy as jnp
import numpy as np

from raytrace_jax.inverse.judge.verdict import EVIDENCE, evidence, explains
from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.losses import LOSSES
from raytrace_jax.inverse.problem.problem import Problem, rms_residual, weighted_residual
from raytrace_jax.inverse.result import Minimum
from raytrace_jax.inverse.solve.last_level import Finished, LastLevel, Sampling, finish, likelier_sampling
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.search import Levels, Solved, apart

MOST_RIVALS = 2
"""How many runner-ups are solved to the end, when the small pictures do not tell them from the best."""

SAME_END = 1e-3
"""Ends nearer to each other than this, in natural scales of the parameters, are one."""

FIRST_EVIDENCE = 2 * EVIDENCE
"""Evidence on small pictures, which are a coarse model, below which a runner-up is solved to the end."""


def refine(
    problem: Problem,
    solved: list[Solved],
    levels: Levels,
    edges: str,
    target_sampling: Sampling,
    loss: LossName | Literal["auto"],
    sigma: float | None,
    max_steps: int,
    recorder: Recorder,
) -> tuple[list[Solved], Finished]:
    """Solve the best minimum to the end, and those that the small pictures do not tell from it; the best comes first.

    Returns:
        All minima, those that were solved to the end with their values and evidence there; and the best one.
    """
    if target_sampling == "auto":
        recorder.phase("telling how the target was sampled")
        target_sampling = recorder.stage("sampling", lambda: likelier_sampling(problem, solved[0].y))
    sampled = "point" if target_sampling == "point" else edges
    chosen: LossName = ("cauchy" if target_sampling == "point" else "l2") if loss == "auto" else loss
    last = len(levels.sigmas)
    how = LastLevel(sampled, chosen, sigma, max_steps, last)
    recorder.phase("solving on the whole picture")

    def solve(place: Solved) -> Finished:
        number = place.minimum.candidate
        return finish(problem, place.y, how, number, recorder)

    close = [place for place in solved[1:] if place.minimum.explained and place.minimum.evidence < FIRST_EVIDENCE]
    rivals = close[:MOST_RIVALS]
    solves = [(place, solve(place)) for place in [solved[0], *rivals]]
    # Losses compare at one scale only.
    loss_scale = max(end.measure.loss_scale for _, end in solves)
    ends = sorted(
        ((place, end, under_loss(end, loss_scale)) for place, end in solves), key=lambda end: float(np.sum(end[2] ** 2))
    )
    _, winner, least = ends[0]
    scale = problem.scale()

    def at_end(place: Solved, end: Finished, residual: np.ndarray) -> Solved:
        minimum = Minimum(
            candidate=place.minimum.candidate,
            value=problem.values(end.y),
            rms_residual=rms_residual(end.problem, end.found),
            level=last,
            explained=explains(end.problem, end.found),
            evidence=evidence(least, residual),
        )
        return Solved(minimum, end.y, residual)

    best, *others = (at_end(*end) for end in ends)
    # Starts that came together on the last level are one minimum.
    distinct = [rival for rival in others if apart(rival.minimum.value, best.minimum.value, scale) > SAME_END]
    untouched = [place for place in solved[1:] if all(place is not rival for rival in rivals)]
    return [best, *distinct, *untouched], winner


def under_loss(end: Finished, scale: float) -> np.ndarray:
    """The weighted residual, such that its squares are twice the loss at that scale."""
    residual = weighted_residual(end.problem, end.found)
    return np.asarray(LOSSES[end.measure.loss].residual(residual, jnp.asarray(scale, residual.dtype)))
