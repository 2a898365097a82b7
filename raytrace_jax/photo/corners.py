"""The corners of a board's squares in a photograph: refined where they are expected, directly and through glass."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from raytrace_jax.photo.opencv import opencv

SMALLEST_SQUARE = 7.0
"""Pixels: of smaller squares, or squashed to that, nothing is left beside the blur."""

LARGEST_MOVE = 0.2
"""Of a square: a refined corner that is farther from where it was expected is another one."""

WINDOW = 0.13
"""Half the window in which a corner is refined, in squares: a marker begins at 0.15 of its square."""

GRID = 160
"""Rays a side over a ball's outline, among which the nearest to a corner is the start of the search."""

NEWTON_STEPS = 6


def refined(
    grey: UInt8[np.ndarray, "height width"], expected: Float[np.ndarray, "n 2"], sizes: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Refine corners, each in a window of its own size, and tell which were found.

    Args:
        grey: the photograph.
        expected: where they should be, in pixels.
        sizes: the shorter side of a square there, in pixels.

    Returns:
        The pixels of all, and which of them were found.

    Raises:
        RaytraceError: OpenCV is missing.
    """
    cv2 = opencv("a photograph of a board")
    height, width = grey.shape
    found = np.array(expected, np.float32)
    halves = np.clip(np.round(WINDOW * sizes), 2, 12).astype(int)
    inside = (expected > halves[:, None] + 2).all(axis=1) & (
        expected < np.array([width, height]) - halves[:, None] - 3
    ).all(axis=1)
    good = inside & (sizes >= SMALLEST_SQUARE)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    for half in np.unique(halves[good]):
        which = np.flatnonzero(good & (halves == half))
        start = np.ascontiguousarray(found[which].reshape(-1, 1, 2))
        found[which] = cv2.cornerSubPix(grey, start, (int(half), int(half)), (-1, -1), stop).reshape(-1, 2)
    moved = np.linalg.norm(found - expected, axis=1)
    return found.astype(np.float64), good & (moved < np.maximum(LARGEST_MOVE * sizes, 1.0))


def where_seen(
    see: Callable[[Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]],
    slope: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2 2"]],
    center: Float[np.ndarray, "2"],
    radius: float,
    corners: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """In which pixels places of the board are seen through a ball: by Newton's method from the nearest ray of a grid.

    Args:
        see: the place that each pixel sees, and whether it sees one that counts.
        slope: its derivative by the pixel, "place pixel".
        center, radius: of the ball's outline in the picture, about.
        corners: the places.

    Returns:
        The pixels, how large a step of one unit on the board is there at least, in pixels, and which places are seen.
    """
    axis = np.linspace(-1, 1, GRID)
    grid = center + radius * np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    place, counts = see(grid)
    pixels = np.zeros_like(corners)
    far = np.where(counts[:, None], place, 1e9)
    for k, corner in enumerate(corners):
        pixels[k] = grid[np.argmin(np.sum((far - corner) ** 2, axis=1))]
    for _ in range(NEWTON_STEPS):
        place, counts = see(pixels)
        step = np.linalg.solve(slope(pixels) + 1e-12 * np.eye(2), (corners - place)[..., None])[..., 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        pixels = pixels + step * np.minimum(1, 0.1 * radius / np.maximum(length, 1e-12))
    place, counts = see(pixels)
    slopes = slope(pixels)
    stretch = 1 / np.maximum(np.linalg.svd(slopes, compute_uv=False)[:, 0], 1e-12)
    near = np.linalg.norm(place - corners, axis=1) * stretch < 0.01
    return pixels, stretch, counts & near
