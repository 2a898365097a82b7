"""One level of the pyramid: optimistix's Levenberg-Marquardt, stepped by hand."""

import dataclasses
from collections.abc import Callable
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.residual import Linearization


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """When a level is at rest.

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


COARSE = Tolerance(1e-3, 1e-2, 2)
"""Of a level whose answer is only the next one's start."""

COMPARED = Tolerance(1e-4, 1e-4, 2)
"""Of the last of these, on which minima are compared."""

FINE = Tolerance(1e-9, 1e-10, 3)
"""Of the last level."""


class Progress:
    """The best unknowns so far; they outlive an interrupt."""

    def __init__(self, y: Float[Array, " parameters"]):
        self.y = y


def linear_model(y: Float[Array, " parameters"], args: tuple[Float[Array, " parameters"], Linearization]):
    """The residual as a function of the unknowns, exact at the point where the solver asks for it.

    Levenberg-Marquardt asks for value and derivative at one point a step. These are computed beforehand, by a program
    of their own; so the solver's own step is tiny, compiles in no time, and knows nothing of pictures.
    """
    origin, found = args
    return found.residual + found.jacobian @ (y - origin), None


def solve_level(
    linearize: Callable[[Float[Array, " parameters"]], Linearization],
    progress: Progress,
    tolerance: Tolerance,
    max_steps: int,
    record: Callable[[int, float, bool, Float[Array, " parameters"]], None],
) -> Linearization | None:
    """Solve one level from `progress.y`, leaving the best point there.

    Args:
        linearize: the problem at given unknowns.
        progress: start and, at every accepted step, the result.
        tolerance: when to stop.
        max_steps: steps at most.
        record: called with (step, cost, accepted, unknowns) after each step.

    Returns:
        The linearisation at the best point, or None if the solver was still moving after `max_steps`.
    """
    y = progress.y
    limit = jnp.maximum(jnp.asarray(tolerance.relative, y.dtype), 4 * jnp.finfo(y.dtype).eps)
    # An array, not the float that the annotation says: a new tolerance must not compile anew.
    solver = optx.LevenbergMarquardt(rtol=cast(float, limit), atol=cast(float, limit))
    best = found = linearize(y)
    state = init(solver, y, (y, found))
    rejected = 0
    for step in range(max_steps + 1):
        tried = state.y_eval
        found = linearize(tried) if step else found
        y, state, done = advance(solver, y, (tried, found), state)
        accepted = bool(jnp.all(y == tried))
        best = found if accepted else best
        rejected = 0 if accepted else rejected + 1
        progress.y = y
        record(step, float(0.5 * jnp.sum(best.residual**2)), accepted, y)
        if bool(done) or rejected >= tolerance.rejected or promised_decrease(best) < tolerance.decrease:
            return best
    return None


def promised_decrease(found: Linearization) -> float:
    """The share of the cost that the linear model would take away: that of the residual which J spans."""
    squares = np.asarray(found.residual, np.float64) ** 2
    return float(np.sum(squares[:-1]) / max(np.sum(squares), 1e-300))


@eqx.filter_jit
def init(solver, y, args):
    """The solver's first state."""
    residual = jax.eval_shape(lambda: args[1].residual)
    return solver.init(linear_model, y, args, {"jac": "fwd"}, residual, None, frozenset())


@eqx.filter_jit
def advance(solver, y, args, state):
    """One step: accept or reject the point that was tried, and choose the next one."""
    options = {"jac": "fwd"}
    y, state, _ = solver.step(linear_model, y, args, options, state, frozenset())
    done, _ = solver.terminate(linear_model, y, args, options, state, frozenset())
    return y, state, done
