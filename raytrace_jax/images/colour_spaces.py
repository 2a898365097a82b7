"""What the numbers of a picture file mean where it does not simply store sRGB: each channel's curve, and primaries.

Light is converted to the primaries of Rec. 709, those of sRGB. It stays the same light: white points are not adapted.
"""

import os
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from raytrace_jax.errors import PictureWarning

Chromaticities = tuple[float, ...]
"""The x and y of red, green, blue and white, eight numbers (CIE 1931)."""

REC_709: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)

NEARLY = 2e-3
"""Chromaticities and elements of matrices that differ by less are one: files round them to three or four digits."""


class ColourSpace(NamedTuple):
    """How stored numbers are read as light.

    Args:
        name: what the file calls it, for people.
        curve: from stored numbers, 0 to 1, "height width 3", to light in the file's primaries.
        to_rec_709: from that light to Rec. 709's; None where these are its primaries.
    """

    name: str
    curve: Callable[[np.ndarray], np.ndarray]
    to_rec_709: np.ndarray | None = None

    def decode(self, stored: np.ndarray) -> np.ndarray:
        """The scene-linear float64 colours of integers, or of floats, "height width 3"."""
        light = self.curve(np.asarray(stored, np.float64) / largest_number(stored))
        return light if self.to_rec_709 is None else light @ self.to_rec_709.T


def largest_number(stored: np.ndarray) -> int:
    """The stored number of full brightness: the largest of unsigned integers, 1 of floats."""
    return np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Return the scene-linear colours of sRGB-encoded ones from 0 to 1 (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def power(exponent: float) -> Callable[[np.ndarray], np.ndarray]:
    """The curve of numbers that are the light to the power of `exponent`."""
    return lambda encoded: encoded ** (1 / exponent)


def tell_primaries(path: str | os.PathLike[str], space: ColourSpace) -> None:
    """Warn that colours were converted, where they were."""
    if space.to_rec_709 is not None:
        words = f"{path}: its primaries are others ({space.name}): its light is converted to Rec. 709's, those of sRGB."
        warnings.warn(words, PictureWarning, stacklevel=4)


def rgb_to_xyz(chromaticities: Chromaticities) -> np.ndarray:
    """The matrix from light in some primaries to CIE XYZ, with Y = 1 for white (SMPTE RP 177).

    Raises:
        ValueError: they are no triangle with a white in it.
    """
    x, y = np.reshape(chromaticities, (4, 2)).T
    if not (np.isfinite(chromaticities).all() and np.all(y != 0)):
        raise ValueError(f"has chromaticities that are none: {chromaticities}")
    xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y])
    primaries, white = xyz[:, :3], xyz[:, 3]
    if abs(np.linalg.det(primaries)) < 1e-9:
        raise ValueError(f"has chromaticities that are on one line: {chromaticities}")
    return primaries * np.linalg.solve(primaries, white)


def to_rec_709(chromaticities: Chromaticities) -> np.ndarray | None:
    """The matrix "3 3" from light in some primaries to Rec. 709's; None if they are its own. Raises ValueError."""
    if np.allclose(chromaticities, REC_709, atol=NEARLY):
        return None
    return np.linalg.solve(rgb_to_xyz(REC_709), rgb_to_xyz(chromaticities))
