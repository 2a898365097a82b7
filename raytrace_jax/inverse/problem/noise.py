"""Noise and storing of a target: how residuals pull on an estimate, alone, with neighbours, and rounded alike."""

import numpy as np
from jaxtyping import Bool, Float

from ...images.jpeg import JpegStorage
from ...images.transfer import rounding_of
from ...util.numerics import MAD_TO_SIGMA, on_host
from .observation import Observation
from .problem import FitState, Problem
from .unknowns import Covariance, Image, PixelJacobian

Matters = Bool[np.ndarray, "3 height width"]
"""The numbers that count, of the pixels that depend on a free parameter."""


def score_covariance(
    jacobian: PixelJacobian, weight: Image, score: Image, matters: Matters, scatter: Covariance
) -> Covariance:
    """The covariance of the sum of scores `J^T rho'`, of noise of any distribution whose neighbours correlate.

    It is their own squares with what leverage hides of them, and those of neighbours. The channels of a pixel share its
    samples: they are taken together (Liang and Zeger 1986).

    Args:
        jacobian: derivative of each weighted residual along each direction, in which `J^T W J` is the identity.
        weight, score: `rho' / r` and `rho'` of the loss at each residual `r`.
        scatter: sum over pixels of the outer product of their scores, `sum_p (J_p^T rho'_p)(J_p^T rho'_p)^T`.
    """
    alone = scatter + leverage_correction(*(part.reshape(*part.shape[:-2], -1) for part in (jacobian, weight, score)))
    neighbours = correlated_scatter(jacobian, score, matters)
    # Correlations may take away three quarters of a variance, as after sharpening. Where they take more in a
    # direction, as if pooled from a few residuals that decide, they are not known and do not count.
    overshoots = len(alone) and np.linalg.eigvalsh((1 - 0.75) * alone + neighbours)[0] < 0
    return alone if overshoots else alone + neighbours


def leverage_correction(
    jacobian: Float[np.ndarray, "parameters channels pixels"],
    weight: Float[np.ndarray, "channels pixels"],
    score: Float[np.ndarray, "channels pixels"],
) -> Covariance:
    """Leverage correction of the score covariance, `sum (J^T (1 - H)^-1 s)(...)^T - (J^T s)(J^T s)^T` (HC3).

    An estimate follows a pixel by its leverage `H = J A^-1 J^T W` and leaves `1 - H` of its error to be seen, `H` a
    matrix of its channels. Here A is the identity, as along the directions of `Scores`: that of all pictures which the
    estimate is made of. So the pull that it would have on an estimate made without it is `J^T (1 - H)^-1` times what is
    seen (the jackknife: MacKinnon and White 1985; of clusters: Bell and McCaffrey 2002). In a picture of many pixels
    nothing is hidden, but at the rim of glass one pixel may decide.
    """
    root = np.sqrt(weight)
    rows = jacobian * root
    leverage = np.einsum("acp,adp->cdp", rows, rows)
    decides = np.einsum("ccp->p", leverage) > 0.01  # Others lose less than a hundredth of their residual.
    pulling, root, left_score = jacobian[:, :, decides], root[:, decides], score[:, decides]
    # A pixel that alone decides a number shows nothing of its error but rounding: what it leaves is at least 1e-6.
    followed, axes = np.linalg.eigh(np.moveaxis(leverage[:, :, decides], -1, 0))
    left = np.maximum(1 - followed, 1e-6)
    whole = root * np.einsum("pce,pe,pde,dp->cp", axes, 1 / left, axes, left_score / root)
    with_, without = (np.sum(pulling * part, axis=1) for part in (whole, left_score))
    return with_ @ with_.T - without @ without.T


def correlated_scatter(jacobian: PixelJacobian, score: Image, matters: Matters) -> Covariance:
    """The part of correlated neighbours in the covariance of `sum(jacobian * score)` (after Conley 1999).

    The scores' covariance by distance and channels is pooled over the picture. That is a few numbers, known well; sums
    over squares of pixels are few, and lose what crosses their borders.
    """
    count, farthest = len(jacobian), 7  # Pixels: to the far side of a block of a JPEG.
    # Far from all that matters there is nothing to add up.
    rows, columns = (np.flatnonzero(matters.any(axis=axes)) for axes in ((0, 2), (0, 1)))
    if not len(rows):
        return np.zeros((count, count))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    jacobian, score, matters = (part[..., *window] for part in (jacobian, score, matters))
    jacobian, score = np.where(matters, jacobian, 0.0), np.where(matters, score, 0.0)
    variance = np.sum(score**2, axis=(1, 2)) / np.maximum(matters.sum(axis=(1, 2)), 1)
    number = matters.astype(score.dtype)
    added = np.zeros((count, count))
    for down in range(farthest + 1):
        for right in range(-farthest if down else 1, farthest + 1):
            here, there = _pair_windows(down, right)
            # Of each two channels; a weight may leave out one of them.
            pairs = _products(number, here, there)
            if not pairs.any():
                continue
            pairs = np.maximum(pairs, 1)
            # Only what is 5 standard errors above chance counts: of a thousand correlations chance makes none so large.
            covariance = _products(score, here, there) / pairs
            chance = np.sqrt(np.outer(variance, variance) / pairs)
            covariance = np.where(np.abs(covariance) > 5.0 * chance, covariance, 0.0)
            if not covariance.any():
                continue
            # A pair is seen from one side; from the other its part is transposed.
            mixed = np.einsum("ab,pbhw->pahw", covariance, jacobian[:, :, *there])
            part = jacobian[:, :, *here].reshape(count, -1) @ mixed.reshape(count, -1).T
            added += part + part.T
    return added


