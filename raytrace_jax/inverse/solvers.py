"""The two solvers of a picture: Levenberg and Marquardt's, and Gauss-Newton steps on a problem that is corrected."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from raytrace_jax.inverse.linearize import Linearization, outer
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem import FitState, Problem
from raytrace_jax.inverse.steps import (
    Record,
    Step,
    clip,
    iterate,
    project_gradient,
    project_on_range,
    shorten_step,
)
from raytrace_jax.inverse.uncertainty import RANK_TOLERANCE
from raytrace_jax.inverse.unknowns import Values, Vector
from raytrace_jax.util.numerics import TINY

ROUNDINGS = 4
"""A change of so many roundings of the dtype is none, whatever a tolerance says."""


class LinearModel(NamedTuple):
    """The rotated residual and its derivative at `origin`: a few numbers on one device, whose count no size changes."""

    origin: Vector
    residual: Float[Array, " rows"]
    jacobian: Float[Array, "rows parameters"]


def linear_residual(y: Vector, model: LinearModel):
    """The residual as a function of the unknowns, exact at the point where the solver asks for it.

    Levenberg-Marquardt asks for value and derivative at one point a step. Another program computes these beforehand. So
    the solver's own step is tiny, compiles in no time, and knows nothing of pictures.
    """
    return model.residual + model.jacobian @ (y - model.origin), None


class Trust(NamedTuple):
    """Levenberg-Marquardt's memory: optimistix' state, and how many steps in a row were rejected."""

    state: Any
    rejected: int


def levenberg_marquardt(
    problem: Problem,
    y: Vector,
    stage: Stage,
    record: Record = lambda *step: None,
    linearize: Callable[[Vector], Linearization] | None = None,
) -> FitState:
    """Minimise the sum of squares from `y`.

    A point whose cost or derivatives are not finite is never accepted: the solver shortens its step. If the start is
    such a point, no step is known, and the solve ends there without having come to rest.
    """
    limit = jnp.maximum(jnp.asarray(stage.relative, y.dtype), ROUNDINGS * jnp.finfo(y.dtype).eps)
    # `limit` is an array, not the float that the annotation says: a new tolerance must not compile anew.
    solver = optx.LevenbergMarquardt(rtol=cast(float, limit), atol=cast(float, limit))

    def at(y: Vector) -> FitState:
        linearization = problem.linearize(y, stage) if linearize is None else linearize(y)
        return FitState(problem, y, stage, linearization)

    def model_of(seen: FitState) -> LinearModel:
        projected = project_gradient(seen.linearization, seen.y, problem.unknowns)
        numbers = (np.asarray(part) for part in (projected.residual, projected.jacobian))
        return LinearModel(seen.y, *map(jnp.asarray, numbers))

    def look(last: Step[Trust], y: Vector) -> FitState:
        return last.best if y is last.best.y else at(y)

    def propose(last: Step[Trust], seen: FitState) -> Step[Trust]:
        # Let the solver accept or reject the point, and choose the next one. It rejects what is not finite.
        y, state, done = advance(solver, last.best.y, model_of(seen), last.memory.state)
        accepted = seen.linearization.is_finite and bool(jnp.all(y == seen.y))
        best, rejected = (seen, 0) if accepted else (last.best, last.memory.rejected + 1)
        # Stop where no step is worth taking: the linear model takes away the fraction of the cost that J spans.
        projected = project_gradient(best.linearization, best.y, problem.unknowns)
        squares = np.sum(np.asarray(projected.residual, np.float64) ** 2)
        promised = float(np.sum(project_on_range(projected) ** 2) / max(squares, TINY))
        if bool(done) or rejected >= stage.rejected or promised < stage.decrease:
            return Step(dataclasses.replace(best, settled=True), accepted, None, Trust(state, rejected))
        # Have it try a point that is possible.
        to = jnp.asarray(shorten_step(problem, best.y, state.y_eval), y.dtype)
        state = eqx.tree_at(lambda state: state.y_eval, state, to)
        return Step(best, accepted, to, Trust(state, rejected))

    start = at(jnp.asarray(clip(y, problem.unknowns), y.dtype))
    if not start.linearization.is_finite:
        record(start.linearization.cost, False, start.y)
        return start
    begin = Step(start, True, start.y, Trust(init(solver, start.y, model_of(start)), 0))
    return iterate(begin, look, propose, stage.max_steps + 1, record)


@eqx.filter_jit
def init(solver, y, model: LinearModel):
    """The solver's first state."""
    residual = jax.eval_shape(lambda: model.residual)
    return solver.init(linear_residual, y, model, {"jac": "fwd"}, residual, None, frozenset())


@eqx.filter_jit
def advance(solver, y, model: LinearModel, state):
    """One step: accept or reject the point that was tried, and choose the next one."""
    options = {"jac": "fwd"}
    y, state, _ = solver.step(linear_residual, y, model, options, state, frozenset())
    done, _ = solver.terminate(linear_residual, y, model, options, state, frozenset())
    return y, state, done


