"""The structure of a residual: whether it is noise, whether one beats another, whether far pixels go together."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...util.numerics import TINY, solve_normal
from ..problem.problem import FitState
from ..problem.unknowns import Covariance, Image, Mask, PixelJacobian

SQUARE = 4
"""Side in pixels of the squares over which noise averages out and structure stays. With 2 noise passes for structure,
with 6 to 8 structure for noise at times (experiments/tuning)."""

NEGLIGIBLE = 0.02
"""Structure below this fraction of the target's contrast is tolerated: two renderers that sample differently leave that
much. 0.01 takes smooth noise for structure, 0.04 lets a floor of another colour pass (experiments/tuning)."""

EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


def square_sums(image: Float[np.ndarray, "channels height width"], side: int):
    """Sums over squares of so many pixels a side, "channels rows columns"; at the right and lower border cut ones."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side).sum((2, 4))


def is_explained(residual: Image, target: Image, counts: Mask, matters: Mask) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something.

    The means of small squares are those of noise, or negligible: over the pixels that depend on a free parameter, which
    are those that matter, and over all that count.
    """
    # Of white noise square means are a fourth of the residual's root mean square. From 0.35 of it down noise passes for
    # structure at times, from 0.7 up structure for noise. Elsewhere no free parameter moves a pixel and no estimate is
    # biased: 0.2 of the contrast is tolerated, 0.4 lets a white corner of a twelfth of the sides pass
    # (experiments/tuning).
    for where, negligible in ((matters & counts, NEGLIGIBLE), (counts, 0.2)):
        structure, contrast = structure_and_contrast(residual, target, where)
        if structure > negligible * contrast and structure > 0.5 * np.sqrt(np.mean(residual[:, where] ** 2)):
            return False
    return True


def is_near(residual: Image, target: Image, counts: Mask) -> bool:
    """Whether a picture is so near the target that what is left can be compared with small changes of the model."""
    # Structure above a fifth of the target's contrast is that of another scene, or of a minimum that is not the answer.
    structure, contrast = structure_and_contrast(residual, target, counts)
    return structure < 0.2 * contrast


def explains(state: FitState) -> bool:
    """Whether the picture there explains the target; a picture that is not finite does not."""
    matters = np.any(np.asarray(state.linearization.matters), axis=0)
    return state.linearization.is_finite and is_explained(
        state.residual, state.weighted_target, state.observation.counts, matters
    )


def structure_and_contrast(residual: Image, target: Image, where: Mask) -> tuple[float, float]:
    """Root mean square of a residual's means over small squares within a region, and the contrast of the target's.

    Of less than two squares structure cannot be told: it is 0, and the contrast has no end.
    """
    counts = square_sums(where.astype(float)[None], SQUARE)[0]
    full = counts >= 0.5 * SQUARE**2  # Requiring full squares would drop the rim, where wrong models show.
    if np.sum(full) < 2:
        return 0.0, np.inf
    means, colours = (
        square_sums(np.where(where, one, 0), SQUARE)[:, full] / counts[full] for one in (residual, target)
    )
    return float(np.sqrt(np.mean(means**2))), float(np.mean(colours.std(axis=1)))


def vuong_evidence(better: Image, other: Image) -> float:
    """Standard errors by which one residual, weighted and under the loss, beats another (after Vuong 1989).

    The squares differ by `2 better (other - better) + (other - better)^2`. The first part is as likely to help as to
    harm if both pictures are equally good: its scatter is the measure, summed by squares of pixels since neighbours err
    together. The second part grows with the pictures' difference, and its scatter would hide a clear one.
    """
    gain = float(np.sum(other**2 - better**2))
    # Squares of 8 pixels: a JPEG's blocks.
    chance = float(np.linalg.norm(square_sums(2 * better * (other - better), 8).sum(0)))
    return gain / chance if chance > 0 else float(np.inf if gain > 0 else 0)


class PairScores(NamedTuple):
    """Standard scores of the products of residuals of two pixels: independent ones have 0, with a spread of 1.

    Args:
        near, far: of pixels so near that noise may go together; of others in one square, of four times that.
    """

    near: float
    far: float

    @property
    def is_far(self) -> bool:
        """Whether correlation of distant pixels is more than chance makes: 2.2 at most of noise alone in 840 draws."""
        return self.far > 3.0


def pair_scores(residual: Image, near: int = 4) -> PairScores:
    """Compare pairs of pixels of one channel within squares of `4 near` pixels a side.

    Whatever the noise's distribution and however unequal, products of independent residuals have the mean 0, as of
    Moran's statistic (Moran 1950). Their sum over all pairs is measured by its scatter from square to square.

    Args:
        near: pixels over which noise may go together: 4 of a sensor's mosaic or a resampled picture, more of a
            compressed one.
    """
    # Squares are larger than that, and there are many in a picture.
    side, (_, height, width) = 4 * near, residual.shape
    padded = np.pad(residual, ((0, 0), (0, -height % side), (0, -width % side)))
    squares = padded.reshape(3, padded.shape[1] // side, side, -1, side).transpose(1, 3, 0, 2, 4)
    squares = squares.reshape(-1, 3, side, side)

    # Sums over pairs without a loop over them: a residual times the sum of all, or of those around it.
    window = 2 * near + 1
    around = ndimage.uniform_filter(squares, window, mode="constant", axes=(2, 3)) * window**2
    all_pairs = np.sum(squares, axis=(2, 3)) ** 2
    near_pairs = np.sum(squares * around, axis=(2, 3))
    own = np.sum(squares**2, axis=(2, 3))
    sums = [products.sum(axis=1) for products in (near_pairs - own, all_pairs - near_pairs)]
    return PairScores(*(float(np.sum(one) / max(np.linalg.norm(one), TINY)) for one in sums))


def block_scatter(jacobian: PixelJacobian, weight: Image, residual: Image) -> Covariance:
    """Covariance of a least-squares estimate whose residuals are correlated within blocks of pixels.

    The sandwich `A^-1 (sum of g g^T) A^-1`, with `A = J^T W J` and `g = J^T W r` of each block (Liang and Zeger 1986),
    with blocks of the side that makes it largest.
    """
    count = len(jacobian)
    flat = jacobian.reshape(count, -1)
    normal = (flat * weight.reshape(-1)) @ flat.T
    length, pulls = np.sqrt(np.maximum(np.diagonal(normal), 0)), np.sum(jacobian * (weight * residual), axis=1)
    moved = []
    for side in (16, 32, 64):
        by_block = square_sums(pulls, side).reshape(count, -1)
        # The pulls sum up to nothing at the optimum: fewer than 30 blocks show too little of their scatter.
        if moved and np.count_nonzero(by_block.any(axis=0)) < 30:
            break
        moved.append(solve_normal(normal, by_block))
    largest = max(moved, key=lambda one: np.linalg.norm(length[:, None] * one))
    return largest @ largest.T
