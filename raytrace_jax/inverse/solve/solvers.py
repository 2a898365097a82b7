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

from raytrace_jax.inverse.judge.uncertainty import RANK_TOLERANCE
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.linearize import Linearization
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.problem.unknowns import Values, Vector
from raytrace_jax.inverse.solve.steps import (
    Record,
    Step,
    clip,
    iterate,
    project_gradient,
    project_on_range,
    shorten_step,
)
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
"""The trust radius of a step, in natural scales, beyond which the linear model does not hold: a longer one is not taken
and is the last. From near the answer 0.05 and 0.2 do the same."""


class Pace(NamedTuple):
    """Gauss-Newton's memory.

    Args:
        promised: by how much the step from the best place would lower the sum of squares, were the problem linear.
        in_vain: steps in a row whose end promises more than half of that.
    """

    promised: float
    in_vain: int


def gauss_newton(start: FitState, look: Callable[[Vector], FitState], record: Record, rounds: int = 20) -> FitState:
    """Take steps without asking for a lower cost, and return the place from which the next one would be shortest.

    A picture of points or of samples jumps where an edge crosses one, so that its cost holds up a solver that asks it
    to fall. A step is the estimate's distance from the answer as the derivative sees it, and its measure is what it
    promises to take off the sum of squares: `|P r|^2`, P projecting on the span of the Jacobian (the relative offset of
    Bates and Watts 1981). The steps end where a step is a tenth of a standard error or rounding, where it leaves the
    neighbourhood in which the derivative holds, or when two in a row did not halve it. What is left, the step
    that was not taken, is part of the answer's error.

    A point whose cost or derivatives are not finite is not taken. The steps then end at the point before, with a
    warning, and the solver has not come to rest.

    Args:
        start: where to begin, as `look` sees it.
        look: the problem near a point.
    """

    def propose(last: Step[Pace], seen: FitState) -> Step[Pace]:
        linearization, problem = seen.linearization, seen.problem
        if not linearization.is_finite:
            words = "a picture or a derivative has values that are not finite: the last steps of the fit end before it."
            warnings.warn(words, RuntimeWarning, stacklevel=2)
            return Step(dataclasses.replace(last.best, settled=False, next_move=0.0), False, None, last.memory)
        # Measure the step, and see whether the one before was worth it.
        free = project_gradient(linearization, seen.y, problem.unknowns)
        promised = float(np.sum(project_on_range(free) ** 2))
        in_vain = 0 if promised < 0.5 * last.memory.promised else last.memory.in_vain + 1
        # The loss's own curvature makes longer steps than its weights, which overshoot where residuals are roundings.
        step, move = gauss_newton_step(free, curved=in_vain == 0), move_in_errors(free)
        to = problem.array(shorten_step(problem, seen.y, seen.y + step))
        reach = problem.distance(problem.values(to), problem.values(seen.y))
        best, is_best = last.best, promised < last.memory.promised
        if is_best:
            best = dataclasses.replace(seen, settled=reach < FARTHEST, next_step=step, next_move=move)
        # Choose the next place, or end.
        here = np.asarray(seen.y)
        rounding = ROUNDINGS * np.finfo(here.dtype).eps * np.maximum(np.abs(here), 1)
        is_no_step = move < 0.1 or bool(np.all(np.abs(np.asarray(to) - here) <= rounding))
        ends = is_no_step or in_vain == 2 or reach >= FARTHEST
        return Step(best, is_best, None if ends else to, Pace(min(promised, last.memory.promised), in_vain))

    begin = Step(start, True, start.y, Pace(np.inf, 0))
    return iterate(begin, lambda last, y: start if y is start.y else look(y), propose, rounds, record)


def gauss_newton_step(linearization: Linearization, curved: bool = True) -> Values:
    """The step to the minimum of the loss near a point; it is 0 along what the picture does not determine.

    Least squares with the loss's weights take the weights for fixed and come up short, since a residual that grows
    counts less: each step leaves `1 - E rho'' / E w` of the error, two fifths beside Gaussian noise. So the loss's own
    curvature is taken where there are no more outliers than that. The step is computed in numpy: the triangle has few
    rows and is needed in double precision, and nothing is compiled.

    Args:
        curved: whether to take that curvature; without it the weights.
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
    if curved and len(bends) and bends[0] > 0.25:
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
