"""The reflectance of a transparent surface: Fresnel's equations, and Schlick's approximation of them."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..util.numerics import mean_sqrt, safe_sqrt
from .angles import cosine, index, of_rays


@of_rays
def fresnel_amplitudes(
    cos_theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"]
) -> tuple[Float[Array, "*rays"], Float[Array, "*rays"]]:
    """Fresnel's amplitudes of reflection for light polarised parallel and perpendicular to the plane of incidence.

    With `c = cos_theta_i` and `t = cos_theta_t = sqrt(1 - (1 - c^2) / eta^2)`

        r_parallel      = (eta c - t) / (eta c + t)
        r_perpendicular = (c - eta t) / (c + eta t)

    and the derivatives are

        d r_parallel / d c        = 2 (eta^2 - 1) / (eta t (eta c + t)^2)
        d r_perpendicular / d c   = 2 (eta^2 - 1) / (eta t (c + eta t)^2)
        d r_parallel / d eta      = 2 c (2 t^2 - 1) / (t (eta c + t)^2)
        d r_perpendicular / d eta = -2 c / (t (c + eta t)^2)

    (Born and Wolf, "Principles of Optics", 1.5.2.) `r_parallel` is 0 at Brewster's angle, `tan(theta_i) = eta`.

    From the critical angle on (`t = 0`) the amplitudes are complex numbers of magnitude 1, whose phase is not told
    here: both are given as 1 and their derivatives as 0.

    Args:
        cos_theta_i: cosines of the angles of incidence, 0 (grazing) to 1.
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.

    Returns:
        The parallel and the perpendicular amplitude, each from -1 to 1, without a unit.

    Raises:
        SettingsError: a cosine is below 0 or above 1.
    """
    return _amplitudes(cosine(cos_theta_i, "cos_theta_i"), index(eta))


def _amplitudes(
    c: Float[Array, "*#rays"], eta: Float[Array, "*#rays"], spread: Float[Array, "*#rays"] | None = None
) -> tuple[Float[Array, "*rays"], Float[Array, "*rays"]]:
    """`fresnel_amplitudes` of arguments that are right; `spread` as `refract` has it."""
    radicand = 1 - (1 - c * c) / (eta * eta)
    t, total = safe_sqrt(radicand), radicand <= 0
    if spread is not None:
        t = mean_sqrt(radicand, spread / (eta * eta))
        total = t <= 0
    # At grazing incidence on what is not denser all of c and t is zero: the divisors are guarded, not the quotients.
    parallel, perpendicular = (jnp.where(total, 1, divisor) for divisor in (eta * c + t, c + eta * t))
    return jnp.where(total, 1, (eta * c - t) / parallel), jnp.where(total, 1, (c - eta * t) / perpendicular)


@of_rays
def fresnel_dielectric(
    cos_theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"]
) -> Float[Array, "*rays"]:
    """The share of unpolarised light that a dielectric surface reflects: `(r_parallel^2 + r_perpendicular^2) / 2`.

    The amplitudes and their derivatives are those of `fresnel_amplitudes`; so `d R / d x` is
    `r_parallel (d r_parallel / d x) + r_perpendicular (d r_perpendicular / d x)` for either argument `x`. At normal
    incidence `R = ((eta - 1) / (eta + 1))^2`, at grazing incidence 1. (Born and Wolf, "Principles of Optics", 1.5.3.)

    From the critical angle on the result is 1 and its derivatives are 0; towards it, from below, they grow without
    limit. What is not reflected is transmitted. The result is the same from both sides of a surface at angles that
    belong together by Snell's law.

    Args:
        cos_theta_i: cosines of the angles of incidence, 0 (grazing) to 1.
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.

    Raises:
        SettingsError: a cosine is below 0 or above 1.
    """
    return reflected_share(cosine(cos_theta_i, "cos_theta_i"), index(eta))


def reflected_share(
    c: Float[Array, "*#rays"], eta: Float[Array, "*#rays"], spread: Float[Array, "*#rays"] | None = None
) -> Float[Array, "*rays"]:
    """`fresnel_dielectric` of arguments that are right; by the mean cosine behind the surface if `c^2` has a spread."""
    parallel, perpendicular = _amplitudes(c, eta, spread)
    return (parallel * parallel + perpendicular * perpendicular) / 2


@of_rays
def fresnel_schlick(cos_theta: Float[ArrayLike, "*#rays"], ior: Float[ArrayLike, "*#rays"]) -> Float[Array, "*rays"]:
    """Schlick's approximation of the Fresnel reflectance, `R = R0 + (1 - R0)(1 - cos_theta)^5`.

    `R0 = ((ior - 1) / (ior + 1))^2`. (Schlick 1994, "An inexpensive BRDF model for physically-based rendering".)
    Derivatives: `d R / d cos_theta = -5 (1 - R0)(1 - cos_theta)^4` and
    `d R / d ior = (1 - (1 - cos_theta)^5) 4 (ior - 1) / (ior + 1)^3`. It knows nothing of total internal reflection.

    Args:
        cos_theta: cosines, 0 to 1, of the larger of the two angles: the incident one on entering, the transmitted one
            on leaving, so that the reflectance reaches 1 continuously at the critical angle.
        ior: indices of refraction relative to vacuum, as in the course; one of the two media is taken for it. The
            reciprocal index gives the same result.

    Raises:
        SettingsError: a cosine is below 0 or above 1.
    """
    return schlick_share(cosine(cos_theta, "cos_theta"), index(ior, "ior"))


def schlick_share(cos_theta: Float[Array, "*#rays"], ior: Float[Array, "*#rays"]) -> Float[Array, "*rays"]:
    """`fresnel_schlick` of arguments that are right."""
    r = (ior - 1) / (ior + 1)
    r0 = r * r
    x = 1 - cos_theta
    x_squared = x * x
    return r0 + (1 - r0) * (x_squared * x_squared * x)
