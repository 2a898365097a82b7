"""The noise: how the residuals pull on an estimate, each on its own and with its neighbours."""

import numpy as np
from jaxtyping import Float

from ..problem.linearize import outer
from ..problem.stages import Matters, ObservationStage, Scores
from ..problem.unknowns import Covariance, Image, PixelJacobian


class Noise(ObservationStage):
    """Noise of any distribution and unequal size, whose neighbours may go together."""

    @property
    def extent(self) -> int:
        """Pixels over which a sensor's mosaic, or a picture that was resampled, lets noise go together."""
        return 4

    def score_covariance(self, scores: Scores) -> Covariance:
        """The scores' own squares with what leverage hides of them, those of neighbours, and noise that was stated.

        The channels of a pixel share its samples: they are taken together (Liang and Zeger 1986).
        """
        count = len(scores.jacobian)
        of_pixels = (scores.jacobian, scores.weight, scores.score)
        own = scores.scatter + leverage_correction(*(part.reshape(*part.shape[:-2], -1) for part in of_pixels))
        neighbours = correlated_scatter(scores.jacobian, scores.score, scores.matters)
        # Correlations may take away three quarters of a variance, as after sharpening. Where they take more in a
        # direction, as if pooled from a few residuals that decide, they are not known and do not count.
        if count and np.linalg.eigvalsh((1 - 0.75) * own + neighbours)[0] < 0:
            neighbours = np.zeros_like(own)
        return own + neighbours + scores.unseen * outer((scores.jacobian * scores.weight).reshape(count, -1))


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
    pulling, root, seen = jacobian[:, :, decides], root[:, decides], score[:, decides]
    # A pixel that alone decides a number shows nothing of its error but rounding: what it leaves is at least 1e-6.
    followed, axes = np.linalg.eigh(np.moveaxis(leverage[:, :, decides], -1, 0))
    left = np.maximum(1 - followed, 1e-6)
    whole = root * np.einsum("pce,pe,pde,dp->cp", axes, 1 / left, axes, seen / root)
    with_, without = (np.sum(pulling * part, axis=1) for part in (whole, seen))
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
