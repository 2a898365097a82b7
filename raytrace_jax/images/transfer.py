"""Light of stored numbers: by the course's transfer, by sRGB's, or by other curves and primaries that files state.

`course` truncates, without gamma. `srgb` is what screens expect: IEC 61966-2-1, rounded. Light is converted to the
primaries of Rec. 709, those of sRGB; it stays the same light, for white points are not adapted, but where a space is
stated that is defined with this.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from ..util.numerics import on_host
from . import Bits, Transfer

Chromaticities = tuple[float, ...]
"""The x and y of red, green, blue and white, eight numbers (CIE 1931)."""

Curve = Callable[[np.ndarray], np.ndarray]
"""From numbers of a file, 0 to 1, to light."""

Colours = Float[np.ndarray, "3 height width"]
"""A picture, its top row first."""

Numbers = Float[np.ndarray, "*shape"]
"""Scene-linear numbers of any picture."""

REC_709: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
XYZ: Chromaticities = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)

LINEAR_SPACES: dict[str, Chromaticities] = {
    "lin_rec709_scene": REC_709,
    "lin_p3d65_scene": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
    "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767),
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "lin_ciexyzd65_scene": XYZ,
}
"""The scene-linear spaces that the Color Interop Forum names ("Color Space Encodings for Texture Assets")."""

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""From CIE XYZ to the responses of cones, by whose ratios an eye adapts to a white (von Kries)."""

NEARLY = 2e-3
"""Chromaticities and elements of matrices that differ by less are one: files round them to three or four digits."""


def encode_course(rgb: ArrayLike, *, bits: Bits = 8) -> np.ndarray:
    """floor(maximum * clamp(C)) with the maximum 255 (uint8) or 65535 (uint16), the shape of `rgb`."""
    return np.floor((2**bits - 1) * np.clip(on_host(rgb), 0, 1)).astype(f"u{bits // 8}")


