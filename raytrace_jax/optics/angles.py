"""Snell's law for angles: how far a surface bends a ray, and where it stops to let it through."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float


def snell_angle(theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"]) -> Float[Array, "*rays"]:
    """The angle of refraction by Snell's law, `theta_t = arcsin(sin(theta_i) / eta)`.

    Derivatives: `d theta_t / d theta_i = cos(theta_i) / (eta cos(theta_t))` and
    `d theta_t / d eta = -tan(theta_t) / eta`. Both grow without limit towards the critical angle. (Born and Wolf,
    "Principles of Optics", 1.5.1.)

    At the critical angle and beyond it there is total internal reflection and no such angle: the result is `pi / 2`,
    its limit, and both derivatives are 0.

    Args:
        theta_i: angles of incidence in radians, from the normal, -pi / 2 to pi / 2; the result has their sign.
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.
    """
    return _arcsin(jnp.sin(theta_i) / eta)


def critical_angle(eta: Float[ArrayLike, "*rays"]) -> Float[Array, "*rays"]:
    """The angle of incidence, in radians, beyond which nothing is transmitted: `theta_c = arcsin(eta)`.

    Derivative: `d theta_c / d eta = 1 / sqrt(1 - eta^2)`; with respect to the index `ior = 1 / eta` of what the ray
    wants to leave, `-1 / (ior sqrt(ior^2 - 1))`. (Born and Wolf, "Principles of Optics", 1.5.4.)

    Into a medium that is not thinner (`eta >= 1`) everything passes: the result is `pi / 2`, its derivative 0.

    Args:
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.
    """
    return _arcsin(jnp.asarray(eta))


def _arcsin(x: Float[Array, "*rays"]) -> Float[Array, "*rays"]:
    """`arcsin(x)`; where `|x| >= 1` it is +-pi / 2, with derivative 0."""
    inside = jnp.abs(x) < 1
    # The input is guarded: the derivative of the branch not taken would be infinite, and infinity times 0 is NaN.
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, x, 0)), jnp.where(x < 0, -jnp.pi / 2, jnp.pi / 2))
