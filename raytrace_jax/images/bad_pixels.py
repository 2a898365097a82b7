"""Pixels that are NaN or infinite: black, so that the rest of a picture is not lost, and told by their places."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

MOST_NAMED = 5
"""A sentence names the places of so many pixels, and counts the rest."""


def bad_pixels(*images: np.ndarray) -> Bool[np.ndarray, "height width"]:
    """The pixels that are NaN or infinite in any of some pictures, "*any height width"."""
    bad = [~np.isfinite(image).reshape(-1, *image.shape[-2:]).all(axis=0) for image in images]
    return np.any(bad, axis=0)


def blackened(image: np.ndarray) -> np.ndarray:
    """A picture, "*any height width", with 0 for what is not finite."""
    return np.where(np.isfinite(image), image, np.zeros((), image.dtype))


def in_words(bad: Bool[np.ndarray, "height width"], origin: Sequence[int] = (0, 0)) -> str:
    """How many pixels are bad, and where the first ones are: `2 pixels are NaN or infinite: row 3, column 8; ...`.

    Args:
        bad: the pixels.
        origin: column and row of the first one in the whole picture.
    """
    places = np.argwhere(bad) + np.asarray(origin)[::-1]
    named = [f"row {row}, column {column}" for row, column in places[:MOST_NAMED]]
    more = [f"and {len(places) - MOST_NAMED} more"] if len(places) > MOST_NAMED else []
    return f"{len(places)} pixel{'s are' if len(places) > 1 else ' is'} NaN or infinite: {'; '.join(named + more)}"
