"""The structure of a residual: whether it is noise, whether one beats another, whether far pixels go together."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...util.numerics import TINY, on_host, root_diagonal, solve_normal
from ..problem.observation import Observation
from ..problem.problem import FitState
from ..problem.unknowns import Covariance, Image, Images, Mask

BLOCK = 4
"""Side in pixels of the blocks over which noise averages out and structure stays. With 2 noise passes for structure,
with 6 to 8 structure for noise at times (experiments/tuning)."""

NEGLIGIBLE = 0.02
"""Structure below this fraction of the target's contrast is tolerated: two renderers that sample differently leave that
much. 0.01 takes smooth noise for structure, 0.04 lets a floor of another colour pass (experiments/tuning)."""

EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


def in_blocks(image: Float[np.ndarray, "channels height width"], side: int):
    """A picture as "channels rows side columns side" by blocks of `side` pixels a side, with 0 beyond its borders."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side)


def block_sums(image: Float[np.ndarray, "channels height width"], side: int):
    """Sums over blocks of `side` pixels a side, "channels rows columns"; those at the far borders are cut."""
    return in_blocks(image, side).sum((2, 4))


def is_explained(residual: Image, target: Image, counts: Mask, matters: Mask) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something.

    The means of small blocks are those of noise, or negligible: over the pixels that depend on a free parameter, which
    are those that matter, and over all that count.
    """
    # Of white noise block means are a fourth of the residual's root mean square. From 0.35 of it down noise passes for
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
    return all(
        view.linearization.is_finite
        and is_explained(
            view.residual,
            view.weighted_target,
            view.observation.counts,
            np.any(np.asarray(view.linearization.matters), axis=0),
        )
        for view in state.views
    )


def structure_and_contrast(residual: Image, target: Image, where: Mask) -> tuple[float, float]:
    """Root mean square of a residual's means over small blocks within a region, and the contrast of the target's.

    Fewer than two blocks: 0 and infinity.
    """
    counts = block_sums(where.astype(float)[None], BLOCK)[0]
    full = counts >= 0.5 * BLOCK**2  # Requiring full blocks would drop the rim, where wrong models show.
    if np.sum(full) < 2:
        return 0.0, np.inf
    means, colours = (
        block_sums(np.where(where, image, 0), BLOCK)[:, full] / counts[full] for image in (residual, target)
    )
    return float(np.sqrt(np.mean(means**2))), float(np.mean(colours.std(axis=1)))


def vuong_evidence(better: Images, other: Images) -> float:
    """Standard errors by which one weighted residual of all views, under the loss, beats another (after Vuong 1989).

    The squares differ by `2 better (other - better) + (other - better)^2`. The first part is as likely to help as to
    harm if both pictures are equally good: its scatter is the measure, summed by blocks of pixels since neighbours err
    together. The second part grows with the pictures' difference, and its scatter would hide a clear one.
    """
    pairs = list(zip(better, other, strict=True))
    gain = sum(float(np.sum(worse**2 - best**2)) for best, worse in pairs)
    # Blocks of 8 pixels, as a JPEG's.
    chances = [np.linalg.norm(block_sums(2 * best * (worse - best), 8).sum(0)) for best, worse in pairs]
    chance = float(np.linalg.norm(chances))
    return gain / chance if chance > 0 else float(np.inf if gain > 0 else 0)


def distant_correlation(residual: Image, near: int = 4) -> float:
    """Standard score of the products of residuals of two distant pixels: of independent ones 0, with a spread of 1.

    Pairs are those of one channel within blocks of `4 near` pixels a side. Whatever the noise's distribution and
    however unequal, products of independent residuals have the mean 0, as of Moran's statistic (Moran 1950). Their sum
    over all pairs is measured by its scatter from block to block. Of noise alone it was 2.2 at most in 840 draws.

    Args:
        near: pixels over which noise may go together, which are no pairs: 4 of a sensor's mosaic or a resampled
            picture, more of a compressed one.
    """
    # Blocks are larger than that, and there are many in a picture.
    side = 4 * near
    blocks = in_blocks(residual, side).transpose(1, 3, 0, 2, 4).reshape(-1, 3, side, side)

    # Sums over pairs without a loop over them: a residual times the sum of all but those around it.
    window = 2 * near + 1
    around = ndimage.uniform_filter(blocks, window, mode="constant", axes=(2, 3)) * window**2
    sums = np.sum(np.sum(blocks, axis=(2, 3)) ** 2 - np.sum(blocks * around, axis=(2, 3)), axis=1)
    return float(np.sum(sums) / max(np.linalg.norm(sums), TINY))


def block_scatter(views: Sequence[tuple[Float[np.ndarray, "... 3 _ _"], ...]]) -> Covariance:
    """Covariance of a least-squares estimate whose residuals are correlated within blocks of pixels.

    The sandwich `A^-1 (sum of g g^T) A^-1`, with `A = J^T W J` and `g = J^T W r` of each block (Liang and Zeger 1986),
    with blocks of the side that makes it largest.

    Args:
        views: Jacobian J, weights W and residual r of each.
    """
    count = len(views[0][0])
    flats = [(jacobian.reshape(count, -1), weight.reshape(-1)) for jacobian, weight, _ in views]
    normal = np.sum([(flat * weight) @ flat.T for flat, weight in flats], axis=0)
    length = root_diagonal(normal)
    pulls = [np.sum(jacobian * (weight * residual), axis=1) for jacobian, weight, residual in views]
    moved = []
    for side in (16, 32, 64):
        by_block = np.concatenate([block_sums(pull, side).reshape(count, -1) for pull in pulls], axis=1)
        # The pulls sum up to nothing at the optimum: fewer than 30 blocks show too little of their scatter.
        if moved and np.count_nonzero(by_block.any(axis=0)) < 30:
            break
        moved.append(solve_normal(normal, by_block))
    largest = max(moved, key=lambda step: np.linalg.norm(length[:, None] * step))
    return largest @ largest.T


def beyond(observation: Observation, residual: Image, weight: Image, bound: np.ndarray) -> Image:
    """The residuals, but 0 where a bound of them, or the roundings of the fit's precision, may have made them.

    Storing rounds equal colours equally, over whole areas, and that is not noise. Where nearly all residuals of flat
    areas are within the bound there is no noise beside it, and only what is beyond is evidence. Elsewhere all are. At
    edges random samples make noise of their own, which tells nothing of the flat areas.

    Args:
        bound: of each of the target's numbers, in its own unit.
    """
    target, counts = np.asarray(observation.target), observation.seen
    within = np.abs(residual) <= weighted(observation, bound)
    values, neighbours = on_host(target), (1, 3, 3)
    span = ndimage.maximum_filter(values, neighbours) - ndimage.minimum_filter(values, neighbours)
    is_flat = counts & (span <= 4.0 * bound)
    looked_at = is_flat if np.mean(is_flat) > 0.05 else counts
    # Of noise as large as the bound three quarters are within it, of half of that all.
    outside = np.where(within, 0.0, residual) if np.mean(within[looked_at]) > 0.9 else residual
    # A thousand roundings: the digits of sums over a hundred thousand pixels.
    rounding = 1e3 * float(np.finfo(target.dtype).eps) * float(np.max(weighted(observation, np.abs(target))))
    return outside if np.sqrt(np.mean((weight * outside) ** 2)) >= rounding else np.zeros_like(outside)


def weighted(observation: Observation, size: np.ndarray) -> np.ndarray:
    """Sizes in the target's unit in that of its weighted residual; 0 where the weight is 0."""
    # A clamped number's step has no end: it must not meet a weight of 0.
    root = on_host(observation.root_weight)
    return np.where(root > 0, size, 0.0) * root
