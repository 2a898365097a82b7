"""How residuals scatter that are not alone: those that decide an estimate, and those that err together over blocks."""

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.change_scores import solve_normal
from raytrace_jax.inverse.judge.goodness_of_fit import square_sums
from raytrace_jax.util.numerics import TINY

SIDES = (16, 32, 64)
"""Sides in pixels of the blocks within which residuals may pull together."""

FEWEST_BLOCKS = 30
"""Of fewer the pulls, which sum up to nothing at the optimum, show too little of their scatter."""


def block_scatter(
    columns: Float[np.ndarray, "parameters 3 height width"],
    weight: Float[np.ndarray, "3 height width"],
    residual: Float[np.ndarray, "3 height width"],
) -> Float[np.ndarray, "parameters parameters"]:
    """Covariance of a least-squares estimate whose residuals are correlated within blocks of pixels.

    The sandwich `A^-1 (sum of g g^T) A^-1`, with `A = J^T W J` and `g = J^T W r` of each block (Liang and Zeger 1986),
    with blocks of the side that makes it largest.

    Args:
        columns: derivatives of the weighted residual by the parameters, `J`.
        weight: of each residual under the loss, `W`.
        residual: the weighted residuals, `r`.
    """
    count = len(columns)
    flat = columns.reshape(count, -1)
    normal = (flat * weight.reshape(-1)) @ flat.T
    length = np.sqrt(np.maximum(np.diagonal(normal), TINY))
    inverse = np.linalg.pinv(normal / np.outer(length, length), rcond=1e-12, hermitian=True)
    pulls = np.sum(columns * (weight * residual), axis=1) / length[:, None, None]

    largest, most = np.zeros((count, count)), -1.0
    for side in SIDES:
        by_block = square_sums(pulls, side).reshape(count, -1)
        if side > SIDES[0] and np.count_nonzero(by_block.any(axis=0)) < FEWEST_BLOCKS:
            break
        found = inverse @ (by_block @ by_block.T) @ inverse
        if np.trace(found) > most:
            largest, most = found, float(np.trace(found))
    return largest / np.outer(length, length)


SMALL = 0.01
"""Leverages below this shrink a residual by less than a hundredth."""

LARGEST = 1 - 1e-6
"""Of a leverage: a residual that alone decides a number is 0 but for rounding, and tells nothing of its error."""


def hidden_scatter(
    columns: Float[np.ndarray, "parameters rows"],
    weight: Float[np.ndarray, " rows"],
    score: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "parameters parameters"]:
    """What the sum over residuals of their pulls' outer products lacks.

    An estimate follows a residual by its leverage h and leaves 1 - h of its error to be seen, so the pull that it would
    have on an estimate made without it is 1 / (1 - h) times what is seen (the jackknife: MacKinnon and White 1985). Of
    a picture of many pixels nothing is hidden, but at the rim of glass one pixel may decide.

    Args:
        columns: derivative of the residuals.
        weight: of each in the estimate.
        score: how hard each pulls.
    """
    leverage = leverages(columns, weight)
    decides = leverage > SMALL
    left = 1 - np.minimum(leverage[decides], LARGEST)
    hidden = score[decides] ** 2 * (1 / left**2 - 1)
    return (columns[:, decides] * hidden) @ columns[:, decides].T


def leverages(
    columns: Float[np.ndarray, "parameters rows"], weight: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """How far the fit follows each residual: 0 is not at all, 1 wherever it goes."""
    pulled = columns * weight
    return np.sum(pulled * solve_normal(pulled @ columns.T, columns), axis=0)
