"""Reflection, refraction and Schlick's approximation, each for whole batches of rays.

Directions `d` run *with* the light path that is traced (from the camera into the scene), normals `n` have length one.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._numerics import dot, safe_sqrt

AIR_IOR = 1.000293
"""Index of refraction of air, the medium around every shape of a course scene."""


def reflect(d: Float[Array, "3 *rays"], n: Float[Array, "3 *rays"]) -> Float[Array, "3 *rays"]:
    """Mirror directions: `d - 2 (d.n) n`. Either sign of `n` gives the same result; lengths are kept."""
    return d - 2 * dot(d, n) * n


def refract(
    d: Float[Array, "3 *rays"], n: Float[Array, "3 *rays"], eta: Float[Array, " *rays"]
) -> tuple[Float[Array, "3 *rays"], Float[Array, " *rays"], Bool[Array, " *rays"]]:
    """Transmitted directions by Snell's law, as vectors (Heckbert 1989).

    Args:
        d: unit directions towards the surface.
        n: unit normals; either orientation is accepted, the sign of `d.n` tells the side.
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.

    Returns:
        The unit transmitted directions; the cosine of the transmitted angle, `cos_theta_t` >= 0; and where
        there is total internal reflection. There `cos_theta_t` is 0 and the direction has no meaning (it runs along
        the surface, is finite, and its derivative too).
    """
    d_dot_n = dot(d, n)
    cos_theta_i = jnp.abs(d_dot_n)
    toward = jnp.where(d_dot_n < 0, 1, -1) * n
    ratio = 1 / eta
    radicand = 1 - ratio * ratio * (1 - cos_theta_i * cos_theta_i)
    cos_theta_t = safe_sqrt(radicand)
    return ratio * d + (ratio * cos_theta_i - cos_theta_t) * toward, cos_theta_t, radicand < 0


def schlick(cos_theta: Float[Array, " *rays"], ior: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """Schlick's approximation of the Fresnel reflectance, `R0 + (1 - R0)(1 - cos_theta)^5`.

    `R0 = ((ior - 1) / (ior + 1))^2`, with `ior` relative to vacuum as in the course. `cos_theta` belongs to the larger
    of the two angles: the incident one on entering, the transmitted one on leaving, so that the reflectance reaches 1
    continuously at the critical angle (Schlick 1994).
    """
    r = (ior - 1) / (ior + 1)
    r0 = r * r
    x = 1 - cos_theta
    x_squared = x * x
    return r0 + (1 - r0) * (x_squared * x_squared * x)
