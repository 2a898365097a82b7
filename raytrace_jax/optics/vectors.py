"""Reflection and refraction of directions.

Directions `d` run *with* the light path that is traced (from the camera into the scene), normals `n` have length one.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..util.numerics import dot, mean_sqrt, safe_normalize, safe_sqrt, with_lower_ranks
from .angles import of_rays

AIR_IOR = 1.000293
"""Index of refraction of air, the medium around every shape of a course scene."""


@of_rays
@with_lower_ranks
def reflect(d: Float[Array, "3 *rays"], n: Float[Array, "3 *rays"]) -> Float[Array, "3 *rays"]:
    """Mirror directions, `r = d - 2 (d.n) n`.

    Derivative: `dr = dd - 2 (dd.n) n - 2 (d.dn) n - 2 (d.n) dn`. (Heckbert 1989, "Writing a ray tracer".)

    Args:
        d: directions towards the surface, of any length; lengths are kept.
        n: unit normals; either sign gives the same result.
    """
    return d - 2 * dot(d, n) * n


@of_rays
@with_lower_ranks
def refract(
    d: Float[Array, "3 *rays"],
    n: Float[Array, "3 *rays"],
    eta: Float[Array, " *rays"],
    spread: Float[Array, " *rays"] | None = None,
) -> tuple[Float[Array, "3 *rays"], Float[Array, " *rays"], Bool[Array, " *rays"]]:
    """Transmitted directions by Snell's law, as vectors: `t = d / eta + (cos_theta_i / eta - cos_theta_t) m`.

    `m` is the normal on the side that the ray comes from, `cos_theta_i = -d.m` and
    `cos_theta_t^2 = 1 - (1 - cos_theta_i^2) / eta^2`. (Heckbert 1989, "Writing a ray tracer".) Derivatives:
    `d cos_theta_t / d cos_theta_i = cos_theta_i / (eta^2 cos_theta_t)`,
    `d cos_theta_t / d eta = (1 - cos_theta_i^2) / (eta^3 cos_theta_t)`,
    `d t / d eta = -(d + cos_theta_i m) / eta^2 - (d cos_theta_t / d eta) m`. They grow without limit towards the
    critical angle.

    Args:
        d: unit directions towards the surface.
        n: unit normals; either orientation is accepted, the sign of `d.n` tells the side.
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.
        spread: how far `cos_theta_i^2` ranges over what each ray stands for, not negative. Then `cos_theta_t` is its
            mean over that range, 0 where the reflection is total, and so are the directions: what straddles the
            critical angle transmits a little, and derivatives are finite also there. None for points.

    Returns:
        The unit transmitted directions; the cosine of the transmitted angle, `cos_theta_t` >= 0; and where
        there is total internal reflection, over all of the range. There `cos_theta_t` is 0 and the direction has no
        meaning (it runs along the surface, is finite, and its derivative too).
    """
    d_dot_n = dot(d, n)
    cos_theta_i = jnp.abs(d_dot_n)
    toward = jnp.where(d_dot_n < 0, 1, -1) * n
    ratio = 1 / eta
    radicand = 1 - ratio * ratio * (1 - cos_theta_i * cos_theta_i)
    cos_theta_t = safe_sqrt(radicand) if spread is None else mean_sqrt(radicand, ratio * ratio * spread)
    transmitted = ratio * d + (ratio * cos_theta_i - cos_theta_t) * toward
    if spread is None:
        return transmitted, cos_theta_t, radicand < 0
    # A mean of directions is shorter than they are.
    return safe_normalize(transmitted), cos_theta_t, cos_theta_t <= 0
