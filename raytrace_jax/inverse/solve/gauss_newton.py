"""Gauss-Newton steps that do not ask whether the cost falls, for problems that change a little with each step."""

import dataclasses
import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.uncertainty import RANK_TOLERANCE
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization, outer
from raytrace_jax.inverse.solve.bounds import cut_short, held
from raytrace_jax.inverse.solve.least_squares import ROUNDINGS
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.state import FitState, RefineOptions

FARTHEST = 0.1
"""A step longer than this in natural scales leaves the neighbourhood of the minimum, where the linear model holds: it
is not taken, and is the last. From near the answer 0.05 and 0.2 do the same (experiments/tuning)."""

REST = 2.0
"""A solver has come to rest where the next step is shorter than so many standard errors. Where the best place is at a
jump of a pixel that decides, steps go to and fro by about one, however short one makes them."""


@dataclasses.dataclass(frozen=True)
class StopRule:
    """When the steps end.

    Args:
        rounds: steps at most.
        move: a step shorter than so many standard errors is not taken.
        reach: nor one shorter than this in natural scales of the parameters, for targets without noise.
        least: as many steps are taken however short they are.
        halves: whether a step back over the last one goes half as far. Storing makes stairs of a smooth picture, and
            full steps go to and fro over their edges; what is left between two such steps is not told apart.
    """

    rounds: int
    move: float
    reach: float
    least: int = 0
    halves: bool = False


def gauss_newton(
    solution: FitState,
    renew: Callable[[FitState, int], Problem],
    until: StopRule,
    options: RefineOptions,
    recorder: Recorder,
) -> FitState:
    """Take steps until they move nothing; whether the solver came to rest is what the last of them says.

    A point, or a renewed problem, whose cost or derivatives are not finite is not taken: the steps end at the one
    before, with a warning, and the solver has not come to rest.

    Args:
        solution: where to start.
        renew: the problem to solve at a point, in a round; they count from 0.
        until: when to stop.
        options: numbers for the history.
        recorder: is told of everything.
    """
    last_move, is_at_rest = np.inf, solution.settled
    last_step, share, between = np.zeros(len(solution.y)), 1.0, solution.resolution
    before = solution
    record = recorder.level(options.candidate, options.level, 0.0, recorder.steps_at(options.candidate, options.level))
    for round_ in range(until.rounds):
        problem = renew(solution, round_)
        linearization = problem.linearize(solution.y, solution.comparison)
        if not linearization.is_finite:
            record(round_, linearization.cost, False, before.y)
            words = "a picture or a derivative has values that are not finite: the last steps of the fit end before it."
            warnings.warn(words, RuntimeWarning, stacklevel=2)
            return dataclasses.replace(before, settled=False)
        record(round_, linearization.cost, True, solution.y)
        free = held(linearization, solution.y, problem.unknowns)
        step, move = gauss_newton_step(free), move_in_errors(free)
        # The first after the steps that are taken anyway may lead back: its problem is a finer one.
        if until.halves and round_ > until.least and changed(free, step) @ changed(free, last_step) < 0:
            share, between = share / 2, outer(step[:, None] / 2)
        last_step, step, move = step, share * step, share * move
        y = problem.array(cut_short(problem, solution.y, solution.y + step))
        reach = problem.scaled_distance(problem.values(y), problem.values(solution.y))
        is_no_step = reach < until.reach or is_rounding(np.asarray(y), np.asarray(solution.y))
        before = solution = dataclasses.replace(solution, problem=problem, linearization=linearization)
        # Steps that do not get shorter follow the samples of a picture and not the scene; but the first after those
        # that are taken anyway is of a finer problem, and may well be longer.
        aimless = move > last_move and round_ > until.least and round_ >= until.rounds // 2
        is_at_rest = reach < FARTHEST and (move < REST or is_no_step)
        last_move = move
        is_short = (move < until.move or is_no_step) and round_ >= until.least
        if is_short or reach > FARTHEST or aimless:
            break
        if round_ < until.rounds - 1:
            solution = dataclasses.replace(solution, y=y)
    return dataclasses.replace(solution, settled=is_at_rest, next_move=last_move, resolution=between)


def changed(linearization: Linearization, step: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " rows"]:
    """What a step changes of the rotated residual."""
    return np.asarray(linearization.jacobian, np.float64) @ step


def is_rounding(tried: Float[np.ndarray, " parameters"], here: Float[np.ndarray, " parameters"]) -> bool:
    """Whether a step goes no farther than the unknowns are rounded: one back and forth is as far."""
    return bool(np.all(np.abs(tried - here) <= ROUNDINGS * np.finfo(here.dtype).eps * np.maximum(np.abs(here), 1)))


def gauss_newton_step(linearization: Linearization) -> Float[np.ndarray, " parameters"]:
    """The step to the minimum of the linear model; none along what the picture does not determine.

    In numpy: the triangle has a few rows, is needed in double precision whatever the picture's, and compiles nothing.
    """
    triangle, residual = (np.asarray(part, np.float64) for part in (linearization.jacobian, linearization.residual))
    if not (np.isfinite(triangle).all() and np.isfinite(residual).all()):  # Squares beyond the dtype: no step is known.
        return np.zeros(triangle.shape[1])
    return -np.linalg.lstsq(triangle, residual, rcond=RANK_TOLERANCE)[0]


def move_in_errors(linearization: Linearization) -> float:
    """How far the next step would go, in standard errors.

    The score `g = J^T W r` over its own scatter, `(g^T P^-1 g / p)^(1/2)` with `P` the sum over residuals of each one's
    `g g^T` (the score test of White 1982): 1 on average where residuals pull at random, whatever their sizes. Of the
    noise of all residuals together a few that decide, at edges, would seem far too large.
    """
    triangle, residual = (np.asarray(part, np.float64) for part in (linearization.jacobian, linearization.residual))
    score = triangle.T @ residual
    scatter = np.asarray(linearization.pixel_scatter, np.float64)
    length = np.sqrt(np.diagonal(scatter))
    moves = np.any(triangle != 0, axis=0) & (length > 0)
    if not moves.any():
        return 0.0
    unit, scatter = score[moves] / length[moves], scatter[np.ix_(moves, moves)]
    scatter = scatter / np.outer(length[moves], length[moves])
    strengths, directions = np.linalg.eigh(scatter)
    seen = np.maximum(strengths, RANK_TOLERANCE)
    return float(np.sqrt(np.mean((directions.T @ unit) ** 2 / seen)))
