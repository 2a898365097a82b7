"""Noise models of the residual: structure, evidence, and the covariance of neighbours, storage and leverage."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from raytrace_jax.images.transfer import rounding_of
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.unknowns import Covariance, Image, Mask, PixelJacobian
from raytrace_jax.util.numerics import TINY, solve_normal

SQUARE = 4
"""Side in pixels of the squares over which noise averages out and structure stays. With 2 noise passes for structure,
with 6 to 8 structure for noise at times (experiments/tuning)."""

STRUCTURE_SHARE = 0.5
"""Square means above this fraction of the residual's root mean square are structure; of white noise they are a fourth.
From 0.35 down noise passes for structure at times, from 0.7 up structure for noise (experiments/tuning)."""

NEGLIGIBLE = 0.02
"""Structure below this fraction of the target's contrast is that of a good model: two programs sample in two ways.
0.01 takes smooth noise for structure, 0.04 lets a floor of another colour pass (experiments/tuning)."""

NEGLIGIBLE_ELSEWHERE = 0.2
"""Structure over all pixels below this fraction is negligible; those that no free parameter moves bias no estimate.
0.4 lets a white corner of a twelfth of the sides pass (experiments/tuning)."""

FEWEST_SQUARES = 2
"""The fewest square means from which structure can be told; 2 to 8 do the same."""


def square_sums(
    image: Float[np.ndarray, "channels height width"], side: int
) -> Float[np.ndarray, "channels rows columns"]:
    """Sums over squares of so many pixels a side; squares at the right and lower border may be cut."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side).sum((2, 4))


def is_explained(residual: Image, target: Image, counts: Mask, matters: Mask) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something.

    The means of small squares are those of noise, or negligible: over the pixels that depend on a free parameter, which
    are those that matter, and over all that count.
    """
    for where, negligible in ((matters & counts, NEGLIGIBLE), (counts, NEGLIGIBLE_ELSEWHERE)):
        means, contrast = square_means(residual, where), square_means(target, where)
        if means.shape[1] < FEWEST_SQUARES:
            continue
        structure = float(np.sqrt(np.mean(means**2)))
        scatter = float(np.sqrt(np.mean(residual[:, where] ** 2)))
        if structure > max(STRUCTURE_SHARE * scatter, negligible * float(np.mean(contrast.std(axis=1)))):
            return False
    return True


def is_near(residual: Image, target: Image, counts: Mask) -> bool:
    """Whether a picture is so near the target that what is left can be compared with small changes of the model."""
    means, contrast = square_means(residual, counts), square_means(target, counts)
    # Structure above a fifth of the target's contrast is that of another scene, or of a minimum that is not the answer.
    return means.shape[1] < FEWEST_SQUARES or bool(np.sqrt(np.mean(means**2)) < 0.2 * np.mean(contrast.std(axis=1)))


def explains(state: FitState) -> bool:
    """Whether the picture there explains the target; a picture that is not finite does not."""
    if not state.linearization.is_finite:
        return False
    return is_explained(state.residual, state.weighted_target, state.counts, np.asarray(state.linearization.matters))


def square_means(image, where: Mask) -> Float[np.ndarray, "3 squares"]:
    """Mean over the pixels of a region in each square that lies well within it."""
    counts = square_sums(where.astype(float)[None], SQUARE)[0]
    full = counts >= 0.5 * SQUARE**2  # With whole squares only wrong models pass.
    return square_sums(np.where(where, image, 0), SQUARE)[:, full] / counts[full]


EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


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
        near: score of pixels so near that noise may go together.
        far: score of others in one square, of four times that.
    """

    near: float
    far: float


