"""Weights of pixels: masks, and what is clipped or not finite."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..util.files import StrPath
from . import Clipped
from .pictures import is_jpeg, is_photograph, read
from .transfer import Colours

PixelMask = Bool[np.ndarray, "height width"]


def read_mask(path: StrPath) -> np.ndarray:
    """Return the weights "height width" of a file: 0 leaves a pixel out, 1 counts in full.

    Of an OpenEXR or Radiance HDR picture they are the means of its channels, 0 or more, and 0 outside of the data
    window. Of others, as an editor paints them, they are how bright and how opaque a pixel is, from 0 to 1.

    Raises:
        PictureError: the file is missing or broken, or of another format.
    """
    return np.ascontiguousarray(read(path).weights())


class ClippedPixels(NamedTuple):
    """The pixels that count nothing: one of their channels is at the largest number, or is 0."""

    saturated: PixelMask
    black: PixelMask

    @property
    def weights(self) -> Float[np.ndarray, "height width"]:
        """0 for these pixels, else 1."""
        return np.where(self.saturated | self.black, 0.0, 1.0)

    def words(self, path: StrPath) -> str:
        """How many they are, as a sentence; empty if there are none."""
        counts = {"saturated": self.saturated.sum(), "black": (self.black & ~self.saturated).sum()}
        some = " and ".join(f"{count:,} {name}" for name, count in counts.items() if count)
        rest = f"of {self.black.size:,} pixels have no weight; --clipped keep counts them."
        return f"{path}: {some} {rest}" if some else ""


def clipped_pixels(path: StrPath, picture: Colours, how: Clipped, clamps: bool) -> ClippedPixels:
    """The pixels of a picture that are at the ends of what its file can store, and so tell no light.

    A file of floats has none. A photograph has both kinds. A renderer's black is exact, and so is its white where its
    model's light ends at 1, as `clamps` says.

    Args:
        path: the file of the picture, which may be a part of it. PictureError if it is broken.
        how: `auto` does as said above; `drop`, both kinds; `keep`, none.
    """
    picture = np.asarray(picture)  # Pixels that are not stored are masked, and have no weight already.
    counts = how != "keep" and read(path).bits() > 0
    is_photo = counts and (how == "drop" or is_photograph(path))
    has_end = is_photo or (counts and not clamps)
    # A JPEG's compression leaves numbers of 0 and 255 up to 2 off, which is this much light in sRGB.
    least, most = (7e-4, 0.98) if has_end and is_jpeg(path) else (0.0, 1.0)
    saturated, black = (picture >= most).any(axis=0), (picture <= least).any(axis=0)
    return ClippedPixels(np.logical_and(saturated, has_end), np.logical_and(black, is_photo))


def bad_pixels(*images: np.ndarray) -> PixelMask:
    """The pixels that are NaN or infinite in any of some pictures, "*any height width"."""
    return np.any([~np.isfinite(image).reshape(-1, *image.shape[-2:]).all(axis=0) for image in images], axis=0)


def blackened(image: np.ndarray) -> np.ndarray:
    """A picture, "*any height width", with 0 for what is not finite, so that the rest of it is not lost."""
    return np.where(np.isfinite(image), image, np.zeros((), image.dtype))


def mask_in_words(bad: PixelMask, origin: Sequence[int] = (0, 0)) -> str:
    """How many pixels are bad, and where the first five are: `2 pixels are NaN or infinite: row 3, column 8; ...`.

    `origin` is column and row of the first pixel in the whole picture.
    """
    places = np.argwhere(bad) + np.asarray(origin)[::-1]
    named = [f"row {row}, column {column}" for row, column in places[:5]]
    named += [f"and {len(places) - 5} more"] * (len(places) > 5)
    return f"{len(places)} pixel{'s are' if len(places) > 1 else ' is'} NaN or infinite: {'; '.join(named)}"
