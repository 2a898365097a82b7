"""Snell's law for angles: deviations, shifts and limits; and the check of all formulas' arguments."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.lax import stop_gradient
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ..errors import SettingsError
from ..util.numerics import real_numbers

F = TypeVar("F", bound=Callable[..., Any])


def of_rays(function: F) -> F:
    """A formula whose arguments, real numbers or rows of them, are checked: shapes are known within `jit` too.

    Directions `d` and `n` have their three components on the first axis, and equally many axes.

    Raises:
        SettingsError: they are no real numbers, their shapes do not fit each other, or directions are no such ones.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        bound = signature.bind(*args, **kwargs)
        rays: dict[str, tuple[int, ...]] = {}
        for name, value in bound.arguments.items():
            if value is None and signature.parameters[name].default is None:
                continue
            try:
                array = value if isinstance(value, Array) else real_numbers(value)
            except ValueError as reason:
                raise SettingsError(f"{name} {reason}.") from None
            if jnp.iscomplexobj(array):
                raise SettingsError(f"{name} is an array of the dtype {array.dtype}, and real numbers are wanted.")
            if isinstance(value, list | tuple):
                bound.arguments[name] = jnp.asarray(array, float)
            rays[name] = array.shape
        if "d" in rays:
            wrong = [name for name in "dn" if rays[name][:1] != (3,) or len(rays[name]) != len(rays["d"])]
            if wrong:
                wanted = "(3, ...) is wanted: the components of directions come first, and all have as many axes"
                raise SettingsError(f"{wrong[0]} has the shape {rays[wrong[0]]}, and {wanted}.")
        try:
            np.broadcast_shapes(*(shape[1:] if name in ("d", "n") else shape for name, shape in rays.items()))
        except ValueError:
            shapes = ", ".join(f"{name} has {shape}" for name, shape in rays.items())
            raise SettingsError(f"shapes that fit each other are wanted, one entry for each ray: {shapes}.") from None
        return function(*bound.args, **bound.kwargs)

    return checked  # pyright: ignore[reportReturnType]


@of_rays
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
    return _arcsin(jnp.sin(angle(theta_i)) / index(eta))


@of_rays
def critical_angle(eta: Float[ArrayLike, "*rays"]) -> Float[Array, "*rays"]:
    """The angle of incidence, in radians, beyond which nothing is transmitted: `theta_c = arcsin(eta)`.

    Derivative: `d theta_c / d eta = 1 / sqrt(1 - eta^2)`; with respect to the index `ior = 1 / eta` of what the ray
    wants to leave, `-1 / (ior sqrt(ior^2 - 1))`. (Born and Wolf, "Principles of Optics", 1.5.4.)

    At `eta = 1` the result is its limit `pi / 2`, with derivative 0.

    Args:
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, up to 1: `1 / 1.5` for a ray
            that wants to leave glass of index 1.5.

    Raises:
        SettingsError: `eta` is greater than 1: into a denser medium everything passes, and there is no such angle.
    """
    wanted = "1 at most is wanted, the index behind over the index in front: into a denser medium everything passes"
    return _arcsin(in_range(index(eta), ~(jnp.asarray(eta) > 1), "eta", wanted))


@of_rays
def brewster_angle(eta: Float[ArrayLike, "*rays"]) -> Float[Array, "*rays"]:
    """The angle of incidence, in radians, at which `r_parallel` of `fresnel_amplitudes` is 0: `theta_B = arctan(eta)`.

    What is reflected there is polarised; it is at right angles to what is transmitted. Derivative:
    `d theta_B / d eta = 1 / (1 + eta^2)`. (Born and Wolf, "Principles of Optics", 1.5.3.)

    Args:
        eta: `eta_t / eta_i`, the index behind the surface over the index in front of it, > 0.
    """
    return jnp.arctan(index(eta))


