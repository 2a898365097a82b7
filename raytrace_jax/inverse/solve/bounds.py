"""Unknowns that have run to the bound of their parameter: a solver holds them there while the cost falls beyond it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.problem.unknowns import Unknowns

MOST_HALVINGS = 10
"""Of a step that leads into the impossible; a thousandth of it is none."""


def within(y: Float[Array, " parameters"], unknowns: Unknowns) -> Float[np.ndarray, " parameters"]:
    """Unknowns, those that are beyond their reach at its end."""
    return np.clip(np.asarray(y), *unknowns.reach)


def cut_short(problem: Problem, origin: Float[Array, " parameters"], tried) -> Float[np.ndarray, " parameters"]:
    """Where a step leads within the reach of the unknowns; halved until no ball has swallowed the camera."""
    place, start = within(tried, problem.unknowns), np.asarray(origin)
    for _ in range(MOST_HALVINGS):
        if problem.is_possible(problem.array(place)):
            return place
        place = (place + start) / 2
    return start


def at_bounds(y: Float[Array, " parameters"], unknowns: Unknowns) -> Int[np.ndarray, " parameters"]:
    """At which end of its reach each unknown is: -1 at the lower, 1 at the upper, 0 at none."""
    lower, upper = unknowns.reach
    # In the unknowns' dtype, in which they were put there.
    place = np.asarray(y)
    return np.where(place <= lower.astype(place.dtype), -1, np.where(place >= upper.astype(place.dtype), 1, 0))


def bounds_reached(y: Float[Array, " parameters"], unknowns: Unknowns) -> tuple[tuple[str, float], ...]:
    """The name of each parameter that is at a bound, with the bound."""
    rows = zip(unknowns.names, unknowns.transforms, at_bounds(y, unknowns), strict=True)
    return tuple((name, bounded.lower if side < 0 else bounded.upper) for name, bounded, side in rows if side)


def held(linearization: Linearization, y: Float[Array, " parameters"], unknowns: Unknowns) -> Linearization:
    """A linearisation in which unknowns at a bound do not move if the cost falls beyond it (a projected gradient)."""
    side = at_bounds(y, unknowns)
    if not side.any():
        return linearization
    triangle = np.asarray(linearization.jacobian)
    downhill = -triangle.T @ np.asarray(linearization.residual)
    return dataclasses.replace(linearization, jacobian=jnp.asarray(np.where(side * downhill > 0, 0, triangle)))


def spanned(linearization: Linearization) -> Float[np.ndarray, " directions"]:
    """The part of the rotated residual that the Jacobian spans, in orthogonal directions."""
    triangle = np.asarray(linearization.jacobian, np.float64)
    residual = np.asarray(linearization.residual, np.float64)
    moves = np.any(triangle != 0, axis=0)
    return residual[:-1] if moves.all() else np.linalg.qr(triangle[:, moves])[0].T @ residual
