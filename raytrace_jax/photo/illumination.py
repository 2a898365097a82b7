"""The light on a board that no lamp describes: a smooth field of few numbers, from where the board is seen directly."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..util.numerics import MAD_TO_SIGMA


class IlluminationMap(NamedTuple):
    """The light on a board: of white paper, and the ink's share of it.

    Args:
        half: half the board's width and height.
        coefficients: of the polynomial's terms, for each channel.
        ink: how much light ink returns, as a share of what paper does.
        rest: what the field leaves of the paper, as a share of it: one standard deviation.
    """

    half: Float[np.ndarray, "2"]
    coefficients: Float[np.ndarray, "3 terms"]
    ink: Float[np.ndarray, "3"]
    rest: float

    def at(self, place: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, "3 *any"]:
        """The light of white paper at places of the board; beyond the border it goes on as at the border."""
        terms = _terms(np.clip(place / self.half, -1.05, 1.05))
        return np.tensordot(self.coefficients, terms, axes=(1, 0))


def fit_illumination(
    image: Float[np.ndarray, "3 pixels"],
    place: Float[np.ndarray, "pixels 2"],
    brightness: Float[np.ndarray, " pixels"],
    half: Float[np.ndarray, "2"],
) -> IlluminationMap:
    """Fit the field to the scene-linear light of pixels that see paper, a brightness of 1, or ink, 0, at places.

    Pixels in the shadow or behind the hand of somebody do not count in it.
    """
    paper, ink = brightness > 0.5, brightness <= 0.5
    terms = _terms(place / half)
    # Some 60000 pixels of paper, evenly chosen, are enough for a field of few numbers.
    chosen = np.flatnonzero(paper)[:: max(1, int(np.sum(paper)) // 60_000)]
    keep = np.ones(len(chosen), bool)
    coefficients = np.zeros((3, len(terms)))
    # A tilted plane comes first: it cannot follow a ball into its dark inside, so that this counts as an outlier.
    for count in (3, 3, *[len(terms)] * 4):
        columns = terms[:count, chosen[keep]].T
        coefficients[:, :count] = np.linalg.lstsq(columns, image[:, chosen[keep]].T, rcond=None)[0].T
        off = np.max(np.abs(image[:, chosen] / np.maximum(coefficients @ terms[:, chosen], 1e-6) - 1), axis=0)
        # Beyond three standard deviations a pixel is a shadow's edge, a hand or a stain.
        keep = off < 3 * MAD_TO_SIGMA * max(float(np.median(off)), 1e-4)
    share = image / np.maximum(coefficients @ terms, 1e-6)
    of_ink = np.median(share[:, ink], axis=1) if ink.any() else np.zeros(3)
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(share[:, paper] - 1)))
    return IlluminationMap(half, coefficients, of_ink, scatter)


def _terms(place: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, "terms *any"]:
    """Products of Legendre's polynomials in coordinates from -1 to 1, up to the fourth degree in all, lowest first.

    A quadratic serves even light, lamps near the board want more; the degree was not tuned. It leaves 1.1 % of the
    paper's light in room 6 of `experiments/photograph`.
    """
    legendre = [np.polynomial.legendre.Legendre.basis(n) for n in range(5)]
    x, y = ([one(axis) for one in legendre] for axis in np.moveaxis(place, -1, 0))
    return np.stack([x[i] * y[n - i] for n in range(5) for i in range(n + 1)])