@of_rays
def slab_shift(
    theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"], thickness: Float[ArrayLike, "*#rays"]
) -> Float[Array, "*rays"]:
    """The shift of a ray behind a slab with parallel faces, at right angles to the ray.

    `s = thickness sin(theta_i - theta_t) / cos(theta_t)` with `theta_t = snell_angle(theta_i, eta)`. Derivatives:
    `d s / d theta_i = thickness (cos(theta_i) + sin(theta_i) tan(theta_t) - cos(theta_i)^2 / (eta cos(theta_t)^3))`,
    `d s / d eta = thickness cos(theta_i) sin(theta_t) / (eta cos(theta_t)^3)`, `d s / d thickness = s / thickness`.
    (Hecht, "Optics", 4.4.)

    Args:
        theta_i: angles of incidence in radians, -pi / 2 to pi / 2; the result has their sign.
        eta: index of the slab over the index around it, > 0.
        thickness: of the slab, in any unit of length.

    Raises:
        SettingsError: nothing enters (`eta < 1`, at the critical angle and beyond it).
    """
    theta_i, eta = angle(theta_i), index(eta)
    enters = jnp.abs(jnp.sin(theta_i)) < eta
    theta_t = snell_angle(in_range(theta_i, enters, "theta_i", "the reflection is total there: nothing enters"), eta)
    return jnp.asarray(thickness) * (jnp.sin(theta_i) - jnp.cos(theta_i) * jnp.tan(theta_t))


@of_rays
def prism_deviation(
    theta_i: Float[ArrayLike, "*#rays"], eta: Float[ArrayLike, "*#rays"], apex: Float[ArrayLike, "*#rays"]
) -> Float[Array, "*rays"]:
    """The angle by which a prism turns a ray away from its edge, `D = theta_i + theta_o - apex`.

    `theta_t = snell_angle(theta_i, eta)`, the ray meets the second face at `apex - theta_t` and leaves it at
    `theta_o = arcsin(eta sin(apex - theta_t))`. Derivatives:

        d D / d theta_i = 1 - cos(theta_i) cos(apex - theta_t) / (cos(theta_t) cos(theta_o))
        d D / d eta     = sin(apex) / (cos(theta_t) cos(theta_o))
        d D / d apex    = eta cos(apex - theta_t) / cos(theta_o) - 1

    D is least where the ray passes symmetrically, `sin(theta_i) = eta sin(apex / 2)`: a prism's index is measured by
    it, `eta = sin((D + apex) / 2) / sin(apex / 2)`. (Born and Wolf, "Principles of Optics", 4.7.2.)

    Args:
        theta_i: angles of incidence in radians, positive where the ray comes from the base's side of the normal.
        eta: index of the prism over the index around it, > 0.
        apex: the angle between the two faces, in radians.

    Raises:
        SettingsError: no ray leaves by the second face, for the reflection there is total, or enters by the first.
    """
    theta_i, eta, apex = angle(theta_i), index(eta), jnp.asarray(apex)
    inner = apex - snell_angle(theta_i, eta)
    leaves = (jnp.abs(jnp.sin(theta_i)) < eta) & (jnp.abs(inner) < jnp.pi / 2) & (eta * jnp.abs(jnp.sin(inner)) < 1)
    inner = in_range(inner, leaves, "the angle within", "no ray leaves by the second face")
    return theta_i + _arcsin(eta * jnp.sin(inner)) - apex


@of_rays
def prism_least_deviation(eta: Float[ArrayLike, "*#rays"], apex: Float[ArrayLike, "*#rays"]) -> Float[Array, "*rays"]:
    """The least `prism_deviation` of all angles of incidence, `D = 2 arcsin(eta sin(apex / 2)) - apex`.

    Derivative: `d D / d eta = 2 sin(apex / 2) / cos((D + apex) / 2)`. (Born and Wolf, 4.7.2.)

    Args:
        eta: index of the prism over the index around it, > 0.
        apex: the angle between the two faces, in radians.

    Raises:
        SettingsError: no ray passes by both faces, `eta sin(apex / 2) >= 1`.
    """
    sine = index(eta) * jnp.sin(jnp.asarray(apex) / 2)
    passes = jnp.abs(sine) < 1
    return 2 * _arcsin(in_range(sine, passes, "eta sin(apex / 2)", "less than 1 is wanted: else no ray passes")) - apex


