"""Some of a picture's pixels that stand for all: those that decide the estimate, and a sample of the others."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.judge.goodness_of_fit import square_sums

SIDE = 4
"""Pixels are looked at in squares of so many a side, so that neighbours which err together are seen together."""

EVEN_SHARE = 0.3
"""How much of the chance to be looked at is spread evenly over the picture; the rest goes to what decides."""


class LookedAt(NamedTuple):
    """Pixels, by whole squares.

    Args:
        row, column: of each pixel.
        square: which square each is in.
        share: the chance that it had to be looked at: it stands for one over that many.
    """

    row: Int[np.ndarray, " pixels"]
    column: Int[np.ndarray, " pixels"]
    square: Int[np.ndarray, " pixels"]
    share: Float[np.ndarray, " pixels"]

    def of(self, image: np.ndarray) -> np.ndarray:
        """Their values in a picture, "*any height width", as "*any pixels"."""
        return image[..., self.row, self.column]

    def inner(self, counts: Bool[np.ndarray, "height width"], margin: int) -> "LookedAt":
        """Those that count and whose neighbours, up to so many pixels away, are all looked at, or beyond the border."""
        seen = np.zeros(counts.shape, bool)
        seen[self.row, self.column] = True
        if margin:
            seen = ndimage.binary_erosion(seen, np.ones((2 * margin + 1,) * 2), border_value=1)
        kept = (seen & counts)[self.row, self.column]
        return LookedAt(*(part[kept] for part in self))


def look_at(
    counts: Bool[np.ndarray, "height width"], weight: Float[np.ndarray, "height width"], most: int, side: int = SIDE
) -> LookedAt:
    """Choose squares at random, with a chance in proportion to what is in them (Horvitz and Thompson 1952).

    Args:
        counts: the pixels that count.
        weight: how much each decides.
        most: how many pixels are wanted; all, if there are no more.
        side: of the squares that are chosen, in pixels; neighbours are taken to err together in those of `SIDE`.
    """
    chosen_from, square = (squares_of(counts.shape, each) for each in (side, SIDE))
    pixels = square_sums(counts[None].astype(float), side).reshape(-1)
    share = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        size = square_sums(np.where(counts, weight, 0.0)[None], side).reshape(-1)
        size = (1 - EVEN_SHARE) * size / max(size.sum(), 1e-300) + EVEN_SHARE * pixels / pixels.sum()
        share = shares(size, pixels, most)
    # Systematic sampling: one draw decides, so that as many are chosen as are wanted.
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