FARTHEST = 0.1
"""A step longer than this in natural scales, beyond which the linear model does not hold, is not taken and is the last.
From near the answer 0.05 and 0.2 do the same."""

REST = 2.0
"""A solver is at rest where the next step is shorter than so many standard errors. Where the best place is at a jump of
a pixel that decides, steps go to and fro by about one, however short one makes them."""


class Pace(NamedTuple):
    """Gauss-Newton's memory of its last step.

    Args:
        move: how long the step was that was taken, in standard errors.
    """

    rounds: int
    step: Values
    fraction: float
    move: float


def gauss_newton(
    solution: FitState,
    renew: Callable[[FitState, int], Problem],
    record: Record,
    corrected: bool = False,
) -> FitState:
    """Take steps until they move nothing; the last step says whether the solver came to rest.

    A point, or a renewed problem, whose cost or derivatives are not finite is not taken. The steps then end at the
    point before, with a warning, and the solver has not come to rest.

    Args:
        renew: gives the problem to solve at a point, in a round; rounds count from 0.
        corrected: whether the problem is corrected at each point, roughly at the first one, whose step is taken anyway.
            From then on a step back over the last one goes half as far. Storing a picture makes stairs of it, over
            whose edges full steps go to and fro; places half such a step apart count as the same.
    """
    # Steps shorter than so many standard errors are not taken, nor those shorter than this in natural scales: the end
    # on targets without noise, whose errors are next to nothing. A point-sampled picture has no error of its own: with
    # 5 to 10 rounds such targets are not always met (experiments/tuning). A corrected one is right to its samples; a
    # JPEG of a checker, whose stairs make the steps of free gains go to and fro, wants more than two rounds.
    rounds, least_errors, least_scales = (5, 0.1, 3e-6) if corrected else (20, 0.01, 1e-13)
    first = 1 if corrected else 0

    def look(last: Step[Pace], y: Vector) -> FitState:
        # Renew the problem, for example with the bias found at this point, and look at it from here.
        here = dataclasses.replace(last.best, y=y)
        problem = renew(here, last.memory.rounds)
        return dataclasses.replace(here, problem=problem, linearization=problem.linearize(y, here.stage))

    def propose(last: Step[Pace], seen: FitState) -> Step[Pace]:
        problem, linearization = seen.problem, seen.linearization
        round_, before, fraction, move_before = last.memory
        if not linearization.is_finite:
            words = "a picture or a derivative has values that are not finite: the last steps of the fit end before it."
            warnings.warn(words, RuntimeWarning, stacklevel=2)
            best = dataclasses.replace(last.best, settled=False, next_move=0.0)
            return Step(best, False, None, last.memory)
        # Choose the step, from now on half as long if it takes back in the picture what the last one changed.
        free = project_gradient(linearization, seen.y, problem.unknowns)
        whole, move, between = gauss_newton_step(free), move_in_errors(free), seen.resolution
        # The first step after those that are taken anyway may lead back: its problem is a finer one.
        if corrected and round_ > first and changed(free, whole) @ changed(free, before) < 0:
            fraction, between = fraction / 2, outer(whole[:, None] / 2)
        step, move = fraction * whole, fraction * move
        # Measure how far it leads, and decide whether it is worth taking.
        y = problem.array(shorten_step(problem, seen.y, seen.y + step))
        reach = problem.scaled_distance(problem.values(y), problem.values(seen.y))
        tried, here = np.asarray(y), np.asarray(seen.y)
        is_rounding = np.abs(tried - here) <= ROUNDINGS * np.finfo(here.dtype).eps * np.maximum(np.abs(here), 1)
        is_no_step = reach < least_scales or bool(np.all(is_rounding))
        # Steps that do not get shorter follow the samples of a picture and not the scene. But the first one after those
        # that are taken anyway belongs to a finer problem, and may well be longer.
        aimless = move > move_before and round_ > first and round_ >= rounds // 2
        is_short = (move < least_errors or is_no_step) and round_ >= first
        is_at_rest = reach < FARTHEST and (move < REST or is_no_step)
        best = dataclasses.replace(seen, settled=is_at_rest, next_move=move, resolution=between)
        to = None if is_short or reach > FARTHEST or aimless else y
        return Step(best, True, to, Pace(round_ + 1, whole, fraction, move))

    begin = Step(solution, True, solution.y, Pace(0, np.zeros(len(solution.y)), 1.0, np.inf))
    return iterate(begin, look, propose, rounds, record)


def changed(linearization: Linearization, step: Values) -> Float[np.ndarray, " rows"]:
    """The change of the rotated residual by a step."""
    return np.asarray(linearization.jacobian, np.float64) @ step


def gauss_newton_step(linearization: Linearization) -> Values:
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
    # A loss that curves up by less than a quarter of its weights in some direction sees outliers first. A step from
    # there is that of its weights, which does not overshoot.
    if len(bends) and bends[0] > 0.25:
        pull = turned @ ((turned.T @ pull) / bends)
    return -whiten @ pull


def move_in_errors(linearization: Linearization) -> float:
    """Length of the next step in standard errors.

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
