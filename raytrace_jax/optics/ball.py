"""A transparent ball: how far it turns a ray, where its rainbows are; and where it and other lenses focus."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..errors import SettingsError
from ..util.numerics import away_from_zero
from .angles import in_range, index, of_rays, snell_angle


class FocalLength(NamedTuple):
    """Focal lengths of a lens for rays near its axis, in the unit of its radius; negative where it spreads light.

    Args:
        effective: to the focus from the centre of a ball, of other lenses from the second principal plane.
        back: from the back of the lens to the focus; negative also where the focus lies inside (a ball of `eta > 2`).
    """

    effective: Float[Array, "*rays"]
    back: Float[Array, "*rays"]


@of_rays
def sphere_deviation(
    theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"], internal_reflections: int = 0
) -> Float[Array, "*rays"]:
    """The angle by which a ray has turned when it leaves a ball, `D = 2 (theta_i - theta_t) + k (pi - 2 theta_t)`.

    It is refracted in, reflected `k = internal_reflections` times within, and refracted out; `theta_t` is
    `snell_angle(theta_i, eta)`. Derivatives: `d D / d theta_i = 2 - 2 (k + 1) cos(theta_i) / (eta cos(theta_t))` and
    `d D / d eta = 2 (k + 1) tan(theta_t) / eta`. (Descartes 1637; van de Hulst, "Light Scattering by Small
    Particles", 12.2.)

    Where nothing enters (`eta < 1`, at the critical angle and beyond) the result is what the formula tends to: the
    turn of the ray that is reflected on the outside, `2 theta_i - pi`, with derivatives 2 and 0.

    Args:
        theta_i: angles of incidence in radians, 0 to pi / 2. A ray whose line passes the centre of a ball of radius
            `R` at the distance `b` has `theta_i = arcsin(b / R)`.
        eta: index of the ball over the index around it, > 0.
        internal_reflections: k, 0 or more.

    Returns:
        Radians, positive towards the axis, counted on beyond pi.

    Raises:
        SettingsError: `internal_reflections` is negative.
    """
    if internal_reflections < 0:
        raise SettingsError(f"internal_reflections is {internal_reflections}; it can be 0 or more")
    theta_i = jnp.asarray(theta_i)
    theta_t = snell_angle(theta_i, eta)
    return 2 * (theta_i - theta_t) + internal_reflections * (jnp.pi - 2 * theta_t)


@of_rays
def rainbow_angle(eta: Float[ArrayLike, "*rays"], internal_reflections: int = 1) -> Float[Array, "*rays"]:
    """The angle, in radians, at which a rainbow is seen from the point opposite to the sun: 42.1 degrees of water.

    `abs(pi - D)`, with whole turns taken off, where `D` is the least `sphere_deviation`, that at `rainbow_incidence`.
    Derivative: that of `D` by `eta` there, with its sign: `-4 tan(theta_t) / eta` of the first rainbow,
    `6 tan(theta_t) / eta` of the second one, which is seen at 50.9 degrees. (Descartes 1637.)

    Args:
        eta: index of the ball over the index around it, 1 to k + 1.
        internal_reflections: k, 1 or more.

    Raises:
        SettingsError: there is no rainbow: `eta` or k is out of range.
    """
    turned = sphere_deviation(rainbow_incidence(eta, internal_reflections), eta, internal_reflections)
    return jnp.abs(jnp.pi - turned % (2 * jnp.pi))


@of_rays
def rainbow_incidence(eta: Float[ArrayLike, "*rays"], internal_reflections: int = 1) -> Float[Array, "*rays"]:
    """The angle of incidence, in radians, at which `sphere_deviation` is least: rays crowd there, as in a rainbow.

    `cos(theta_i)^2 = q = (eta^2 - 1) / (k (k + 2))`, from `d D / d theta_i = 0`. Derivative:
    `d theta_i / d eta = -eta / (k (k + 2) sqrt(q (1 - q)))`. (Descartes 1637; van de Hulst, "Light Scattering by
    Small Particles", 13.2.)

    There is a rainbow for `1 < eta < k + 1`. At these limits it is that of the grazing ray, `pi / 2`, and of the ray
    through the centre, 0; both have derivative 0.

    Args:
        eta: index of the ball over the index around it, 1 to k + 1.
        internal_reflections: k, 1 or more.

    Raises:
        SettingsError: `internal_reflections` is less than 1: a ray that only passes through has no least deviation; or
            `eta` is out of range.
    """
    if internal_reflections < 1:
        raise SettingsError(f"internal_reflections is {internal_reflections}; it can be 1 or more")
    most = internal_reflections + 1
    is_wrong = (jnp.asarray(eta) < 1) | (jnp.asarray(eta) > most)
    eta = in_range(eta, ~is_wrong, "eta", f"1 to {most} is wanted: else there is no such rainbow")
    q = (eta * eta - 1) / (internal_reflections * (internal_reflections + 2))
    exists = ~((q <= 0) | (q >= 1))  # So that NaN stays NaN.
    inside = jnp.where(exists, q, 0.5)
    return jnp.where(exists, jnp.arccos(jnp.sqrt(inside)), jnp.where(q < 0.5, jnp.pi / 2, 0))


@of_rays
def lens_focal_length(radius: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"]) -> FocalLength:
    """Effective and back focal length of a ball lens, `f = R eta / (2 (eta - 1))` and `f - R`.

    That is the lensmaker's equation for a lens as thick as the ball's diameter (Hecht, "Optics", 6.1). Derivatives,
    the same for both lengths with respect to `eta`: `d f / d eta = -R / (2 (eta - 1)^2)`; `d f / d R = f / R`.

    Where the indices are equal there is no focus: nearer to `eta = 1` than 1e-6 the result is that of
    `eta = 1 + 1e-6` or `1 - 1e-6`, with derivative 0 with respect to `eta`.

    Args:
        radius: radii `R` of the balls, any unit of length.
        eta: index of the ball over the index around it, > 0; below 1 the ball spreads light.
    """
    radius, eta = jnp.asarray(radius), index(eta)
    # Nearer to 1 than this the focal length would grow without bound.
    effective = radius / 2 * (1 + 1 / away_from_zero(eta - 1, 1e-6))
    return FocalLength(effective, effective - radius)


@of_rays
def lensmaker_focal_length(
    curvature1: Float[ArrayLike, "*#rays"],
    curvature2: Float[ArrayLike, "*#rays"],
    eta: Float[ArrayLike, "*#rays"],
    thickness: Float[ArrayLike, "*#rays"] = 0.0,
) -> FocalLength:
    """Effective and back focal length of a lens, by the lensmaker's equation (Hecht, "Optics", 6.1).

    `1 / f = P = (eta - 1) (c1 - c2 + (eta - 1) thickness c1 c2 / eta)`, and `f (1 - (eta - 1) thickness c1 / eta)` from
    the back. Derivatives: `d f = -f^2 d P`.

    Where P is 0 there is no focus: nearer to 0 than 1e-12 the result is that of `P = 1e-12` or `-1e-12`.

    Args:
        curvature1: 1 over the radius of the face that the light meets first, positive if its centre lies behind it.
        curvature2: that of the last face; a lens with two convex faces has a negative one.
        eta: index of the lens over the index around it, > 0.
        thickness: on the axis, in the unit of the radii; 0 of a thin lens.
    """
    first, last, eta, thickness = (jnp.asarray(x) for x in (curvature1, curvature2, index(eta), thickness))
    reduced = (eta - 1) * thickness / eta
    effective = 1 / away_from_zero((eta - 1) * (first - last + reduced * first * last), 1e-12)
    return FocalLength(effective, effective * (1 - reduced * first))
