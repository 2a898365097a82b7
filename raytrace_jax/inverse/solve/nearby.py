"""Whether a point-sampled picture is explained better a few error bars away."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.bounds import cut_short
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine_options import RefineOptions
from raytrace_jax.inverse.statistics.scatter import leverages
from raytrace_jax.inverse.statistics.uncertainty import quantify_uncertainty
from raytrace_jax.util.numerics import finite_or_last


class NearbyLook(NamedTuple):
    """When places around a solution are tried, and how many.

    Args:
        decisive: leverage from which on a residual decides. Of `pebbles.txt`, 40 x 30 pixels, it was 0.35 to 0.99 where
            a solve had come to rest on the wrong side of a jump; at the right place of the assignment's scene,
            160 x 120, it is 0.29, and no time goes there.
        draws: places a round. Of 20 noisy pictures of `pebbles.txt`, 40 x 30 pixels, 8 ended at a worse place than the
            truth without a look nearby, 2 do with these numbers (experiments/estimates).
        spreads: how far the places of a round lie, in error bars: first near, then far, as bars from the wrong side of
            a jump are too small; each twice, as draws are random. The look ends when none has led to a better place.
        most_rounds: rounds, should every one lead to a better place.
        better: a sum of losses has to fall by this much, in units of the loss's scale: a solver leaves less.
    """

    decisive: float = 0.3
    draws: int = 32
    spreads: tuple[float, ...] = (2.0, 8.0, 2.0, 8.0)
    most_rounds: int = 12
    better: float = 0.01


LOOK_NEARBY = NearbyLook()


def look_nearby(
    solution: FitState,
    solve: Callable[[Float[Array, " parameters"], RefineOptions], FitState],
    options: RefineOptions,
    recorder: Recorder,
) -> FitState:
    """The solution, or a better one that a solve from the best of some random places around it leads to.

    A point-sampled picture jumps where an edge crosses a pixel. If one pixel at the rim of glass decides, each jump may
    have a minimum on either side. If no residual decides, there is nothing to be looked for.

    Args:
        solution: where a solve came to rest.
        solve: solves from a place.
        options: how to solve.
        recorder: is told of it.
    """
    random, failures = np.random.default_rng(0), 0
    for _ in range(LOOK_NEARBY.most_rounds):
        if failures == len(LOOK_NEARBY.spreads) or not is_decided_by_few(solution):
            break
        recorder.phase("looking for a better place nearby")
        place = best_of(solution, LOOK_NEARBY.spreads[failures], random)
        found = solve(place, options)
        # Losses compare at one scale only.
        scale = max(solution.comparison.loss_scale, found.comparison.loss_scale)
        is_better = loss_of(found, scale) < loss_of(solution, scale) - LOOK_NEARBY.better
        solution, failures = (found, 0) if is_better else (solution, failures + 1)
    return solution


def is_decided_by_few(solution: FitState) -> bool:
    """Whether an estimate follows single residuals."""
    columns = np.asarray(solution.linearization.columns, np.float64)
    weight = solution.under_loss("weight")
    return bool(np.max(leverages(columns.reshape(len(columns), -1), weight.reshape(-1))) > LOOK_NEARBY.decisive)


def best_of(solution: FitState, spread: float, random: np.random.Generator) -> Float[Array, " parameters"]:
    """The unknowns with the least loss of some random places around a solution; its own if its errors are unknown."""
    problem, comparison = solution.problem, solution.comparison
    covariance = quantify_uncertainty(solution, None).covariance
    if np.isnan(covariance).any():
        return solution.y
    # Draw from a normal distribution with the solution's covariance, widened, in the unknowns.
    slope = problem.slopes(solution.y)
    strengths, directions = np.linalg.eigh(covariance / np.outer(slope, slope))
    root = directions * np.sqrt(np.maximum(strengths, 0))
    steps = spread * random.normal(size=(LOOK_NEARBY.draws, len(slope))) @ root.T
    places = [problem.array(cut_short(problem, solution.y, solution.y + step)) for step in steps]

    def loss_at(y: Float[Array, " parameters"]) -> float:
        state = FitState.at(problem, y, comparison)
        return finite_or_last(loss_of(state, comparison.loss_scale) if state.linearization.is_finite else np.nan)

    return min(places, key=loss_at)


def loss_of(solution: FitState, scale: float) -> float:
    """The sum of losses at a scale, in units of its square."""
    return float(np.sum(solution.under_loss("residual", scale) ** 2)) / (2 * scale**2)
