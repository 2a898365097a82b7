"""One level of the pyramid: optimistix's Levenberg-Marquardt, stepped by hand."""

from collections.abc import Callable
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from .residual import Linearization

COARSE_TOLERANCE = 1e-3
"""Relative tolerance of a level whose answer is only the next one's start."""

FINE_TOLERANCE = 1e-9
"""Relative tolerance of the last level (float32 stops where it resolves no more)."""

MAX_REJECTED = 4
"""Rejected steps in a row after which a level is at rest: no step of a hundredth the length still helps."""


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
    tolerance: float,
    max_steps: int,
    record: Callable[[int, float, bool, Float[Array, " parameters"]], None],
) -> Linearization | None:
    """Solve one level from `progress.y`, leaving the best point there.

    Args:
        linearize: the problem at given unknowns.
        progress: start and, at every accepted step, the result.
        tolerance: relative tolerance at which to stop.
        max_steps: steps at most.
        record: called with (step, cost, accepted, unknowns) after each step.

    Returns:
        The linearisation at the best point, or None if the solver was still moving after `max_steps`.
    """
    y = progress.y
    limit = jnp.maximum(jnp.asarray(tolerance, y.dtype), 4 * jnp.finfo(y.dtype).eps)
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
        if bool(done) or rejected >= MAX_REJECTED:
            return best
    return None


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
