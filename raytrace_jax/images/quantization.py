"""What a stored number says of the colour that it was made from: an interval."""

import functools

import numpy as np
from jaxtyping import ArrayLike, Float

from raytrace_jax.images.colour_spaces import srgb_to_linear
from raytrace_jax.images.png import decode_course, decode_srgb

Intervals = tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]


def stored_intervals(colors: ArrayLike) -> Intervals | None:
    """Between which colours the original of every number lies, if all of them come from a picture of 8 or 16 bits.

    Three ways to store are told by the numbers themselves: the course's truncation and sRGB as `read_png` decodes
    them, and rounding to multiples of 1/255 or 1/65535. The darkest and the brightest number were clamped.

    Args:
        colors: decoded, scene-linear numbers of any shape.

    Returns:
        Lower and upper ends; infinite where the number was clamped. None if the numbers are of no such picture.
    """
    colors = np.asarray(colors, np.float64)
    for bits in (8, 16):
        for decoded, lower, upper in _ways_to_store(bits):
            # Of the two decoded numbers on either side the nearer one.
            above = np.clip(np.searchsorted(decoded, colors), 1, len(decoded) - 1)
            stored = above - (colors - decoded[above - 1] < decoded[above] - colors)
            # Numbers are equal to a share of 5e-7, for they may have gone through float32.
            if np.all(np.abs(colors - decoded[stored]) <= 5e-7 * np.abs(colors)):
                return lower[stored], upper[stored]
    return None


@functools.cache
def _ways_to_store(bits: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each way: what the stored numbers are decoded to, and the ends of what is stored as them."""
    stored, maximum = np.arange(2**bits).astype(f"u{bits // 8}"), 2**bits - 1
    steps = np.arange(1, 2**bits) / maximum
    halves = steps - 0.5 / maximum
    ways = [
        (decode_course(stored), steps),
        (np.r_[0, steps], halves),
        (decode_srgb(stored), srgb_to_linear(halves)),
    ]
    return [(decoded, np.r_[-np.inf, between], np.r_[between, np.inf]) for decoded, between in ways]


def rounding_of(colors: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """How far storing may have moved each number: half a step of the coarsest way to store that all of them fit.

    16 and 32 bits of floating point, and 8 and 16 bits as `stored_intervals` knows them; 0 where none of these fits.
    """
    colors = np.asarray(colors, np.float64)
    intervals = stored_intervals(colors)
    if intervals is not None:
        return np.maximum(intervals[1] - colors, colors - intervals[0])
    for dtype in (np.float16, np.float32):
        with np.errstate(over="ignore"):
            stored = colors.astype(dtype)
        if np.array_equal(stored.astype(np.float64), colors):
            return np.spacing(np.abs(stored)).astype(np.float64) / 2
    return np.zeros_like(colors)
