"""How far storing may have moved the colours of a picture, told by the stored numbers themselves."""

import functools

import numpy as np
from jaxtyping import Float

from raytrace_jax.images.colour_spaces import srgb_to_linear
from raytrace_jax.images.png import decode_course, decode_srgb


@functools.cache
def _ways_to_store(bits: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each way: what the stored numbers are decoded to, and the ends of what is stored as them."""
    stored, maximum = np.arange(2**bits).astype(f"u{bits // 8}"), 2**bits - 1
    steps = np.arange(1, 2**bits) / maximum
    halves = steps - 0.5 / maximum
    ways = [
        (decode_course(stored), steps),
        (np.r_[0, steps], halves),
        (decode_srgb(stored), srgb_to_linear(halves)),
    ]
    return [(decoded, np.r_[-np.inf, between, np.inf]) for decoded, between in ways]


def rounding_of(colors: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """How far storing may have moved each number: half a step of the coarsest way to store that all of them fit.

    These are 8 and 16 bits as the course's truncation, as sRGB and as rounded multiples of 1/255 or 1/65535, whose
    darkest and brightest numbers may have been anything beyond; and 16 and 32 bits of floating point. It is 0 where
    none of these fits.

    Args:
        colors: decoded, scene-linear numbers.
    """
    colors = np.asarray(colors, np.float64)
    for decoded, ends in (way for bits in (8, 16) for way in _ways_to_store(bits)):
        # Of the two decoded numbers on either side the nearer one.
        above = np.clip(np.searchsorted(decoded, colors), 1, len(decoded) - 1)
        stored = above - (colors - decoded[above - 1] < decoded[above] - colors)
        # Numbers are equal to a share of 5e-7, for they may have gone through float32.
        if np.all(np.abs(colors - decoded[stored]) <= 5e-7 * np.abs(colors)):
            return np.maximum(ends[stored + 1] - colors, colors - ends[stored])
    for dtype in (np.float16, np.float32):
        with np.errstate(over="ignore"):
            stored = colors.astype(dtype)
        if np.array_equal(stored.astype(np.float64), colors):
            return np.spacing(np.abs(stored)).astype(np.float64) / 2
    return np.zeros_like(colors)