def _products(image: Image, here: tuple[slice, slice], there: tuple[slice, slice]) -> Float[np.ndarray, "3 3"]:
    """Sums of the products of two windows of a picture, for each two channels."""
    return image[:, *here].reshape(len(image), -1) @ image[:, *there].reshape(len(image), -1).T


def _pair_windows(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pixels that have another one so far away, and those others."""
    columns = (slice(0, -right or None), slice(right, None)) if right >= 0 else (slice(-right, None), slice(0, right))
    rows = slice(0, -down or None), slice(down, None)
    return (rows[0], columns[0]), (rows[1], columns[1])


def compressed(storage: JpegStorage, observation: Observation, image: Image) -> Image:
    """Expected picture as it is read back from a JPEG, over the noise of the target.

    Edges become softer, and colours mix across them. Noise decides for many patterns whether they are kept, so that
    pictures with noise are compressed. It is taken to be white in the stored numbers, as the shot noise of a camera
    nearly is, and as large as the residual's.
    """
    counts = observation.counts
    # How large the target's noise is, in the stored numbers.
    numbers, target = storage.encode(image), storage.encode(on_host(observation.target))
    off = (target - numbers)[:, counts]
    sigma = MAD_TO_SIGMA * np.median(np.abs(off - np.median(off, axis=1, keepdims=True)), axis=1)
    random, total = np.random.default_rng(0), np.zeros_like(image)
    # The noise that is left in a mean of 16 adds a sixteenth to the target's variance.
    draws = 16
    for _ in range(draws):
        total += storage.compress(numbers + sigma[:, None, None] * random.normal(size=image.shape))
    return total / draws


def storage_bound(problem: Problem) -> Image:
    """The largest residual of each number, in the target's unit, that its rounding makes by itself.

    It is three quarters of a step: half of one, and the roundings of the picture. Renderers store samples with 16 bits,
    white being a power of two, before they take their mean: that makes a step and a half of these.
    """
    target = on_host(problem.observation.target)
    most = np.max(target)
    sampled = 1.5 * 2.0 ** np.ceil(np.log2(most)) / 65535 if problem.samples != 1 and most > 0 else 0.0
    return np.maximum(1.5 * rounding_of(target), sampled)


def sample_jump(state: FitState) -> float:
    """The change of a number, in the target's unit, by the samples of a known grid that may lie beyond an edge."""
    samples = state.problem.samples
    if samples is None or state.confusion is None:
        return 0.0
    # Two: of a board, 320 x 240 with 8 x 8 samples, at a place right to 1.5e-8, less than one does.
    return 2 * float(np.ptp(on_host(state.problem.observation.target))) / samples**2


def rounding_scatter(jacobian: PixelJacobian, weight: Image, picture: Image, target: Image) -> Covariance:
    """The part of equal roundings of equal colours in the covariance of `sum(jacobian * weight * residual)`.

    A stored number is off by up to half a step, and by the same wherever the colour is the same: over whole squares of
    a board. So the target is stored again with its steps shifted by parts of one, and the covariance of the pulls is
    that over the shifts, less what they would have if each pixel were rounded on its own. Noise beside the rounding
    makes its errors independent: normal noise of `s` steps leaves `exp(-(2 pi s)^2)` of their correlation (Widrow and
    Kollar 2008, Quantization Noise).

    Where they take scores away they do not count.

    Args:
        weight: weight of each residual under the loss, and in the residual itself.
        picture: what is compared with the target, with its bias.
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
    # Noise of s steps moves a fraction of .8 s of all numbers beyond their step.
    size = np.interp(picture[stored], value, step)
    beyond = float(np.mean(np.abs(picture[stored] - target[stored]) > size / 2))
    kept = np.exp(-((2 * np.pi * beyond / 0.8) ** 2))
    # Most numbers of many pictures pull at nothing.
    stored &= np.any(jacobian != 0, axis=0)
    colour, size = np.interp(picture[stored], value, place), np.interp(picture[stored], value, step)
    pulling = jacobian[:, stored] * (weight[stored] * size)
    draws = 16
    for shift in (np.arange(draws) + 0.5) / draws:
        off = colour + shift - np.rint(colour + shift)
        together, alone = pulling @ off, pulling * off
        added += kept / draws * (np.outer(together, together) - alone @ alone.T)
    strengths, axes = np.linalg.eigh(added)
    return (axes * np.maximum(strengths, 0)) @ axes.T
