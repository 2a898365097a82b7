"""Whether a derivative picture agrees with finite differences, in words."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.tracer.derivatives import correlation, relative_error

Verdict = Literal["agree", "agree but for pixels", "disagree", "undecided"]

LARGEST_ERROR = 0.4
"""A derivative picture agrees if its relative L2 error is at most this: one edge-aware sample a pixel is that good on
all of 52 pictures of random sizes (experiments/edge_gradients)."""

PIXEL_SHARE = 0.1
"""A derivative disagrees if one pixel that holds more of its squared norm than this is wrong."""


class Pixel(NamedTuple):
    """One pixel of a derivative picture: its place, its share of the squared norm, and its channel that is largest.

    Args:
        column, row: from the top left of the picture.
        share: of the derivative's squared norm over all pixels and channels.
        channel: R, G or B.
        derivative, difference: of that channel.
    """

    column: int
    row: int
    share: float
    channel: str
    derivative: float
    difference: float

    def __str__(self) -> str:
        place = f"pixel ({self.column}, {self.row}) holds {100 * self.share:.0f} % of the squared norm"
        return f"{place}, {self.channel} {self.derivative:.3g} where the difference says {self.difference:.3g}"


class DerivativeCheck(NamedTuple):
    """How a derivative picture compares with differences.

    Args:
        verdict: in a word.
        error: the relative L2 error.
        correlation: over pixels and channels.
        spread: about the relative error of the differences themselves.
        exceptions: how many pixels are left out for the rest to agree.
        worst: the pixel that adds most to the error.
    """

    verdict: Verdict
    error: float
    correlation: float
    spread: float
    exceptions: int
    worst: Pixel

    @property
    def words(self) -> str:
        """The verdict and its reason in a sentence."""
        if self.verdict == "agree":
            return f"agree, to {self.error:.2g} of the norm; the differences by two steps to {self.spread:.2g}"
        if self.verdict == "agree but for pixels":
            pixels = "1 pixel" if self.exceptions == 1 else f"{self.exceptions} pixels"
            return f"agree but for {pixels}: {self.worst}"
        if self.verdict == "disagree":
            return f"disagree, by {self.error:.2g} of the norm: {self.worst}"
        return (
            f"undecided: differences by two steps are {self.spread:.2g} of their norm apart, too coarse to judge by; "
            "try more --check-samples, or another --check-step"
        )


def check_derivative(
    derivative: Float[np.ndarray, "3 height width"],
    difference: Float[np.ndarray, "3 height width"],
    spread: float,
    origin: tuple[int, int] = (0, 0),
) -> DerivativeCheck:
    """Compare a derivative picture with finite differences of which the error is about known.

    Args:
        derivative: to be checked.
        difference: to check it by.
        spread: about the relative L2 error of the difference, as in `Differences`.
        origin: column and row of the first pixel in the whole picture.
    """
    # How far the two are apart, in the whole picture and in each pixel.
    derivative, difference = np.asarray(derivative, np.float64), np.asarray(difference, np.float64)
    error = relative_error(derivative, difference)
    squares, errors = np.sum(derivative**2, axis=0), np.sum((derivative - difference) ** 2, axis=0)
    depends = int(np.count_nonzero(squares + errors))
    exceptions = _exceptions(derivative, difference)

    # A single pixel decides if it holds much, is off by more than half of itself, and by more than the differences' own
    # error in the whole picture, which may all lie in it.
    outstanding = (squares > PIXEL_SHARE * np.sum(squares)) & (errors > 0.5**2 * squares)
    outstanding &= errors > spread**2 * np.sum(difference**2)

    # The words name the pixel that adds most to the error.
    row, column = np.unravel_index(np.argmax(errors), errors.shape)
    channel = int(np.argmax(np.abs(derivative - difference)[:, row, column]))
    worst = Pixel(
        origin[0] + int(column),
        origin[1] + int(row),
        float(squares[row, column] / max(np.sum(squares), np.finfo(float).tiny)),
        "RGB"[channel],
        float(derivative[channel, row, column]),
        float(difference[channel, row, column]),
    )

    # Differences that are themselves uncertain prove nothing. Wrong pixels are exceptions up to 0.5 % of those that
    # depend on the parameter, and a disagreement beyond.
    verdict: Verdict
    if spread <= LARGEST_ERROR and (outstanding.any() or exceptions == 0):
        verdict = "disagree" if outstanding.any() else "agree"
    elif error <= 2 * spread:
        verdict = "undecided"
    else:
        verdict = "agree but for pixels" if exceptions <= max(1, 0.005 * depends) else "disagree"
    return DerivativeCheck(verdict, error, correlation(derivative, difference), spread, exceptions, worst)


def _exceptions(derivative: np.ndarray, difference: np.ndarray) -> int:
    """How many pixels have to be left out, the worst first, for the rest to agree."""
    expected = np.sum(difference**2, axis=0).ravel()
    errors = np.sum((derivative - difference) ** 2, axis=0).ravel()
    worst_first = np.argsort(-errors, kind="stable")
    # Of what is left when k pixels are out, k = 0, 1, ...
    left_errors, left_expected = (
        np.append(np.cumsum(values[worst_first][::-1])[::-1], 0.0) for values in (errors, expected)
    )
    return int(np.argmax(left_errors <= LARGEST_ERROR**2 * left_expected))
