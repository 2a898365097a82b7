"""Where the board's corners are seen, to hundredths of a pixel: patches of the photograph beside patches of the board.

Around each corner the board is drawn as the present estimate has it, bent as the glass bends it, and shifted until it
lies on the photograph (Lucas and Kanade, "An iterative image registration technique", 1981). Brightness and contrast
are each patch's own, and so are their slopes, so that neither uneven light nor a veil nor Fresnel's losses towards a
ball's rim move anything: a slope of the contrast looks like a shift.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, minimum_filter
from scipy.ndimage import shift as moved_by

from ..images.jpeg import JpegStorage
from .boards import CharucoBoard
from .geometry import Seen
from .photograph import RAYS, Corners, Image, Light, Places, offsets

HALF, MARGIN = 13, 6
"""Half a patch's side, and how far beyond it its blur looks, in pixels."""

See = Callable[[Places], Seen]
"""The place of the board that each pixel sees, and whether it sees one."""


def align(
    light: Light,
    board: CharucoBoard,
    corners: Places,
    expected: Places,
    see: See,
    blur: float,
    rounds: int = 2,
) -> Corners:
    """Shift each patch of the board until it lies on the photograph.

    Args:
        light: the photograph, scene-linear.
        corners, expected: places of the board, and the pixels in which `see` has them.
        see: where pixels look at present.
        blur: standard deviation of the camera's blur in pixels.
        rounds: how often patches are shifted and drawn anew.

    Returns:
        The corners that count, where their patches came to lie, with the scatter that the patches' residuals tell.
    """
    box, pictures, fits = _boxes(light, expected)
    shift, spread, contrast = np.zeros_like(expected), np.full(len(expected), np.inf), np.zeros(len(expected))
    if not fits.any():
        return Corners.none()
    where = np.flatnonzero(fits)
    for _ in range(rounds):
        sharp, counts = _drawn(box - shift[where][:, None, None], board, corners[where], see)
        for k, (picture, drawn, use) in enumerate(zip(pictures, _blurred(sharp, blur), counts, strict=True)):
            if fit := _shift(picture, drawn, use):
                step, spread[where[k]], contrast[where[k]] = fit
                shift[where[k]] += np.clip(step, -2, 2)
    # Dark glass or a highlight has less contrast than the median patch; 0.3 pixels are too many to place a corner by.
    usual = np.median(contrast[contrast > 0]) if (contrast > 0).any() else np.inf
    good = (spread < 0.3) & (contrast > 0.15 * usual) & (np.max(np.abs(shift), axis=1) < HALF / 2)
    return Corners(expected + shift, corners, spread).where(good)


class ColourPatches:
    """Patches of a photograph's channels around corners, beside those of the board as it is seen there.

    Args:
        image: scene-linear.
        see: where pixels look.
        blur: standard deviation of the camera's blur in pixels.
    """

    def __init__(self, image: Image, board: CharucoBoard, corners: Corners, see: See, blur: float):
        box, _, self.fits = _boxes(image[0], corners.pixels)
        self.first, self.pictures = box[:, 0, 0], image[:, box[..., 1], box[..., 0]]
        sharp, self.use = _drawn(box, board, corners.places[self.fits], see)
        self.drawn = _blurred(sharp, blur)

    def steps(
        self,
        applied: Float[np.ndarray, "3 patches 2"] | None = None,
        storage: JpegStorage | None = None,
        share: Float[np.ndarray, "3"] | None = None,
    ) -> tuple[Float[np.ndarray, "3 patches 2"], Float[np.ndarray, "3 patches"]]:
        """Where each channel shows the corners, from where the board has them, and its contrast; NaN without one.

        Args:
            applied: in place of the channels the mean of all counts, moved so far in each.
            storage: how these were compressed.
            share: of each channel in the sum of their contrasts.
        """
        steps, contrast = np.full((3, len(self.use), 2), np.nan), np.full((3, len(self.use)), np.nan)
        for k, (use, drawn) in enumerate(zip(self.use, self.drawn, strict=True)):
            pictures = self.pictures[:, k]
            if applied is not None and storage is not None and share is not None:
                mean = pictures.mean(axis=0)
                moved = [moved_by(mean, by[::-1], order=3, mode="nearest") for by in applied[:, k]]
                window = (*self.first[k].tolist(), *drawn.shape[::-1])
                numbers = storage.encode(3 * share[:, None, None] * np.array(moved))
                pictures = storage._replace(window=window).compress(numbers)
            for channel, picture in enumerate(pictures):
                # Channels of a dispersive ball may lie pixels apart, and a step is right to a tenth of its length.
                moved, total = drawn, np.zeros(2)
                for _ in range(4):
                    if (fit := _shift(picture, moved, use)) is None:
                        total = np.full(2, np.nan)
                        break
                    total = total + np.clip(fit[0], -2, 2)
                    contrast[channel, k] = fit[2]
                    if np.max(np.abs(fit[0])) < 0.05:
                        break
                    moved = moved_by(drawn, total[::-1], order=3, mode="nearest")
                steps[channel, k] = total
        return steps, contrast


