"""What a target may have that no scene states: a camera's response, its lens, its film, and how it was resampled."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

LEAST_LIGHT = 1e-3
"""Of colours, where their logarithm is taken."""

CORNER = 4.0
"""One over the squared distance from the center, in widths, at which an effect of a lens is counted: half a width."""


class Effect(NamedTuple):
    """An effect on a picture.

    Args:
        name: as a person would look for it.
        unit: of its amount: `%`, `px`, or empty.
        per_unit: what of its amount is one of that unit.
        advice: what to do about it.
        change: by how much the picture grows for an amount of one.
    """

    name: str
    unit: str
    per_unit: float
    advice: str
    change: Float[np.ndarray, "3 height width"]


def effects(image: Float[np.ndarray, "3 height width"], exposure_is_free: bool) -> list[Effect]:
    """The effects on a picture; not those that a fit of exposure and offset finds itself."""
    channels = [("", slice(None), "free it with --fit-exposure")]
    channels += [
        (f" of {name}", slice(k, k + 1), "balance the colours") for k, name in enumerate(("red", "green", "blue"))
    ]
    found = geometric_effects(image)
    light = np.log(np.maximum(image, LEAST_LIGHT))
    found.append(Effect("gamma", "%", 0.01, "state how the colours were stored (--transfer)", image * light))
    for words, which, advice in channels[exposure_is_free:]:
        gain, offset = np.zeros_like(image), np.zeros_like(image)
        gain[which], offset[which] = image[which], 1
        found.append(Effect(f"exposure{words}", "%", 0.01, advice, gain))
        found.append(Effect(f"offset{words}", "", 1.0, advice, offset))
    return found


def geometric_effects(image: Float[np.ndarray, "3 height width"]) -> list[Effect]:
    """Those that move or mix the light of pixels; of a picture as it is sampled, without looking between pixels."""
    _, height, width = image.shape
    row, column = np.mgrid[:height, :width]
    right, down = (column - (width - 1) / 2) / width, (row - (height - 1) / 2) / width
    squared = (right**2 + down**2) * CORNER
    per_row, per_column = (slope(image, axis) for axis in (1, 2))
    outward = per_column * right + per_row * down
    curvature = np.stack([ndimage.laplace(channel, mode="nearest") for channel in image])
    return [
        Effect("a shift to the right", "px", 1.0, "check crop and pixel mapping", -per_column),
        Effect("a shift down", "px", 1.0, "check crop and pixel mapping", -per_row),
        Effect("magnification", "%", 0.01, "check the pixel mapping", -outward * width),
        Effect("radial distortion", "%", 0.01, "undistort the picture", -outward * squared * width),
        Effect("vignetting", "%", 0.01, "correct it in the picture", image * squared),
        Effect("blur, as a variance,", "px²", 1.0, "blur as the target is", curvature / 2),
    ]


def slope(image: Float[np.ndarray, "3 height width"], axis: int) -> Float[np.ndarray, "3 height width"]:
    """The change from pixel to pixel along an axis; 0 where there is one pixel."""
    return np.asarray(np.gradient(image, axis=axis)) if image.shape[axis] > 1 else np.zeros_like(image)
