"""The corners of a board's squares in a photograph: refined where they are expected, directly and through glass."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial import KDTree

from raytrace_jax.photo.opencv import opencv


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
    # The window is 0.13 squares to each side, for a marker begins at 0.15 of its square.
    halves = np.clip(np.round(0.13 * sizes), 2, 12).astype(int)
    inside = (expected > halves[:, None] + 2).all(axis=1) & (
        expected < np.array([width, height]) - halves[:, None] - 3
    ).all(axis=1)
    # A square below 7 pixels, small or squashed, shows nothing but blur.
    good = inside & (sizes >= 7.0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    for half in np.unique(halves[good]):
        which = np.flatnonzero(good & (halves == half))
        start = np.ascontiguousarray(found[which].reshape(-1, 1, 2))
        found[which] = cv2.cornerSubPix(grey, start, (int(half), int(half)), (-1, -1), stop).reshape(-1, 2)
    # A refined corner that has moved by more than 0.2 squares is another one.
    moved = np.linalg.norm(found - expected, axis=1)
    return found.astype(np.float64), good & (moved < np.maximum(0.2 * sizes, 1.0))


def where_seen(
    see: Callable[[Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]],
    slope: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2 2"]],
    center: Float[np.ndarray, "2"],
    radius: float,
    corners: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Find the pixels in which places of the board are seen through a ball, by Newton's method from a grid of rays.

    Args:
        see: the place that each pixel sees, and whether it sees one that counts.
        slope: its derivative by the pixel, "place pixel".
        center, radius: of the ball's outline in the picture, about.
        corners: the places.

    Returns:
        The pixels, how large a step of one unit on the board is there at least, in pixels, and which places are seen.
    """
    # 160 rays a side over the outline: Newton's method starts from the one that passes nearest to the corner.
    axis = np.linspace(-1, 1, 160)
    grid = center + radius * np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    place, counts = see(grid)
    pixels = grid[KDTree(np.where(counts[:, None], place, 1e9)).query(corners)[1]]
    for _ in range(6):
        place, counts = see(pixels)
        step = np.linalg.solve(slope(pixels) + 1e-12 * np.eye(2), (corners - place)[..., None])[..., 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        pixels = pixels + step * np.minimum(1, 0.1 * radius / np.maximum(length, 1e-12))
    place, counts = see(pixels)
    slopes = slope(pixels)
    stretch = 1 / np.maximum(np.linalg.svd(slopes, compute_uv=False)[:, 0], 1e-12)
    near = np.linalg.norm(place - corners, axis=1) * stretch < 0.01
    return pixels, stretch, counts & near
