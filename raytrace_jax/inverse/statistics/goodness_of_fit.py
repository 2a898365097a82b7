"""Whether a picture explains the target, so that what is left looks like noise; and which of two does so better.

A search asks this of each minimum, in milliseconds. `model_check` asks more, of the answer only.
"""

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.inverse.problem.state import FitState

SQUARE = 4
"""Side in pixels of the squares over which noise averages out and structure stays. With 2 noise passes for structure,
with 6 to 8 structure for noise at times; 3 and 4 do the same on two scenes (experiments/tuning)."""

STRUCTURE_SHARE = 0.5
"""Square means above this share of the residual's root mean square are structure; of white noise they are a fourth.
From 0.35 down noise passes for structure at times, from 0.7 up structure for noise (experiments/tuning)."""

NEGLIGIBLE = 0.02
"""Structure below this share of the target's contrast is that of a good model: two programs sample in two ways.
0.01 takes smooth noise for structure, 0.04 lets a floor of another colour pass (experiments/tuning)."""

NEGLIGIBLE_ELSEWHERE = 0.2
"""Structure over all pixels below this share is negligible; those that no free parameter moves bias no estimate.
On two scenes 0.4 lets a white corner of a twelfth of the sides pass, 0.05 and 0.1 also tell another floor behind a
small ball (experiments/tuning)."""

LEAST_INSIDE = 0.5
"""Share of a square that must lie in a region for its mean to count. 0.25 does the same on two scenes; with
1, whole squares only, wrong models pass (experiments/tuning)."""

FEWEST_SQUARES = 2
"""Least number of square means from which structure can be told. 2 to 8 do the same on two scenes, 1 tells a wrong
model of a small ball more on each (experiments/tuning)."""


def square_sums(
    image: Float[np.ndarray, "channels height width"], side: int
) -> Float[np.ndarray, "channels rows columns"]:
    """Sums over squares of so many pixels a side; squares at the right and lower border may be cut."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side).sum((2, 4))


def is_explained(
    residual: Float[np.ndarray, "3 height width"],
    target: Float[np.ndarray, "3 height width"],
    counts: Bool[np.ndarray, "height width"],
    matters: Bool[np.ndarray, "height width"],
) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something.

    Args:
        residual: picture minus target.
        target: the target.
        counts: the pixels that count.
        matters: the pixels that depend on a free parameter.
    """
    return all(
        not has_structure(residual, target, where, share)
        for where, share in ((matters & counts, NEGLIGIBLE), (counts, NEGLIGIBLE_ELSEWHERE))
    )


def is_near(
    residual: Float[np.ndarray, "3 height width"],
    target: Float[np.ndarray, "3 height width"],
    counts: Bool[np.ndarray, "height width"],
) -> bool:
    """Whether a picture is so near the target that what is left can be compared with small changes of the model."""
    means, contrast = square_means(residual, counts), square_means(target, counts)
    # Structure above a fifth of the target's contrast is that of another scene, or of a minimum that is not the answer.
    return means.shape[1] < FEWEST_SQUARES or bool(np.sqrt(np.mean(means**2)) < 0.2 * np.mean(contrast.std(axis=1)))


def explains(state: FitState) -> bool:
    """Whether the picture there explains the target; a picture that is not finite does not."""
    if not state.linearization.is_finite:
        return False
    target = np.asarray(state.problem.binned(state.comparison.binning).target)
    return is_explained(state.residual, target, state.counts, np.asarray(state.linearization.matters))


def has_structure(residual, target, where: Bool[np.ndarray, "height width"], negligible: float) -> bool:
    """Whether the means of small squares within a region are neither those of noise nor negligible."""
    means, contrast = square_means(residual, where), square_means(target, where)
    if means.shape[1] < FEWEST_SQUARES:
        return False
    structure = float(np.sqrt(np.mean(means**2)))
    scatter = float(np.sqrt(np.mean(residual[:, where] ** 2)))
    return structure > max(STRUCTURE_SHARE * scatter, negligible * float(np.mean(contrast.std(axis=1))))


def square_means(image, where: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "3 squares"]:
    """Mean over the pixels of a region in each square that lies well within it."""
    counts = square_sums(where.astype(float)[None], SQUARE)[0]
    full = counts >= LEAST_INSIDE * SQUARE**2
    return square_sums(np.where(where, image, 0), SQUARE)[:, full] / counts[full]


BLOCK = 8
"""Side in pixels of the squares within which errors may go together: a JPEG's blocks."""

EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


def vuong_evidence(better: Float[np.ndarray, "3 height width"], other: Float[np.ndarray, "3 height width"]) -> float:
    """How many standard errors better one picture explains a target than another (after Vuong 1989).

    The squares differ by `2 better (other - better) + (other - better)^2`. The first part is as likely to help as to
    harm if both pictures are equally good: its scatter is the measure, summed by squares of pixels since neighbours err
    together. The second part grows with the pictures' difference, and its scatter would hide a clear one.

    Args:
        better, other: residuals of both, weighted and under the loss.
    """
    gain = float(np.sum(other**2 - better**2))
    chance = float(np.linalg.norm(square_sums(2 * better * (other - better), BLOCK).sum(0)))
    return gain / chance if chance > 0 else float(np.inf if gain > 0 else 0)
