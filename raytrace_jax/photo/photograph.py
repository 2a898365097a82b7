"""A photograph as it is measured, corners in it, and larger pixels: means of some of its own, in a part of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from .lens import PictureSize, Turn

Places = Float[np.ndarray, "n 2"]
"""Pixels of a photograph, or places of the board."""

Place = Float[np.ndarray, "2"]
"""One of these."""

Light = Float[np.ndarray, "height width"]
"""What a photograph shows, scene-linear, the mean of its channels."""

Image = Float[np.ndarray, "3 height width"]
"""A scene-linear picture."""

RAYS = 9
"""Rays of a pixel; the board's brightness in the pixel is the mean over all of them."""


class Photograph(NamedTuple):
    """A photograph as it is measured.

    Args:
        light: scene-linear, the mean of its channels.
        grey: 8 bits, for OpenCV.
        name: for messages.
        orientation: how EXIF says that it was turned to be upright.
    """

    light: Light
    grey: UInt8[np.ndarray, "height width"]
    name: str
    orientation: int = 1

    @property
    def size(self) -> PictureSize:
        """Width and height."""
        return self.light.shape[1], self.light.shape[0]

    @property
    def size_on_sensor(self) -> PictureSize:
        """Width and height before it was turned."""
        width, height = self.size
        return (width, height) if self.orientation < 5 else (height, width)

    def turn_to(self, other: "Photograph") -> Turn:
        """How the lens of another photograph by this camera, of the same size on the sensor, follows from this."""
        return Turn(self.size_on_sensor, self.orientation, other.orientation)


class Corners(NamedTuple):
    """Corners in a photograph.

    Args:
        pixels: where they are seen.
        places: where they lie on the board.
        spread: the standard deviation of each, of its worse direction, in pixels.
    """

    pixels: Places
    places: Places
    spread: Float[np.ndarray, " n"]

    @classmethod
    def none(cls) -> "Corners":
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    def where(self, chosen: Bool[np.ndarray, " n"]) -> "Corners":
        return Corners(self.pixels[chosen], self.places[chosen], self.spread[chosen])


def photograph_of(image: Image, name: str, orientation: int = 1) -> Photograph:
    """A scene-linear picture as it is measured: OpenCV sees it as a screen shows it, its brightest hundredth white."""
    light = np.mean(np.asarray(image, np.float64), axis=0)
    white = max(float(np.percentile(light, 99)), 1e-9)
    grey = np.round(255 * np.clip(light / white, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return Photograph(light, grey, name, orientation)


def offsets(width: float) -> Float[np.ndarray, "rays 2"]:
    """Where the rays of a pixel of this width pass, from its middle.

    They lie on a lattice, so that each is in a column and in a row of its own. On a square grid of as many rays an edge
    along the pixels is drawn to a third of a pixel only: in pictures by a level camera corners were 0.06 pixels off,
    neighbours alike.
    """
    column = np.arange(RAYS)
    return ((np.stack([column, 2 * column % RAYS], -1) + 0.5) / RAYS - 0.5) * width


class PixelGrid(NamedTuple):
    """Pixels that are means of a photograph's.

    Args:
        binning: how many of the photograph's pixels one is wide.
        left: pixels of the photograph to the left of and above the first one.
        size: of the whole picture in such pixels.
        window: which part of it is looked at: x, y, width, height.
    """

    binning: int
    left: tuple[int, int]
    size: PictureSize
    window: tuple[int, int, int, int]

    @classmethod
    def of(cls, photograph: PictureSize, binning: int) -> "PixelGrid":
        """The grid of a whole photograph of this width and height; what fills no pixel at its borders is left out."""
        size = photograph[0] // binning, photograph[1] // binning
        left = (photograph[0] - size[0] * binning) // 2, (photograph[1] - size[1] * binning) // 2
        return cls(binning, left, size, (0, 0, *size))

    def around(self, center: Place, radius: float) -> "PixelGrid":
        """The part of this grid in a square around a place of the photograph; the radius is half its side."""
        first = np.floor((center - radius - self.left) / self.binning).astype(int)
        last = np.ceil((center + radius - self.left) / self.binning).astype(int)
        first, last = np.clip(first, 0, self.size), np.clip(last, 0, self.size)
        return self._replace(window=(int(first[0]), int(first[1]), *(int(n) for n in last - first)))

    @property
    def pixels(self) -> Float[np.ndarray, "pixels 2"]:
        """The middles of this grid's pixels, in the photograph's pixels, row by row."""
        x, y, width, height = self.window
        row, column = np.mgrid[y : y + height, x : x + width]
        whole = np.stack([column, row], -1).reshape(-1, 2)
        return whole * self.binning + (self.binning - 1) / 2 + np.array(self.left)

    def parts(
        self, image: Float[np.ndarray, "channels height width"]
    ) -> Float[np.ndarray, "channels rows columns pixels"]:
        """The photograph's pixels that lie in each of this grid's pixels."""
        x, y, width, height = self.window
        top, left = self.left[1] + y * self.binning, self.left[0] + x * self.binning
        cut = image[:, top : top + height * self.binning, left : left + width * self.binning]
        blocks = cut.reshape(len(cut), height, self.binning, width, self.binning).swapaxes(2, 3)
        return blocks.reshape(len(cut), height, width, -1)
