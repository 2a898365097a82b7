"""How a picture and the target are compared, and what a residual counts under each loss."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.options import LossName
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.util.compilation import jit


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How picture and target are compared.

    Args:
        edges: how the picture is sampled.
        blur: standard deviation of the Gaussian blur of their difference, in pixels of the target.
        binning: how many pixels are averaged to one in each direction, in picture and target.
        loss: name of the loss.
        loss_scale: its scale; infinity with `l2`.
        noise: standard deviation of the residuals beside which priors count.
    """

    edges: EdgeMode
    blur: float = 0.0
    binning: int = 1
    loss: LossName = "l2"
    loss_scale: float = np.inf
    noise: float = 0.0


Residual = Float[Array, "*any"]
Scale = Float[Array, ""]


class Loss(NamedTuple):
    """A loss `rho(r)` of residuals r, given by three functions of r and a scale.

    Args:
        residual: a residual whose square is `2 rho`, so that least squares minimise the loss.
        weight: `rho' / r`, the weight with which least squares pull as the loss does. It falls with `|r|`, so that
            `2 rho >= weight r^2`.
        curvature: `rho''`.
        tuning: the scale in standard deviations of Gaussian noise at which the loss keeps 95 % of the efficiency of
            least squares (Holland and Welsch 1977).
    """

    residual: Callable[[Residual, Scale], Residual]
    weight: Callable[[Residual, Scale], Residual]
    curvature: Callable[[Residual, Scale], Residual]
    tuning: float

    def score(self, residual: Residual, scale: Scale) -> Residual:
        """`rho'`, how hard a residual pulls."""
        return self.weight(residual, scale) * residual


LINEAR_BELOW = 1e-8
"""Squared residual, in units of the scale, below which Cauchy's residual is the plain one. They differ by a quarter
of this share, less than float32 rounds, and the quotient 0 / 0 is not met."""


def cauchy(residual: Residual, scale: Scale) -> Residual:
    """Residuals whose sum of squares is the Cauchy loss, `scale^2 log(1 + (residual / scale)^2)`."""
    squared = (residual / scale) ** 2
    large = squared > LINEAR_BELOW
    shrink = jnp.sqrt(jnp.log1p(jnp.where(large, squared, 1)) / jnp.where(large, squared, 1))
    return jnp.where(large, residual * shrink, residual)


def _cauchy_curvature(residual: Residual, scale: Scale) -> Residual:
    squared = (residual / scale) ** 2
    return (1 - squared) / (1 + squared) ** 2


LOSSES: dict[LossName, Loss] = {
    "l2": Loss(lambda r, s: r, lambda r, s: jnp.ones_like(r), lambda r, s: jnp.ones_like(r), float("inf")),
    "cauchy": Loss(cauchy, lambda r, s: 1 / (1 + (r / s) ** 2), _cauchy_curvature, 2.385),
}
"""The losses by name; `l2` has no use for a scale."""


def evaluate(
    loss: LossName, what: Literal["residual", "weight", "score"], residual: Float[np.ndarray, "*any"], scale: float
) -> Float[np.ndarray, "*any"]:
    """What a loss makes of residuals, on the host; in double precision."""
    given = jnp.asarray(residual)
    return np.asarray(_evaluate(given, jnp.asarray(scale, given.dtype), loss, what), np.float64)


@functools.partial(jit, static_argnames=("loss", "what"))
def _evaluate(residual: Residual, scale: Scale, loss: LossName, what: str) -> Residual:
    """One function of a loss, as one program."""
    return getattr(LOSSES[loss], what)(residual, scale)
