"""Gauss-Newton steps that do not ask whether the cost falls, for problems that change a little with each step."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization, outer
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.bounds import cut_short, held
from raytrace_jax.inverse.solve.iterate import Step, iterate
from raytrace_jax.inverse.solve.least_squares import ROUNDINGS
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine_options import RefineOptions
from raytrace_jax.inverse.statistics.uncertainty import RANK_TOLERANCE
from raytrace_jax.util.numerics import TINY

FARTHEST = 0.1
"""A step longer than this in natural scales leaves the neighbourhood of the minimum, where the linear model holds: it
is not taken, and is the last. From near the answer 0.05 and 0.2 do the same (experiments/tuning)."""

REST = 2.0
"""A solver has come to rest where the next step is shorter than so many standard errors. Where the best place is at a
jump of a pixel that decides, steps go to and fro by about one standard error, however short one makes them."""

LEAST_BEND = 0.25
"""A loss that curves up by less than this share of its weights in some direction sees outliers first: a step from there
is that of its weights, which does not overshoot."""


@dataclasses.dataclass(frozen=True)
class StopRule:
    """When the steps end.

    Args:
        max_rounds: steps at most.
        min_step_sigmas: a step shorter than so many standard errors is not taken.
        min_step_scales: a step shorter than this in natural scales of the parameters is not taken. It ends the steps
            on targets without noise, whose standard errors are next to nothing.
        min_rounds: so many steps are taken however short they are.
        halves: whether a step back over the last one goes half as far. Storing a picture makes stairs of it where it is
            smooth, and full steps go to and fro over their edges. Places half such a step apart count as not told
            apart.
    """

    max_rounds: int
    min_step_sigmas: float
    min_step_scales: float
    min_rounds: int = 0
    halves: bool = False


class Pace(NamedTuple):
    """What Gauss-Newton remembers of its last step.

    Args:
        rounds: how many were taken.
        step: the last one, whole.
        share: how much of a step is taken.
        move: how long the step was that was taken, in standard errors.
    """

    rounds: int
    step: Float[np.ndarray, " parameters"]
    share: float
    move: float


def gauss_newton(
    solution: FitState,
    renew: Callable[[FitState, int], Problem],
    until: StopRule,
    options: RefineOptions,
    recorder: Recorder,
) -> FitState:
    """Take steps until they move nothing; the last step says whether the solver came to rest.

    A point, or a renewed problem, whose cost or derivatives are not finite is not taken. The steps then end at the
    point before, with a warning, and the solver has not come to rest.

    Args:
        solution: where to start.
        renew: gives the problem to solve at a point, in a round; rounds count from 0.
        until: when to stop.
        options: numbers for the history.
        recorder: is told of everything.
    """

    def look(last: Step[Pace], y: Float[Array, " parameters"]) -> FitState:
        # Renew the problem, for example with the bias found at this point, and look at it from here.
        here = dataclasses.replace(last.best, y=y)
        problem = renew(here, last.memory.rounds)
        return dataclasses.replace(here, problem=problem, linearization=problem.linearize(y, here.comparison))

    def propose(last: Step[Pace], seen: FitState) -> Step[Pace]:
        problem, linearization = seen.problem, seen.linearization
        round_, before, share, move_before = last.memory
        if not linearization.is_finite:
            words = "a picture or a derivative has values that are not finite: the last steps of the fit end before it."
            warnings.warn(words, RuntimeWarning, stacklevel=2)
            best = dataclasses.replace(last.best, settled=False, next_move=0.0)
            return Step(best, False, None, last.memory)
        # Choose the step, from now on half as long if it takes back in the picture what the last one changed.
        free = held(linearization, seen.y, problem.unknowns)
        whole, move, between = gauss_newton_step(free), move_in_errors(free), seen.resolution
        # The first step after those that are taken anyway may lead back: its problem is a finer one.
        if until.halves and round_ > until.min_rounds and changed(free, whole) @ changed(free, before) < 0:
            share, between = share / 2, outer(whole[:, None] / 2)
        step, move = share * whole, share * move
        # Measure how far it leads, and decide whether it is worth taking.
        y = problem.array(cut_short(problem, seen.y, seen.y + step))
        reach = problem.scaled_distance(problem.values(y), problem.values(seen.y))
        is_no_step = reach < until.min_step_scales or is_rounding(np.asarray(y), np.asarray(seen.y))
        # Steps that do not get shorter follow the samples of a picture and not the scene. But the first one after those
        # that are taken anyway belongs to a finer problem, and may well be longer.
        aimless = move > move_before and round_ > until.min_rounds and round_ >= until.max_rounds // 2
        is_short = (move < until.min_step_sigmas or is_no_step) and round_ >= until.min_rounds
        is_at_rest = reach < FARTHEST and (move < REST or is_no_step)
        best = dataclasses.replace(seen, settled=is_at_rest, next_move=move, resolution=between)
        to = None if is_short or reach > FARTHEST or aimless else y
        return Step(best, True, to, Pace(round_ + 1, whole, share, move))

    begin = Step(solution, True, solution.y, Pace(0, np.zeros(len(solution.y)), 1.0, np.inf))
    return iterate(begin, look, propose, until.max_rounds, recorder.level(options.candidate, options.level))


def changed(linearization: Linearization, step: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " rows"]:
    """The change of the rotated residual by a step."""
    return np.asarray(linearization.jacobian, np.float64) @ step


def is_rounding(tried: Float[np.ndarray, " parameters"], here: Float[np.ndarray, " parameters"]) -> bool:
    """Whether a step goes no farther than the unknowns are rounded, as solvers at rest do, back and forth."""
    return bool(np.all(np.abs(tried - here) <= ROUNDINGS * np.finfo(here.dtype).eps * np.maximum(np.abs(here), 1)))


def gauss_newton_step(linearization: Linearization) -> Float[np.ndarray, " parameters"]:
    """The step to the minimum of the loss near a point; it is 0 along what the picture does not determine.

    Least squares with the loss's weights take the weights for fixed and come up short, since a residual that grows
    counts less: each step leaves `1 - E rho'' / E w` of the error, two fifths beside Gaussian noise. So the loss's own
    curvature is taken where there are no more outliers than that. The step is computed in numpy: the triangle has few
    rows and is needed in double precision, and nothing is compiled.
    """
    triangle, residual, curvature = (
        np.asarray(part, np.float64)
        for part in (linearization.jacobian, linearization.residual, linearization.curvature)
    )
    if not all(np.isfinite(part).all() for part in (triangle, residual, curvature)):
        return np.zeros(triangle.shape[1])  # Squares beyond the dtype: no step is known.
    # Directions in which the weighted problem's `J^T J` is the identity.
    pulls, strengths, directions = np.linalg.svd(triangle, full_matrices=False)
    strong = strengths > RANK_TOLERANCE * max(strengths[0], TINY)
    whiten = (directions[strong] / strengths[strong, None]).T
    pull = pulls[:, strong].T @ residual
    bends, turned = np.linalg.eigh(whiten.T @ curvature @ whiten)
    if len(bends) and bends[0] > LEAST_BEND:
        pull = turned @ ((turned.T @ pull) / bends)
    return -whiten @ pull


def move_in_errors(linearization: Linearization) -> float:
    """How far the next step would go, in standard errors.

    That is the score `g = J^T W r` over its own scatter, `(g^T P^-1 g / p)^(1/2)`, where `P` is the sum over residuals
    of each one's `g g^T` (the score test of White 1982). It is 1 on average where residuals pull at random, whatever
    their sizes. Error bars from the noise of all residuals together would not do: beside them the pull of the few
    residuals at edges, which decide, seems far too large.
    """
    triangle, residual = (np.asarray(part, np.float64) for part in (linearization.jacobian, linearization.residual))
    score = triangle.T @ residual
    scatter = np.asarray(linearization.pixel_scatter, np.float64)
    length = np.sqrt(np.diagonal(scatter))
    moves = np.any(triangle != 0, axis=0) & (length > 0)
    if not moves.any():
        return 0.0
    # With each parameter in units of its own scatter `P` is a correlation matrix. Its inverse is bounded along
    # directions that no residual sees.
    unit, scatter = score[moves] / length[moves], scatter[np.ix_(moves, moves)]
    scatter = scatter / np.outer(length[moves], length[moves])
    strengths, directions = np.linalg.eigh(scatter)
    seen = np.maximum(strengths, RANK_TOLERANCE)
    return float(np.sqrt(np.mean((directions.T @ unit) ** 2 / seen)))
