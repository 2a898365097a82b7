"""How far an estimate may be off where residuals err together over many pixels, whatever has made them do so."""

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.squares import square_sums
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
