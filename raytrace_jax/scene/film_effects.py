"""What a camera does to a picture of light, an effect a function of the picture, of its value and of the frame.

They are differentiable in picture and value. `scene.film` has them in their order.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.images.filters import gaussian_blur, resampled

LEAST_LIGHT = 1e-3
"""Below this share of white a power goes on as its tangent, as light of 0 or less has no power."""

SUPPORT = 2.0
"""A place between pixels looks at so many pixels to each side."""

Picture = Float[Array, "3 height width"]


class Frame(NamedTuple):
    """Which part of a whole picture a picture is.

    Args:
        left, top: the first column and row, in the picture's own pixels; a crop may begin between two of them.
        binning: how many pixels of the whole picture one of its own is wide.
        width, height: of the whole picture, in pixels.
    """

    left: float
    top: float
    binning: int
    width: int
    height: int

    @property
    def half_diagonal(self) -> float:
        """From the middle of the whole picture to its corners, in pixels."""
        return math.hypot(self.width, self.height) / 2

    def from_middle(self, image: Picture) -> tuple[Float[Array, " width"], Float[Array, "height 1"]]:
        """How far each column is to the right and each row below the middle of the whole picture, in its pixels."""
        height, width = image.shape[-2:]
        column, row = (
            self.binning * (np.arange(count) + first + 0.5) - size / 2
            for count, first, size in ((width, self.left, self.width), (height, self.top, self.height))
        )
        return jnp.asarray(column, image.dtype), jnp.asarray(row[:, None], image.dtype)

    def to_corner(self, right, down):
        """The squared distance from the middle, as a share of that of a corner."""
        return (right**2 + down**2) / self.half_diagonal**2


def darken_corners(image: Picture, vignetting: Float[Array, ""], frame: Frame) -> Picture:
    """Vignetting."""
    return image * (1 - vignetting * frame.to_corner(*frame.from_middle(image)))


def distort(image: Picture, distortion: Float[Array, ""], frame: Frame) -> Picture:
    """Radial distortion, of the first order."""
    right, down = frame.from_middle(image)
    return moved(image, frame, right, down, -distortion * frame.to_corner(right, down))


def magnify(image: Picture, magnification: Float[Array, ""], frame: Frame) -> Picture:
    """Magnification around the middle."""
    return moved(image, frame, *frame.from_middle(image), 1 / magnification - 1)


def moved(image: Picture, frame: Frame, right, down, share) -> Picture:
    """The picture that sees at each place what was a share of its distance from the middle farther out."""
    height, width = image.shape[-2:]
    column = jnp.arange(width, dtype=image.dtype) + right * share / frame.binning
    row = jnp.arange(height, dtype=image.dtype)[:, None] + down * share / frame.binning
    return resampled(image, *jnp.broadcast_arrays(column, row))


def shift_picture(image: Picture, shift: Float[Array, "2"], frame: Frame) -> Picture:
    """A shift to the right and down."""
    height, width = image.shape[-2:]
    column = jnp.arange(width, dtype=image.dtype) - shift[0] / frame.binning
    row = jnp.arange(height, dtype=image.dtype)[:, None] - shift[1] / frame.binning
    return resampled(image, *jnp.broadcast_arrays(column, row))


def spread_points(image: Picture, blur: Float[Array, ""], frame: Frame) -> Picture:
    """A Gaussian point-spread function."""
    return gaussian_blur(image, blur / frame.binning)


def by_channel(value: Float[Array, "3"]) -> Float[Array, "3 1 1"]:
    """A number for each channel, as a factor of a picture."""
    return value[:, None, None]


def power(image: Picture, gamma: Float[Array, ""], frame: Frame) -> Picture:
    """The power, and its tangent where there is less light than `LEAST_LIGHT`."""
    enough = image > LEAST_LIGHT
    above = jnp.where(enough, image, 1.0) ** gamma
    start = LEAST_LIGHT**gamma
    return jnp.where(enough, above, start * (1 + gamma * (image / LEAST_LIGHT - 1)))


def multiply(image: Picture, gain: Float[Array, "3"], frame: Frame) -> Picture:
    """A gain of each channel."""
    return image * by_channel(gain)


def add(image: Picture, offset: Float[Array, "3"], frame: Frame) -> Picture:
    """An offset of each channel."""
    return image + by_channel(offset)
