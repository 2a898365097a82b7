"""One level of the pyramid: optimistix's Levenberg-Marquardt, stepped by hand."""

from collections.abc import Callable

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

MAX_REJECTED = 10
"""Rejected steps in a row after which a level is at rest: no step of a thousandth the length still helps."""


class LeastSquares:
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
    linearize: Callable[[Float[Array, " parameters"], float], Linearization],
    progress: LeastSquares,
    level: int,
    sigma: float,
    finest: bool,
    max_steps: int,
    record: Callable[..., None],
) -> bool:
    """Solve one level from `progress.y`, leaving the best point there; tell whether the solver came to rest.

    Args:
        linearize: the problem at given unknowns and blur.
        progress: start and, at every accepted step, the result.
        level, sigma: the level's number and blur, passed on to `record`.
        finest: solve to the finest tolerance.
        max_steps: steps at most.
        record: called with (level, sigma, step, cost, accepted, unknowns) after each step.
    """
    y = progress.y
    tolerance = jnp.asarray(FINE_TOLERANCE if finest else COARSE_TOLERANCE, y.dtype)
    tolerance = jnp.maximum(tolerance, 4 * jnp.finfo(y.dtype).eps)
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    found = linearize(y, sigma)
    state = init(solver, y, (y, found))
    rejected = 0
    for step in range(max_steps + 1):
        tried = state.y_eval
        found = linearize(tried, sigma) if step else found
        y, state, done = advance(solver, y, (tried, found), state)
        accepted = bool(jnp.all(y == tried))
        rejected = 0 if accepted else rejected + 1
        progress.y = y
        cost = float(0.5 * jnp.sum(state.f_info.residual**2))
        record(level, sigma, step, cost, accepted, y)
        if bool(done) or rejected >= MAX_REJECTED:
            return True
    return False


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