@of_rays
def prism_index(deviation: Float[ArrayLike, "*#rays"], apex: Float[ArrayLike, "*#rays"]) -> Float[Array, "*rays"]:
    """The index of a prism that turns rays by `deviation` at least, `eta = sin((D + apex) / 2) / sin(apex / 2)`.

    The inverse of `prism_least_deviation`. Derivatives: `d eta / d D = cos((D + apex) / 2) / (2 sin(apex / 2))`,
    `d eta / d apex = -sin(D / 2) / (2 sin(apex / 2)^2)`. (Fraunhofer 1814; Born and Wolf, 4.7.2.)

    Args:
        deviation: the least one, in radians.
        apex: the angle between the two faces, in radians, > 0.

    Raises:
        SettingsError: there is no such prism, as `deviation + apex` is not between 0 and pi.
    """
    apex = index(apex, "apex")
    angles = jnp.asarray(deviation) + apex
    exists = (angles > 0) & (angles < jnp.pi)
    return jnp.sin(in_range(angles, exists, "deviation + apex", "0 to pi is wanted") / 2) / jnp.sin(apex / 2)


def _arcsin(x: Float[Array, "*rays"]) -> Float[Array, "*rays"]:
    """`arcsin(x)`; where `|x| >= 1` it is +-pi / 2, with derivative 0."""
    inside = ~(jnp.abs(x) >= 1)  # So that NaN stays NaN.
    # The input is guarded: the derivative of the branch not taken would be infinite, and infinity times 0 is NaN.
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, x, 0)), jnp.where(x < 0, -jnp.pi / 2, jnp.pi / 2))


def in_range(
    values: Float[ArrayLike, "*rays"], is_right: Bool[Array, "*rays"], name: str, wanted: str
) -> Float[Array, "*rays"]:
    """The values as an array; within `jit` and `vmap` NaN where they are not right, derivatives too.

    Raises:
        SettingsError: a value that is known is not right; the message says which one, and what is wanted.
    """
    values = jnp.asarray(values)
    if isinstance(is_right, Tracer):
        return values * jnp.where(is_right, 1, jnp.nan)
    if not np.all(is_right):
        wrong = np.broadcast_to(stop_gradient(values), np.shape(is_right))[~np.asarray(is_right)][0]
        raise SettingsError(f"{name} is {wrong:.6g}, and {wanted}.")
    return values


def cosine(values: Float[ArrayLike, "*rays"], name: str) -> Float[Array, "*rays"]:
    """Cosines of angles of incidence, refused or NaN outside of 0 to 1 (see the room's front)."""
    is_wrong = (jnp.asarray(values) < 0) | (jnp.asarray(values) > 1 + 1e-6)  # By rounding in float32.
    wanted = "0 to 1 is wanted: that of the ray with the normal on its own side, -dot(d, n) or abs(dot(d, n))"
    return in_range(values, ~is_wrong, name, wanted)


def angle(values: Float[ArrayLike, "*rays"]) -> Float[Array, "*rays"]:
    is_wrong = jnp.abs(jnp.asarray(values)) > jnp.pi / 2 + 1e-6  # By rounding in float32.
    return in_range(values, ~is_wrong, "theta_i", "-pi / 2 to pi / 2 is wanted, in radians")


def index(values: Float[ArrayLike, "*rays"], name: str = "eta") -> Float[Array, "*rays"]:
    """Indices of refraction, or ratios of them, refused or NaN unless above 0."""
    return in_range(values, ~(jnp.asarray(values) <= 0), name, "more than 0 is wanted")