def pair_scores(residual: Image, near: int = 4) -> PairScores:
    """Compare pairs of pixels of one channel within squares of `4 near` pixels a side.

    Whatever the noise's distribution and however unequal, products of independent residuals have the mean 0. Their sum
    over all pairs is measured by its scatter from square to square.

    Args:
        near: pixels over which noise may go together: 4 of a sensor's mosaic or a resampled picture, more of a
            compressed one.
    """
    # Squares are larger than that, and there are many in a picture.
    side = 4 * near
    _, height, width = residual.shape
    padded = np.pad(residual, ((0, 0), (0, -height % side), (0, -width % side)))
    squares = padded.reshape(3, padded.shape[1] // side, side, -1, side).transpose(1, 3, 0, 2, 4)
    squares = squares.reshape(-1, 3, side, side)

    # Sums over pairs without a loop over them: a residual times the sum of all, or of those around it.
    window = 2 * near + 1
    around = ndimage.uniform_filter(squares, window, mode="constant", axes=(2, 3)) * window**2
    all_pairs = np.sum(squares, axis=(2, 3)) ** 2
    near_pairs = np.sum(squares * around, axis=(2, 3))
    own = np.sum(squares**2, axis=(2, 3))
    return PairScores(_score((near_pairs - own).sum(axis=1)), _score((all_pairs - near_pairs).sum(axis=1)))


def _score(sums: Float[np.ndarray, " squares"]) -> float:
    scatter = float(np.linalg.norm(sums))
    return float(np.sum(sums)) / scatter if scatter > 0 else 0.0


def correlated_scatter(jacobian: PixelJacobian, score: Image, matters: Mask) -> Covariance:
    """The part of correlated neighbours in the covariance of `sum(jacobian * score)`.

    The scores' covariance by distance and channels is pooled over the picture. That is a few numbers, known well; sums
    over squares of pixels are few, and lose what crosses their borders.
    """
    count, farthest = len(jacobian), 7  # Pixels: to the far side of a block of a JPEG.
    jacobian, score = np.where(matters, jacobian, 0.0), np.where(matters, score, 0.0)
    variance = np.sum(score**2, axis=(1, 2)) / max(int(matters.sum()), 1)
    added = np.zeros((count, count))
    for down in range(farthest + 1):
        for right in range(-farthest if down else 1, farthest + 1):
            here, there = _pair_windows(down, right)
            pairs = int(np.sum(matters[here] & matters[there]))
            if not pairs:
                continue
            # Only what is 5 standard errors above chance counts: of a thousand correlations chance makes none so large.
            covariance = np.einsum("ahw,bhw->ab", score[:, *here], score[:, *there]) / pairs
            chance = np.sqrt(np.outer(variance, variance) / pairs)
            covariance = np.where(np.abs(covariance) > 5.0 * chance, covariance, 0.0)
            if not covariance.any():
                continue
            # A pair is seen from one side; from the other its part is transposed.
            mixed = np.einsum("ab,pbhw->pahw", covariance, jacobian[:, :, *there])
            part = jacobian[:, :, *here].reshape(count, -1) @ mixed.reshape(count, -1).T
            added += part + part.T
    return added


def _pair_windows(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pixels that have another one so far away, and those others."""
    columns = (slice(0, -right or None), slice(right, None)) if right >= 0 else (slice(-right, None), slice(0, right))
    rows = slice(0, -down or None), slice(down, None)
    return (rows[0], columns[0]), (rows[1], columns[1])


def storage_scatter(jacobian: PixelJacobian, weight: Image, picture: Image, target: Image) -> Covariance:
    """The part of equal roundings of equal colours in the covariance of `sum(jacobian * weight * residual)`.

    A stored number is off by up to half a step, and by the same wherever the colour is the same: over whole squares of
    a board. So the target is stored again with its steps shifted by parts of one, and the covariance of the pulls is
    that over the shifts, less what they would have if each pixel were rounded on its own. Noise beside the rounding
    makes its errors independent: normal noise of `s` steps leaves `exp(-(2 pi s)^2)` of their correlation.

    Args:
        weight: weight of each residual under the loss, and in the residual itself.
    """
    steps = 2 * rounding_of(target)
    stored = (weight > 0) & np.isfinite(steps) & (steps > 0)
    added = np.zeros((len(jacobian), len(jacobian)))
    if not stored.any():
        return added
    # Where each colour lies among the steps, counted from the darkest one.
    value, first = np.unique(target[stored], return_index=True)
    step = steps[stored][first]
    place = np.r_[0.0, np.cumsum(np.diff(value) * 2 / (step[1:] + step[:-1]))]
    colour, size = np.interp(picture[stored], value, place), np.interp(picture[stored], value, step)
    # Noise of s steps moves a fraction of .8 s of all numbers beyond their step.
    beyond = float(np.mean(np.abs(picture[stored] - target[stored]) > size / 2))
    kept = np.exp(-((2 * np.pi * beyond / 0.8) ** 2))
    pulling = jacobian[:, stored] * (weight[stored] * size)
    draws = 16
    for shift in (np.arange(draws) + 0.5) / draws:
        off = colour + shift - np.rint(colour + shift)
        together, alone = pulling @ off, pulling * off
        added += kept / draws * (np.outer(together, together) - alone @ alone.T)
    return added


def block_scatter(jacobian: PixelJacobian, weight: Image, residual: Image) -> Covariance:
    """Covariance of a least-squares estimate whose residuals are correlated within blocks of pixels.

    The sandwich `A^-1 (sum of g g^T) A^-1`, with `A = J^T W J` and `g = J^T W r` of each block (Liang and Zeger 1986),
    with blocks of the side that makes it largest.
    """
    count = len(jacobian)
    flat = jacobian.reshape(count, -1)
    normal = (flat * weight.reshape(-1)) @ flat.T
    length = np.sqrt(np.maximum(np.diagonal(normal), TINY))
    inverse = np.linalg.pinv(normal / np.outer(length, length), rcond=1e-12, hermitian=True)
    pulls = np.sum(jacobian * (weight * residual), axis=1) / length[:, None, None]

    # The pulls sum up to nothing at the optimum: fewer than 30 blocks show too little of their scatter.
    largest, most = np.zeros((count, count)), -1.0
    for side in (16, 32, 64):
        by_block = square_sums(pulls, side).reshape(count, -1)
        if side > 16 and np.count_nonzero(by_block.any(axis=0)) < 30:
            break
        found = inverse @ (by_block @ by_block.T) @ inverse
        if np.trace(found) > most:
            largest, most = found, float(np.trace(found))
    return largest / np.outer(length, length)


def hidden_scatter(
    jacobian: Float[np.ndarray, "parameters channels pixels"],
    weight: Float[np.ndarray, "channels pixels"],
    score: Float[np.ndarray, "channels pixels"],
) -> Covariance:
    """The part that the fit hides of the sum over pixels of their pulls' outer products.

    An estimate follows a pixel by its leverage `H = J A^-1 J^T W` and leaves `1 - H` of its error to be seen, `H` a
    matrix of its channels. So the pull that it would have on an estimate made without it is `J^T (1 - H)^-1` times
    what is seen (the jackknife: MacKinnon and White 1985; of clusters: Bell and McCaffrey 2002). In a picture of many
    pixels nothing is hidden, but at the rim of glass one pixel may decide.
    """
    root = np.sqrt(weight)
    leverage = leverages(jacobian * root)
    decides = np.einsum("ccp->p", leverage) > 0.01  # Others lose less than a hundredth of their residual.
    pulling, root, seen = jacobian[:, :, decides], root[:, decides], score[:, decides]
    # A pixel that alone decides a number shows nothing of its error but rounding: what it leaves is at least 1e-6.
    followed, axes = np.linalg.eigh(np.moveaxis(leverage[:, :, decides], -1, 0))
    left = np.maximum(1 - followed, 1e-6)
    whole = root * np.einsum("pce,pe,pde,dp->cp", axes, 1 / left, axes, seen / root)
    with_, without = (np.sum(pulling * part, axis=1) for part in (whole, seen))
    return with_ @ with_.T - without @ without.T


def leverages(rows: Float[np.ndarray, "parameters channels pixels"]) -> Float[np.ndarray, "channels channels pixels"]:
    """How a least-squares fit follows the residuals of each pixel: 0 where it does not, 1 where it goes with them.

    Args:
        rows: the derivatives of the residuals, times the roots of their weights.
    """
    flat = rows.reshape(len(rows), -1)
    return np.einsum("acp,adp->cdp", rows, solve_normal(flat @ flat.T, flat).reshape(rows.shape))
