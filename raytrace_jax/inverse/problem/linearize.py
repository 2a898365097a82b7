"""A least-squares problem near one point: the residual under a loss, its Jacobian, and the sums of statistics."""

import functools
from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...images.filters import gaussian_blur
from ...util.compilation import jit
from ...util.numerics import TINY, on_host
from ..options import LossName
from .observation import Observation
from .prediction import PredictedPicture
from .unknowns import AnyArray, Picture, Prior, Scalar, Values, Vector

RANK_TOLERANCE = 1e-9
"""A direction along which the picture changes this much less than along the strongest one is not determined."""

Residual = Float[Array, "*any"]


LossPart = Literal["residual", "weight", "score"]
"""The functions of a loss that are asked for at residuals."""


class Loss(NamedTuple):
    """A loss `rho(r)` of residuals r, given by three functions of r and a scale.

    Args:
        residual: a residual whose square is `2 rho`, so that least squares minimise the loss.
        weight: `rho' / r`, the weight with which least squares pull as the loss does. It falls with `|r|`, so that
            `2 rho >= weight r^2`.
        tuning: the scale in standard deviations of Gaussian noise at which the loss keeps 95 % of the efficiency of
            least squares (Holland and Welsch 1977).
    """

    residual: Callable[[Residual, Scalar], Residual]
    weight: Callable[[Residual, Scalar], Residual]
    curvature: Callable[[Residual, Scalar], Residual]
    tuning: float

    def score(self, residual: Residual, scale: Scalar) -> Residual:
        """`rho'`, how hard a residual pulls."""
        return self.weight(residual, scale) * residual


def cauchy(residual: Residual, scale: Scalar) -> Residual:
    """Residuals whose sum of squares is the Cauchy loss, `scale^2 log(1 + (residual / scale)^2)`."""
    squared = (residual / scale) ** 2
    # Below, it differs from the plain residual by less than float32 rounds, and the quotient 0 / 0 is not met.
    large = squared > 1e-8
    shrink = jnp.sqrt(jnp.log1p(jnp.where(large, squared, 1)) / jnp.where(large, squared, 1))
    return jnp.where(large, residual * shrink, residual)


def _cauchy_curvature(residual: Residual, scale: Scalar) -> Residual:
    squared = (residual / scale) ** 2
    return (1 - squared) / (1 + squared) ** 2


LOSSES: dict[LossName, Loss] = {
    "l2": Loss(lambda r, s: r, lambda r, s: jnp.ones_like(r), lambda r, s: jnp.ones_like(r), float("inf")),
    "cauchy": Loss(cauchy, lambda r, s: 1 / (1 + (r / s) ** 2), _cauchy_curvature, 2.385),
}
"""The losses by name; `l2` has no use for a scale."""


@functools.partial(jit, static_argnames=("loss", "what"))
def evaluate(loss: LossName, what: LossPart, residual: Residual, scale: Scalar) -> Residual:
    """A function of a loss at residuals, as one program."""
    return getattr(LOSSES[loss], what)(residual, scale)


