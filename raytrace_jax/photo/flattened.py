"""A photograph around its ball as a picture of a board that shines by itself: divided by the light on the board."""

from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from ..errors import PictureError
from .illumination import IlluminationMap, fit_illumination
from .locate import Located
from .photograph import Image, PixelGrid, offsets
from .sight import REACH

RIM, AROUND = 1.04, 1.12
"""In radii of the ball's outline: from where on the board is seen directly, and how far the fitted picture reaches, so
that some board tells exposure and blur."""

SATURATED = 0.995
"""A channel from here on is saturated."""

LEAST_SEEN = 400
"""The fewest pixels that tell something, of the ball and of paper alone."""


class Flattened(NamedTuple):
    """A photograph without the light of its room.

    Args:
        image: of the board around the ball, paper is about 1; 0 where nothing counts.
        counts: which pixels count.
        through: which of them see the board through the ball.
        drawn: the board as camera, ball and field have it.
        field: the light that it was divided by.
        grid: its pixels.
    """

    image: Image
    counts: Bool[np.ndarray, "height width"]
    through: Bool[np.ndarray, "height width"]
    drawn: Image
    field: IlluminationMap
    grid: PixelGrid


def flatten(image: Image, located: Located, disagrees: float = 0.12) -> Flattened:
    """Divide each pixel of a scene-linear photograph around its ball by the light on the board where the pixel looks.

    Args:
        disagrees: something lies between camera and board where picture and board differ by more than this fraction of
            paper in the mean of some pixels. Through the glass it is twice as much, for there it shows the room too.

    Raises:
        PictureError: too little of the board is seen, directly or through the ball.
    """
    # Both the photograph and the board, in the pixels of the fitted picture.
    field = find_light(image, located)
    center, radius = located.sight.outline
    binning = max(1, round(2 * radius / 144))  # The ball is about 144 pixels wide in the fitted picture.
    grid = PixelGrid.of(located.size, binning).around(center, AROUND * radius)
    parts = grid.parts(image)
    shape = parts.shape[1:3]
    seen, brightness, reach = look_at_board(located, grid)
    on_board = np.isfinite(brightness)
    direct, through = ((on_board & chosen).reshape(shape) for chosen in (reach > RIM, reach < REACH))

    # The photograph divided by the light where each pixel looks, and the board that it should then be.
    light = field.at(np.nan_to_num(seen)).reshape(3, *shape)
    divided = parts.mean(axis=-1) / np.maximum(light, 1e-6)
    drawn = (field.ink[:, None] + (1 - field.ink[:, None]) * np.nan_to_num(brightness)).reshape(3, *shape)

    # What is in between does not count, a ring or a highlight: there the mean of some pixels differs from the board's.
    off = np.where(direct | through, (divided - drawn).mean(axis=0), 0.0)
    off = np.abs(ndimage.gaussian_filter(off, 1.5))
    between = cast("np.ndarray", ndimage.binary_dilation((off > disagrees) & direct, iterations=3))
    between |= ndimage.binary_dilation((off > 2 * disagrees) & through, iterations=1)
    counts = (direct | through) & ~between & ~(parts.max(axis=(0, 3)) >= SATURATED)
    if np.sum(counts & through) < LEAST_SEEN:
        raise PictureError(
            f"only {int(np.sum(counts & through))} pixels show the board through the ball, {LEAST_SEEN} are wanted: "
            "put the ball nearer to the board's middle, or photograph from nearer."
        )
    return Flattened(np.where(counts, divided, 0.0), counts, counts & through, drawn, field, grid)


def find_light(image: Image, located: Located) -> IlluminationMap:
    """The light on the board, from what is seen of it directly in the whole photograph, scene-linear.

    Raises:
        PictureError: too few pixels show paper alone.
    """
    grid = PixelGrid.of(located.size, max(1, round(located.size[0] / 1000)))
    parts = grid.parts(image)
    seen, brightness, reach = look_at_board(located, grid)
    blurred = ndimage.gaussian_filter(np.nan_to_num(brightness).reshape(parts.shape[1:3]), located.blur / grid.binning)
    # Paper or ink alone is what shows nothing of the other, but for a fiftieth.
    alone = np.minimum(blurred, 1 - blurred).reshape(-1) < 0.02
    is_dark_enough = (parts.max(axis=(0, 3)) < SATURATED).reshape(-1)
    pure = alone & np.isfinite(brightness) & (reach > RIM) & is_dark_enough
    if np.sum(pure & (brightness > 0.5)) < LEAST_SEEN:
        raise PictureError("too few pixels show paper alone: photograph from nearer, or use larger squares.")
    light = parts.mean(axis=-1).reshape(3, -1)
    return fit_illumination(light[:, pure], seen[pure], brightness[pure], located.board.half)


def look_at_board(located: Located, grid: PixelGrid):
    """Which place of the board pixels see, how bright it is there, and how far from the ball's middle they pass.

    The brightness is the mean over a pixel. It is NaN where a part of the pixel does not see the board.
    """
    sight, pixels = located.sight, grid.pixels
    reach = sight.through(pixels).reach
    inside = reach < 1
    rays = offsets(grid.binning)
    place, total = np.zeros_like(pixels), np.zeros(len(pixels))
    for off in rays:
        here, _, sees = sight.directly(pixels + off)
        here[inside], _, sees[inside] = sight.through(pixels[inside] + off)
        total += np.where(sees, located.board.brightness(here), np.nan) / len(rays)
        place += here / len(rays)
    return place, total, reach
