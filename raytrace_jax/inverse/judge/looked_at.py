"""Some of a picture's pixels that stand for all: those that decide the estimate, and a sample of the others."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

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


def look_at(counts: Bool[np.ndarray, "height width"], weight: Float[np.ndarray, "height width"], most: int) -> LookedAt:
    """Choose squares at random, with a chance in proportion to what is in them (Horvitz and Thompson 1952).

    Args:
        counts: the pixels that count.
        weight: how much each decides.
        most: how many pixels are wanted; all, if there are no more.
    """
    height, width = counts.shape
    number = np.arange(-(-height // SIDE) * -(-width // SIDE)).reshape(-(-height // SIDE), -1)
    square = np.repeat(np.repeat(number, SIDE, 0), SIDE, 1)[:height, :width]
    pixels = square_sums(counts[None].astype(float), SIDE).reshape(-1)
    share = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        size = square_sums(np.where(counts, weight, 0.0)[None], SIDE).reshape(-1)
        size = (1 - EVEN_SHARE) * size / max(size.sum(), 1e-300) + EVEN_SHARE * pixels / pixels.sum()
        share = shares(size, pixels, most)
    # Systematic sampling: one draw decides, so that as many are chosen as are wanted.
    steps = np.floor(np.cumsum(share) + np.random.default_rng(0).uniform())
    chosen = np.diff(steps, prepend=np.floor(steps[0] - share[0])) > 0
    chosen = (chosen | (share >= 1)) & (pixels > 0)
    row, column = np.nonzero(counts & chosen[square])
    return LookedAt(row, column, square[row, column], share[square[row, column]])


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