def encode_srgb(rgb: ArrayLike, *, bits: Bits = 8) -> np.ndarray:
    """The sRGB encoding (IEC 61966-2-1) of clamp(C), rounded to uint8 or uint16, the shape of `rgb`."""
    linear = np.clip(on_host(rgb), 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round((2**bits - 1) * encoded).astype(f"u{bits // 8}")


def decode_course(stored: np.ndarray) -> np.ndarray:
    """The scene-linear float64 colours that `encode_course` stored, without bias.

    A stored k covers [k, k + 1) / maximum, so its middle is the estimate: k / maximum alone is half a step too
    dark on average. The ends differ: the maximum is stored by colours clamped to exactly 1 only, and nearly
    all zeros of a picture are its background, exactly 0.
    """
    maximum = largest_number(stored)
    return np.where(stored == 0, 0.0, np.where(stored == maximum, 1.0, (stored + 0.5) / maximum))


def decode_srgb(stored: np.ndarray) -> np.ndarray:
    """The scene-linear float64 colours of sRGB-encoded integers."""
    return srgb_to_linear(stored / largest_number(stored))


ENCODERS: dict[Transfer, Callable[..., np.ndarray]] = {"course": encode_course, "srgb": encode_srgb}
DECODERS: dict[Transfer, Callable[..., np.ndarray]] = {"course": decode_course, "srgb": decode_srgb}


def largest_number(stored: np.ndarray) -> int:
    """The stored number of full brightness: the largest of unsigned integers, 1 of floats."""
    return np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """The scene-linear colours of sRGB-encoded ones from 0 to 1 (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def power_curve(exponent: float) -> Curve:
    """The curve of numbers that are the light to the power of `exponent`."""
    return lambda encoded: encoded ** (1 / exponent)


class ColourSpace(NamedTuple):
    """How the stored numbers of a file are read as light, where it is not simply by a transfer."""

    name: str  # What the file calls it.
    curve: Curve  # From numbers, 0 to 1, "height width 3", to light in its primaries.
    to_rec_709: np.ndarray | None = None  # From that light to Rec. 709's; None where these are its primaries.

    def decode(self, stored: np.ndarray) -> np.ndarray:
        """The scene-linear float64 colours of integers, or of floats, "height width 3"."""
        light = self.curve(on_host(stored) / largest_number(stored))
        return light if self.to_rec_709 is None else light @ self.to_rec_709.T


Meaning = Transfer | ColourSpace | None
"""How a file says that its numbers were made from light; None where it does not say."""


def rgb_to_xyz(chromaticities: Chromaticities) -> np.ndarray:
    """The matrix from light in some primaries to CIE XYZ, with Y = 1 for white (SMPTE RP 177).

    Raises ValueError if they are no triangle with a white in it; the text completes "FILE: ".
    """
    if len(chromaticities) != 8 or not np.isfinite(chromaticities).all() or chromaticities[7] == 0:
        raise ValueError(f"has chromaticities that are none: {chromaticities}")
    x, y = np.reshape(chromaticities, (4, 2)).T
    # A primary may have y = 0, as two of XYZ itself have: only the white has a brightness.
    xyz = np.stack([x, y, 1 - x - y])
    primaries, white = xyz[:, :3], xyz[:, 3] / y[3]
    if abs(np.linalg.det(primaries)) < 1e-9:
        raise ValueError(f"has chromaticities that are on one line: {chromaticities}")
    return primaries * np.linalg.solve(primaries, white)


def to_rec_709(chromaticities: Chromaticities) -> np.ndarray | None:
    """The matrix "3 3" from light in some primaries to Rec. 709's; None if they are its own. Raises ValueError."""
    if len(chromaticities) == 8 and np.allclose(chromaticities, REC_709, atol=NEARLY):
        return None
    return np.linalg.solve(rgb_to_xyz(REC_709), rgb_to_xyz(chromaticities))


def linear_space(name: str, chromaticities: Chromaticities, *, adapts: bool = False) -> ColourSpace | None:
    """The space of light in some primaries; None if these are Rec. 709's. Raises ValueError as `rgb_to_xyz`.

    `adapts` makes its white that of Rec. 709, as the Color Interop Forum wants it of all its spaces but XYZ.
    """
    matrix = to_rec_709(chromaticities)
    if adapts and matrix is not None and chromaticities != XYZ:
        to_cones = BRADFORD @ rgb_to_xyz(REC_709)
        cones = to_cones @ matrix
        matrix = np.linalg.solve(to_cones, cones * (to_cones.sum(axis=1) / cones.sum(axis=1))[:, None])
    return None if matrix is None else ColourSpace(name, power_curve(1.0), matrix)


def rounding_of(colors: Numbers) -> Numbers:
    """How far storing may have moved scene-linear numbers: half a step of the coarsest way to store that all fit.

    These are 8 and 16 bits as the course's truncation, as sRGB and as rounded multiples of 1/255 or 1/65535, whose
    darkest and brightest numbers may have been anything beyond; and 16 and 32 bits of floating point. 0 if none fits.
    """
    colors = on_host(colors)
    # What does not fit a thousand numbers does not fit all.
    few = colors.reshape(-1)[:: 1 + colors.size // 1000]
    for decoded, ends in (way for bits in (8, 16) for way in _ways_to_store(bits)):
        if _as_stored(decoded, few) is not None and (stored := _as_stored(decoded, colors)) is not None:
            return np.maximum(ends[stored + 1] - colors, colors - ends[stored])
    for dtype in (np.float16, np.float32):
        with np.errstate(over="ignore"):
            stored = colors.astype(dtype)
        if np.array_equal(on_host(stored), colors):
            return on_host(np.spacing(np.abs(stored))) / 2
    return np.zeros_like(colors)


def _as_stored(decoded: np.ndarray, colors: Numbers) -> Int[np.ndarray, "*shape"] | None:
    """The stored numbers that are decoded to some colours; None if not all of these are such."""
    # Of the two decoded numbers on either side the nearer one.
    above = np.clip(np.searchsorted(decoded, colors), 1, len(decoded) - 1)
    stored = above - (colors - decoded[above - 1] < decoded[above] - colors)
    # Numbers are equal to a share of 5e-7, for they may have gone through float32.
    return stored if np.all(np.abs(colors - decoded[stored]) <= 5e-7 * np.abs(colors)) else None


@functools.cache
def _ways_to_store(bits: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each way: what the stored numbers are decoded to, and the ends of what is stored as them."""
    stored, maximum = np.arange(2**bits).astype(f"u{bits // 8}"), 2**bits - 1
    steps = np.arange(1, 2**bits) / maximum
    halves = steps - 0.5 / maximum
    ways = (decode_course(stored), steps), (np.r_[0, steps], halves), (decode_srgb(stored), srgb_to_linear(halves))
    return [(decoded, np.r_[-np.inf, between, np.inf]) for decoded, between in ways]
