"""Pixels whose stored numbers tell no light: it was beyond what they can say."""

import os
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.images.options import Clipped
from raytrace_jax.images.pictures import is_jpeg, is_photograph, stores_integers


class ClippedPixels(NamedTuple):
    """The pixels that count nothing.

    Args:
        saturated: one of their channels is at the largest number.
        black: one of their channels is 0.
    """

    saturated: Bool[np.ndarray, "height width"]
    black: Bool[np.ndarray, "height width"]

    @property
    def weights(self) -> Float[np.ndarray, "height width"]:
        """0 for these pixels, else 1."""
        return np.where(self.saturated | self.black, 0.0, 1.0)

    def words(self, path: str | os.PathLike[str]) -> str:
        """How many they are, as a sentence; empty if there are none."""
        kinds = {"saturated": int(self.saturated.sum()), "black": int((self.black & ~self.saturated).sum())}
        some = " and ".join(f"{count:,} {name}" for name, count in kinds.items() if count)
        if not some:
            return ""
        return f"{path}: {some} of {self.black.size:,} pixels have no weight; --clipped keep counts them."


def clipped_pixels(
    path: str | os.PathLike[str], picture: Float[np.ndarray, "3 height width"], how: Clipped, clamps: bool
) -> ClippedPixels:
    """The pixels of a picture that are at the ends of what its file can store, and so tell no light.

    A file of floats has none. A photograph has both kinds. A renderer's black is exact, and so is its white where its
    model's light ends at 1.

    Args:
        path: the file.
        picture: scene-linear, as `read_picture` has read it, with any transfer, or a part of it.
        how: `auto`, which does as said above; `drop`, both kinds; `keep`, none.
        clamps: whether the model's light ends at 1.

    Raises:
        PictureError: the file is broken.
    """
    counts = how != "keep" and stores_integers(path)
    is_photo = counts and (how == "drop" or is_photograph(path))
    has_end = is_photo or (counts and not clamps)
    # A JPEG's compression leaves numbers of 0 and 255 up to 2 off, which is this much light in sRGB.
    least, most = (7e-4, 0.98) if has_end and is_jpeg(path) else (0.0, 1.0)
    saturated, black = (picture >= most).any(axis=0), (picture <= least).any(axis=0)
    return ClippedPixels(np.logical_and(saturated, has_end), np.logical_and(black, is_photo))