def best_blur(
    light: Light,
    board: CharucoBoard,
    corners: Places,
    expected: Places,
    see: See,
) -> float:
    """The camera's blur with which patches lie on the photograph best, in pixels; arguments are those of `align`."""
    box, pictures, fits = _boxes(light, expected)
    if not fits.any():
        return 1.0
    sharp, counts = _drawn(box, board, corners[fits], see)

    def misfit(blur: float) -> float:
        rows = zip(pictures, _blurred(sharp, blur), counts, strict=True)
        spreads = [fit[1] for row in rows if (fit := _shift(*row))]
        return float(np.median(spreads)) if spreads else np.inf

    return min((0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0, 2.6), key=misfit)


def _boxes(light, expected):
    """Patches around places, with a margin: their pixels, "patch row column 2", and light; which places have room."""
    height, width = light.shape
    reach = HALF + MARGIN
    axis = np.arange(-reach, reach + 1)
    start = np.round(expected).astype(int)
    fits = ((start >= reach) & (start < np.array([width, height]) - reach)).all(axis=1)
    box = start[fits][:, None, None] + np.stack(np.meshgrid(axis, axis), -1)
    return box, light[box[..., 1], box[..., 0]], fits


def _blurred(patches, blur: float):
    """Patches as the camera blurs them."""
    return gaussian_filter(patches, blur, axes=(1, 2), mode="nearest", truncate=3.0)


def _drawn(pixels, board: CharucoBoard, corners, see: See):
    """The board's brightness in patches of pixels, and which of them show what is near their corner."""
    seen = see(pixels.reshape(-1, 2).astype(float))
    valid = seen.valid.reshape(pixels.shape[:-1])
    valid = np.asarray(minimum_filter(valid, (1, 5, 5), mode="constant"), bool)

    # Coordinates come first, for NumPy is slow where the last axis is short.
    place = np.ascontiguousarray(seen.place.T).reshape(2, *valid.shape)
    # Beside a pixel's middle the place follows from Taylor's series, whose derivatives are differences of neighbours.
    down, right = np.gradient(place, axis=(2, 3))
    (down_down, down_right), right_right = np.gradient(down, axis=(2, 3)), np.gradient(right, axis=3)

    # Rays lie a little aside in each row and column, or an edge along the pixels would be drawn to a ninth of one. The
    # fractional parts of multiples of the golden ratio are spread evenly, however many they are.
    total, count, near = np.zeros(valid.shape), np.zeros(valid.shape), valid
    aside = (np.moveaxis(np.indices(pixels.shape[1:3]), 0, -1) * 0.6180339887 % 1 - 0.5) / RAYS
    for off in offsets(1.0):
        x, y = np.moveaxis(off + aside, -1, 0)
        here = place + x * (right + x / 2 * right_right + y * down_right) + y * (down + y / 2 * down_down)
        brightness = board.brightness(np.moveaxis(here, 0, -1))
        known = valid & np.isfinite(brightness)
        total += np.where(known, brightness, 0.0)
        count += known
        # What is farther away than this share of a square belongs to the next corner.
        near = near & known & np.all(np.abs(here - corners.T[..., None, None]) < 0.45 * board.square, axis=0)
    inner = np.zeros_like(near)
    inner[:, MARGIN:-MARGIN, MARGIN:-MARGIN] = True
    return total / np.maximum(count, 1), near & inner


def _shift(picture, drawn, use) -> tuple[Float[np.ndarray, "2"], float, float] | None:
    """The step by which a drawn patch has to move, its standard deviation, and the patch's contrast."""
    if np.sum(use) < 40:
        return None
    down, right = np.gradient(drawn)
    row, column = (place[use] / HALF - 1 for place in np.indices(drawn.shape))
    b = drawn[use]
    columns = np.stack([np.ones_like(b), b, right[use], down[use], column, row, column * b, row * b], axis=1)
    normal = columns.T @ columns
    if np.linalg.cond(normal) > 1e9:
        return None
    values = picture[use]
    found = np.linalg.solve(normal, columns.T @ values)
    contrast = found[1]
    if contrast <= 0:
        return None
    rest = values - columns @ found
    variance = rest @ rest / max(len(values) - len(found), 1) * np.linalg.inv(normal)[2:4, 2:4] / contrast**2
    # What a patch does not explain is alike in neighbouring pixels, so that corners scatter by about twice the spread
    # that independent pixels would tell: 1.5 to 2.2 times in rooms by POV-Ray, in the middle of a ball as at its rim.
    return -found[2:4] / contrast, 2.0 * float(np.sqrt(np.max(np.diagonal(variance)))), float(contrast)
