"""The Levenberg-Marquardt solver of optimistix, stepped by hand."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.bounds import cut_short, held, spanned, within
from raytrace_jax.inverse.solve.iterate import Record, Step, iterate
from raytrace_jax.util.numerics import TINY


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """When a solve is at rest.

    Args:
        relative: change of unknowns and cost in proportion to themselves (float32 stops where it resolves no more).
        decrease: share of the cost that the linear model still promises to take away; it is what the estimate is off,
            squared, in units of its error bar, up to the number of residuals (the relative offset of Bates and Watts
            1981).
        rejected: rejected steps in a row: no shorter step helps either.
    """

    relative: float
    decrease: float
    rejected: int


ROUNDINGS = 4
"""A change of so many roundings of the dtype is none, whatever a tolerance says."""


class LinearModel(NamedTuple):
    """What the solver is told of a linearisation: a few numbers on one device, whose count no picture's size changes.

    Args:
        origin: where it was taken.
        residual, jacobian: the rotated residual and its derivative there.
    """

    origin: Float[Array, " parameters"]
    residual: Float[Array, " rows"]
    jacobian: Float[Array, "rows parameters"]


def linear_model(origin: Float[Array, " parameters"], linearization: Linearization) -> LinearModel:
    """The linear model that belongs to a linearisation."""
    numbers = (np.asarray(part) for part in (linearization.residual, linearization.jacobian))
    return LinearModel(origin, *map(jnp.asarray, numbers))


def linear_residual(y: Float[Array, " parameters"], model: LinearModel):
    """The residual as a function of the unknowns, exact at the point where the solver asks for it.

    Levenberg-Marquardt asks for value and derivative at one point a step. Another program computes these beforehand. So
    the solver's own step is tiny, compiles in no time, and knows nothing of pictures.
    """
    return model.residual + model.jacobian @ (y - model.origin), None


Linearize = Callable[[Float[Array, " parameters"]], Linearization]


class Trust(NamedTuple):
    """What Levenberg-Marquardt remembers: optimistix' state, and how many steps in a row were rejected."""

    state: Any
    rejected: int


def levenberg_marquardt(
    problem: Problem,
    y: Float[Array, " parameters"],
    comparison: Comparison,
    tolerance: Tolerance,
    max_steps: int,
    record: Record = lambda *step: None,
    linearize: Linearize | None = None,
) -> FitState:
    """Minimise the sum of squares from `y`.

    A point whose cost or derivatives are not finite is never accepted: the solver shortens its step. If the start is
    such a point, no step is known, and the solve ends there without having come to rest.

    Args:
        problem: what is solved.
        y: where to start.
        comparison: how picture and target are compared.
        tolerance: when to stop.
        max_steps: steps at most.
        record: called with (step, cost, accepted, unknowns) after each step.
        linearize: linearises at given unknowns; by default as the problem does.

    Returns:
        The best point that was found.
    """
    limit = jnp.maximum(jnp.asarray(tolerance.relative, y.dtype), ROUNDINGS * jnp.finfo(y.dtype).eps)
    # `limit` is an array, not the float that the annotation says: a new tolerance must not compile anew.
    solver = optx.LevenbergMarquardt(rtol=cast(float, limit), atol=cast(float, limit))

    def at(y: Float[Array, " parameters"]) -> FitState:
        linearization = problem.linearize(y, comparison) if linearize is None else linearize(y)
        return FitState(problem, y, comparison, linearization)

    def told(seen: FitState) -> LinearModel:
        return linear_model(seen.y, held(seen.linearization, seen.y, problem.unknowns))

    def look(last: Step[Trust], y: Float[Array, " parameters"]) -> FitState:
        return last.best if y is last.best.y else at(y)

    def propose(last: Step[Trust], seen: FitState) -> Step[Trust]:
        # Let the solver accept or reject the point, and choose the next one. It rejects what is not finite.
        y, state, done = advance(solver, last.best.y, told(seen), last.memory.state)
        accepted = seen.linearization.is_finite and bool(jnp.all(y == seen.y))
        best, rejected = (seen, 0) if accepted else (last.best, last.memory.rejected + 1)
        # Stop where no step is worth taking.
        promised = promised_decrease(held(best.linearization, best.y, problem.unknowns))
        if bool(done) or rejected >= tolerance.rejected or promised < tolerance.decrease:
            return Step(dataclasses.replace(best, settled=True), accepted, None, Trust(state, rejected))
        # Have it try a point that is possible.
        to = jnp.asarray(cut_short(problem, best.y, state.y_eval), y.dtype)
        state = eqx.tree_at(lambda state: state.y_eval, state, to)
        return Step(best, accepted, to, Trust(state, rejected))

    start = at(jnp.asarray(within(y, problem.unknowns), y.dtype))
    if not start.linearization.is_finite:
        record(0, start.linearization.cost, False, start.y)
        return start
    begin = Step(start, True, start.y, Trust(init(solver, start.y, told(start)), 0))
    return iterate(begin, look, propose, max_steps + 1, record)


def promised_decrease(linearization: Linearization) -> float:
    """The share of the cost that the linear model would take away: the share of the residual that J spans."""
    squares = np.asarray(linearization.residual, np.float64) ** 2
    return float(np.sum(spanned(linearization) ** 2) / max(np.sum(squares), TINY))


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
