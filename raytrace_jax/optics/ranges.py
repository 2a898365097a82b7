"""Arguments for which a formula says nothing are refused where they are known, NaN where they are traced."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.lax import stop_gradient
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from raytrace_jax.errors import SettingsError

ROUNDING = 1e-6
"""Cosines and angles may be so much too large: by rounding in float32."""


def asked(
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
    """Cosines of angles of incidence, as `asked`."""
    is_wrong = (jnp.asarray(values) < 0) | (jnp.asarray(values) > 1 + ROUNDING)
    wanted = "0 to 1 is wanted: that of the ray with the normal on its own side, -dot(d, n) or abs(dot(d, n))"
    return asked(values, ~is_wrong, name, wanted)


def angle(values: Float[ArrayLike, "*rays"]) -> Float[Array, "*rays"]:
    """Angles of incidence, as `asked`."""
    is_wrong = jnp.abs(jnp.asarray(values)) > jnp.pi / 2 + ROUNDING
    return asked(values, ~is_wrong, "theta_i", "-pi / 2 to pi / 2 is wanted, in radians")


def index(values: Float[ArrayLike, "*rays"], name: str = "eta") -> Float[Array, "*rays"]:
    """Indices of refraction or their ratios, as `asked`."""
    return asked(values, ~(jnp.asarray(values) <= 0), name, "more than 0 is wanted")