class Linearization(eqx.Module):
    """A least-squares problem near one point, rotated into as few numbers as it has.

    With `[J r] = Q R` the triangle R has the same `J^T J`, `J^T r` and `|r|` as the whole picture. So a solver that is
    given R's columns takes exactly the steps that it would take with millions of rows. Priors are rows of the problem.
    Under a robust loss the rows are weighted, so that `J^T r` is the loss's gradient; `|r|^2` is twice the loss itself.

    Args:
        image: the picture, not blurred; the target's colour in a pixel that is left out.
        pixel_jacobian: derivative of picture minus target, weighted and blurred, with respect to the unknowns.
        matters: the numbers that count, of the pixels that depend on a free parameter.
        typical: median magnitude of the weighted residuals in the pixels that matter.
        information: `J^T J` of the weighted picture alone, before any loss.
        curvature: `J^T C J`, where C has the loss's second derivative at each residual, with that of the priors.
        pixel_scatter: sum over pixels of the outer product of their part of the loss's gradient with itself: the
            gradient's covariance if each pixel errs on its own, and its channels as they like (Liang and Zeger 1986).
    """

    jacobian: Float[Array, "rows parameters"]
    residual: Float[Array, " rows"]
    image: Picture
    bad: Bool[Array, "height width"]
    pixel_jacobian: Float[Array, "parameters 3 height width"]
    matters: Bool[Array, "3 height width"]
    typical: Scalar
    squares: Scalar
    information: Float[Array, "parameters parameters"]
    curvature: Float[Array, "parameters parameters"]
    pixel_scatter: Float[Array, "parameters parameters"]

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals, under the loss."""
        return 0.5 * float(np.vdot(self.residual, self.residual))

    @property
    def is_finite(self) -> bool:
        """Whether cost and derivatives are finite, so that a solver can compare and step by them."""
        return bool(np.isfinite(self.cost) and np.all(np.isfinite(np.asarray(self.jacobian))))


@functools.partial(jit, static_argnames="loss")
def linearize(
    picture: PredictedPicture,
    values: Vector,
    slopes: Vector,
    observation: Observation,
    prior: Prior,
    blur: Scalar,
    loss_scale: Scalar,
    noise: Scalar,
    loss: LossName,
) -> Linearization:
    """The least-squares problem near a picture, as a `Linearization`."""
    # Pixels that are not finite are left out, up to a thousandth of those that count or one. With more the picture is
    # broken, and a solver must not prefer it because what is left of it fits.
    count = len(values)
    counts = jnp.any(observation.root_weight > 0, axis=0)
    sharp = observation.residual(picture.image)
    broken = ~(jnp.isfinite(sharp).all(axis=0) & jnp.isfinite(picture.jacobian).all(axis=(0, 1)))
    number, all_ = (jnp.sum(where, dtype=sharp.dtype) for where in (broken & counts, counts))
    few = number <= jnp.maximum(1, 1e-3 * all_)
    bad = broken & (few | ~counts)

    # What is finite is blurred, and summed up where it depends on what is free.
    raw = gaussian_blur(jnp.where(bad, 0, sharp), blur)
    # The residual is linear in the picture: its blurred derivative is the derivative of the blurred one.
    jacobian = gaussian_blur(jnp.where(bad, 0, picture.jacobian * observation.root_weight), blur)
    matters = jnp.any(jacobian != 0, axis=(0, 1)) & (observation.root_weight > 0) & ~bad
    # The median of every seventh, since sorting is slow: 7 shares no factor with usual widths. 1 to 29 do as well.
    sample = jnp.where(matters, jnp.abs(raw), jnp.inf).reshape(-1)[::7]
    sampled = jnp.sum(jnp.isfinite(sample), dtype=jnp.int32)
    typical = jnp.where(sampled > 0, jnp.sort(sample)[sampled // 2], 0)
    squares = jnp.sum(jnp.where(matters, raw * raw, 0))

    # The statistics of the estimate: sums over residuals of products of derivatives.
    rule = LOSSES[loss]
    flat = jacobian.reshape(count, -1)
    weight = rule.weight(raw, loss_scale)
    pulls = jnp.sum(jacobian * rule.score(raw, loss_scale), axis=1)
    pixel_scatter = outer(pulls.reshape(count, -1))
    # Priors are rows as residuals are, in units of the noise.
    prior_residual, prior_slope = noise * prior.precision * (values - prior.mean), noise * prior.precision * slopes
    curvature = (flat * rule.curvature(raw, loss_scale).reshape(-1)) @ flat.T + jnp.diag(prior_slope**2)
    # Iteratively reweighted least squares: rows `sqrt(w) J` and `sqrt(w) r`, whose gradient `J^T w r` is the loss's,
    # `J^T rho'(r)`. Their sum of squares is less than twice the loss. The difference is a constant of this problem: it
    # goes into the last entry of the triangle, which no derivative shares and `steps.project_on_range` drops.
    root = jnp.sqrt(weight)
    system = jnp.concatenate([(jacobian * root).reshape(count, -1), (raw * root).reshape(1, -1)]).T
    beyond = jnp.maximum(jnp.sum(rule.residual(raw, loss_scale) ** 2 - weight * raw * raw), 0)
    prior_rows = jnp.concatenate([jnp.diag(prior_slope), prior_residual[:, None]], axis=1)
    # The triangle has the residual in its last column.
    triangle = jnp.linalg.qr(jnp.concatenate([system, prior_rows]), mode="r")
    # The signs of the rows are arbitrary: fix them, so that residuals of successive steps can be compared.
    triangle = triangle * jnp.where(jnp.diagonal(triangle) < 0, -1, 1)[:, None].astype(raw.dtype)
    triangle = triangle.at[-1, -1].set(jnp.sqrt(triangle[-1, -1] ** 2 + beyond))
    return Linearization(
        jacobian=triangle[:, :-1],
        residual=triangle[:, -1],
        image=jnp.where(bad, observation.target - observation.bias, picture.image),
        bad=bad,
        pixel_jacobian=jacobian,
        matters=matters,
        typical=typical,
        squares=squares,
        information=outer(flat),
        curvature=curvature,
        pixel_scatter=pixel_scatter,
    )


def outer(jacobian: Float[AnyArray, "parameters rows"]) -> Float[AnyArray, "parameters parameters"]:
    """`J^T J` of a Jacobian that is stored by columns, of JAX or of numpy."""
    return jacobian @ jacobian.T


def gauss_newton_step(linearization: Linearization) -> Values:
    """The step to the minimum of the sum of squares near a point; it is 0 along what the picture does not determine."""
    triangle, residual = map(on_host, (linearization.jacobian, linearization.residual))
    if not (np.isfinite(triangle).all() and np.isfinite(residual).all()):
        return np.zeros(triangle.shape[1])  # Squares beyond the dtype: no step is known.
    pulls, strengths, directions = np.linalg.svd(triangle, full_matrices=False)
    strong = strengths > RANK_TOLERANCE * max(strengths[0], TINY)
    return -directions[strong].T @ (pulls[:, strong].T @ residual / strengths[strong])
