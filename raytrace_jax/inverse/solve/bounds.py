"""Unknowns that have run to the bound of their parameter: a solver holds them there while the cost falls beyond it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.problem.unknowns import Unknowns


def within(y: Float[Array, " parameters"], unknowns: Unknowns) -> Float[np.ndarray, " parameters"]:
    """The unknowns, each of which is moved to the end of its reach where it lies beyond."""
    return np.clip(np.asarray(y), *unknowns.reach)


def cut_short(problem: Problem, origin: Float[Array, " parameters"], tried) -> Float[np.ndarray, " parameters"]:
    """The end of a step, moved into the reach of the unknowns and halved until no ball has swallowed the camera."""
    place, start = within(tried, problem.unknowns), np.asarray(origin)
    # A step that leads into the impossible is given up after ten halvings: a thousandth of it is none.
    for _ in range(10):
        if problem.is_possible(problem.array(place)):
            return place
        place = (place + start) / 2
    return start


def at_bounds(y: Float[Array, " parameters"], unknowns: Unknowns) -> Int[np.ndarray, " parameters"]:
    """The end of its reach that each unknown is at: -1 is the lower, 1 the upper, 0 neither."""
    lower, upper = unknowns.reach
    # The ends are rounded to the unknowns' dtype, in which `within` put them there.
    place = np.asarray(y)
    return np.where(place <= lower.astype(place.dtype), -1, np.where(place >= upper.astype(place.dtype), 1, 0))


def bounds_reached(y: Float[Array, " parameters"], unknowns: Unknowns) -> tuple[tuple[str, float], ...]:
    """The name of each parameter that is at a bound, with the bound."""
    rows = zip(unknowns.names, unknowns.transforms, at_bounds(y, unknowns), strict=True)
    return tuple((name, bounded.lower if side < 0 else bounded.upper) for name, bounded, side in rows if side)


def held(linearization: Linearization, y: Float[Array, " parameters"], unknowns: Unknowns) -> Linearization:
    """A linearisation that holds the unknowns at a bound where the cost falls beyond it (a projected gradient).

    Their columns of the Jacobian are 0, so that no step moves them.
    """
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
    # The triangle's own rows span it unless columns were set to 0; the last row holds what no parameter explains.
    return residual[:-1] if moves.all() else np.linalg.qr(triangle[:, moves])[0].T @ residual
