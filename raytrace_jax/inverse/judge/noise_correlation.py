"""Whether residuals err together, over a few pixels as noise does or over many as a wrong model does."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

REACH = 4
"""Pixels over which noise may go together: that of a sensor's mosaic, of a resampled or compressed picture."""

SQUARE = 16
"""Side in pixels of the squares within which pairs of pixels are compared: beyond the reach, and many in a picture."""


class PairScores(NamedTuple):
    """Standard scores of the products of residuals of two pixels: independent ones have 0, with a spread of 1.

    Args:
        near: of pixels at most `REACH` apart.
        far: of others in one square.
    """

    near: float
    far: float


def pair_scores(residual: Float[np.ndarray, "3 height width"]) -> PairScores:
    """Compare pairs of pixels of one channel within squares.

    Whatever the noise's distribution and however unequal, products of independent residuals have the mean 0; their sum
    over all pairs is measured by its scatter from square to square.
    """
    _, height, width = residual.shape
    padded = np.pad(residual, ((0, 0), (0, -height % SQUARE), (0, -width % SQUARE)))
    squares = padded.reshape(3, padded.shape[1] // SQUARE, SQUARE, -1, SQUARE).transpose(1, 3, 0, 2, 4)
    squares = squares.reshape(-1, 3, SQUARE, SQUARE)
    side = 2 * REACH + 1
    around = ndimage.uniform_filter(squares, side, mode="constant", axes=(2, 3)) * side**2
    all_pairs = np.sum(squares, axis=(2, 3)) ** 2
    near_pairs = np.sum(squares * around, axis=(2, 3))
    own = np.sum(squares**2, axis=(2, 3))
    return PairScores(_score((near_pairs - own).sum(axis=1)), _score((all_pairs - near_pairs).sum(axis=1)))


def _score(sums: Float[np.ndarray, " squares"]) -> float:
    scatter = float(np.linalg.norm(sums))
    return float(np.sum(sums)) / scatter if scatter > 0 else 0.0


LEAST_CORRELATION = 5.0
"""Standard errors from which on a correlation counts: of a thousand that are looked at chance makes none so large."""

LONGEST = 7
"""Pixels over which correlations are looked up: to the far side of a block of a JPEG."""


def correlated_scatter(
    columns: Float[np.ndarray, "parameters 3 height width"],
    score: Float[np.ndarray, "3 height width"],
    matters: Bool[np.ndarray, "height width"],
) -> Float[np.ndarray, "parameters parameters"]:
    """What it adds to the covariance of `sum(columns * score)` that the scores of neighbours and channels go together.

    Their covariance by distance and channels is pooled over the picture: from a few numbers, known well, where sums
    over squares of pixels are few and lose what crosses their borders.

    Args:
        columns: derivatives of the residual.
        score: how hard each residual pulls.
        matters: the pixels that count and depend on a free parameter.
    """
    count = len(columns)
    columns, score = np.where(matters, columns, 0.0), np.where(matters, score, 0.0)
    variance = np.sum(score**2, axis=(1, 2)) / max(int(matters.sum()), 1)
    added = np.zeros((count, count))
    for down in range(LONGEST + 1):
        for right in range(-LONGEST if down else 0, LONGEST + 1):
            here, there = _pair_windows(down, right)
            pairs = int(np.sum(matters[here] & matters[there]))
            if not pairs:
                continue
            covariance = np.einsum("ahw,bhw->ab", score[:, *here], score[:, *there]) / pairs
            chance = np.sqrt(np.outer(variance, variance) / pairs)
            covariance = np.where(np.abs(covariance) > LEAST_CORRELATION * chance, covariance, 0.0)
            if (down, right) == (0, 0):
                np.fill_diagonal(covariance, 0.0)
            if not covariance.any():
                continue
            mixed = np.einsum("ab,pbhw->pahw", covariance, columns[:, :, *there])
            part = columns[:, :, *here].reshape(count, -1) @ mixed.reshape(count, -1).T
            added += part if (down, right) == (0, 0) else part + part.T
    return added


def _pair_windows(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pixels that have another one so far away, and those others."""
    columns = (slice(0, -right or None), slice(right, None)) if right >= 0 else (slice(-right, None), slice(0, right))
    rows = slice(0, -down or None), slice(down, None)
    return (rows[0], columns[0]), (rows[1], columns[1])
