"""A sample of pixels that stands for a whole picture: those that decide the estimate, and some of the others."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.statistics.goodness_of_fit import square_sums

SIDE = 4
"""Side in pixels of the squares that are looked at as a whole: neighbours which err together are seen together."""


class LookedAt(NamedTuple):
    """Pixels, by whole squares.

    Args:
        row, column: where each pixel is.
        square: number of the square that each is in.
        share: the chance that it was looked at; it stands for one over that many pixels.
    """

    row: Int[np.ndarray, " pixels"]
    column: Int[np.ndarray, " pixels"]
    square: Int[np.ndarray, " pixels"]
    share: Float[np.ndarray, " pixels"]

    def of(self, image: np.ndarray) -> np.ndarray:
        """The pixels' values in a picture, "*any height width", as "*any pixels"."""
        return image[..., self.row, self.column]

    def inner(self, counts: Bool[np.ndarray, "height width"], margin: int) -> "LookedAt":
        """The pixels that count and whose neighbours, up to `margin` away, are all looked at or beyond the border."""
        seen = np.zeros(counts.shape, bool)
        seen[self.row, self.column] = True
        if margin:
            seen = ndimage.binary_erosion(seen, np.ones((2 * margin + 1,) * 2), border_value=1)
        kept = (seen & counts)[self.row, self.column]
        return LookedAt(*(part[kept] for part in self))


def look_at(
    counts: Bool[np.ndarray, "height width"],
    weight: Float[np.ndarray, "height width"],
    most: int,
    side: int = SIDE,
    together: int = SIDE,
) -> LookedAt:
    """Choose squares at random, with a chance in proportion to what is in them (Horvitz and Thompson 1952).

    Args:
        counts: the pixels that count.
        weight: how much each decides.
        most: how many pixels are wanted; all are taken if there are no more.
        side: side in pixels of the squares that are chosen.
        together: side in pixels of the squares in which neighbours are taken to err together.
    """
    # The chance of each square: mostly by what decides, three tenths spread evenly over the picture.
    chosen_from, square = (squares_of(counts.shape, each) for each in (side, together))
    pixels = square_sums(counts[None].astype(float), side).reshape(-1)
    share = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        size = square_sums(np.where(counts, weight, 0.0)[None], side).reshape(-1)
        even = 0.3
        size = (1 - even) * size / max(size.sum(), 1e-300) + even * pixels / pixels.sum()
        share = shares(size, pixels, most)

    # Systematic sampling: one draw u decides. A square is chosen where u plus the cumulative chance passes a whole
    # number, so that as many are chosen as are wanted.
    steps = np.floor(np.cumsum(share) + np.random.default_rng(0).uniform())
    chosen = np.diff(steps, prepend=np.floor(steps[0] - share[0])) > 0
    chosen = (chosen | (share >= 1)) & (pixels > 0)
    row, column = np.nonzero(counts & chosen[chosen_from])
    return LookedAt(row, column, square[row, column], share[chosen_from[row, column]])


def squares_of(shape: tuple[int, ...], side: int) -> Int[np.ndarray, "height width"]:
    """The number of the square, of so many pixels a side, in which each pixel of a picture is."""
    height, width = shape
    number = np.arange(-(-height // side) * -(-width // side)).reshape(-(-height // side), -1)
    return np.repeat(np.repeat(number, side, 0), side, 1)[:height, :width]


def shares(size: Float[np.ndarray, " squares"], pixels: Float[np.ndarray, " squares"], most: int) -> np.ndarray:
    """Chances in proportion to sizes, at most 1, such that about `most` pixels are expected."""
    # Chances above 1 are cut to 1, and the others grow to make up for it, until none is above 1.
    share = np.zeros_like(size)
    for _ in range(20):
        sure = share >= 1
        left = most - pixels[sure].sum()
        rest = np.where(sure, 0.0, size)
        if left <= 0 or not rest.any():
            break
        share = np.where(sure, 1.0, np.minimum(rest * left / (rest * pixels).sum(), 1.0))
        if np.array_equal(share >= 1, sure):
            break
    return share
