"""How sure an estimate is, and whether it explains the picture at all."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .pyramid import blur
from .residual import Linearization
from .transforms import Transform

RANK_TOLERANCE = 1e-9
"""A direction along which the picture changes this much less than along the strongest one is not determined."""

STRUCTURE_BLUR = 2.0
"""Standard deviation in pixels of the blur under which noise fades and structure stays."""

STRUCTURE_SHARE = 0.5
"""A residual that keeps more than this share of its root mean square under the blur has structure."""

NEGLIGIBLE_RMS = 1 / 255
"""A blurred residual below one 8-bit level is no structure that matters."""


def covariance(
    found: Linearization, transforms: tuple[Transform, ...], y: Float[Array, " parameters"], observations: int
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, "parameters parameters"]]:
    """Standard errors and correlation matrix of the parameters' values at an unblurred optimum.

    The covariance is `s^2 R^-1 R^-T` with R the triangle of the Jacobian's QR decomposition (never the inverse of
    `J^T J`, which squares the condition number), and `s^2 = |r|^2 / (observations - parameters)`. A parameter that
    takes part in a direction along which the picture does not change gets infinity.

    Args:
        found: the problem at the optimum.
        transforms, y: how the values follow from the unknowns there.
        observations: number of residuals, pixels times channels.
    """
    slope = np.array([float(jax.grad(t.to_value)(y[k])) for k, t in enumerate(transforms)])
    jacobian = np.asarray(found.jacobian, np.float64) / slope
    variance = float(np.sum(np.asarray(found.residual, np.float64) ** 2)) / max(observations - len(slope), 1)

    # Scale columns to length one: what is determined must not depend on units.
    lengths = np.linalg.norm(jacobian, axis=0)
    scale = np.where(lengths > 0, lengths, 1)
    _, strengths, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    strong = strengths > RANK_TOLERANCE * max(strengths[0], 1e-300)
    undetermined = (lengths == 0) | np.any(np.abs(directions[~strong]) > 1e-3, axis=0)
    weights = directions[strong] / strengths[strong, None]
    inverse = weights.T @ weights
    spread = np.sqrt(np.diagonal(inverse))
    error = np.where(undetermined, np.inf, np.sqrt(variance) * spread / scale)
    safe = np.where(spread > 0, spread, 1)
    correlation = inverse / np.outer(safe, safe)
    np.fill_diagonal(correlation, 1.0)
    return error, correlation


def is_explained(residual: Float[np.ndarray, "3 height width"]) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something."""
    rms = float(np.sqrt(np.mean(residual**2)))
    smooth = np.asarray(blur(jnp.asarray(residual), jnp.asarray(STRUCTURE_BLUR, residual.dtype)))
    smooth_rms = float(np.sqrt(np.mean(smooth**2)))
    return smooth_rms <= STRUCTURE_SHARE * rms or smooth_rms <= NEGLIGIBLE_RMS
