"""A photograph's camera, from the corners of its board that are seen directly."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.alignment import align, best_blur
from raytrace_jax.photo.boards import LEAST_CORNERS, CharucoBoard
from raytrace_jax.photo.bundle import BALL, Corners, Known, PhotoView, adjust
from raytrace_jax.photo.cameras import COUNT, FOV, LENS
from raytrace_jax.photo.lens import LensPrior
from raytrace_jax.photo.markers import Markers
from raytrace_jax.photo.opencv import opencv
from raytrace_jax.photo.sight import Sight
from raytrace_jax.photo.through_glass import RADIUS

ANGLES = (20.0, 30.0, 40.0, 55.0, 70.0)
"""Angles of view in degrees; the best one is the start where none is known."""

LARGEST_SPREAD = 0.3
"""A corner that its patch places worse than to so many pixels does not count."""

LARGEST_SCATTER = 3e-4
"""Corners may scatter by this share of the picture's width, seen directly or through the glass: half a pixel of 1600.
In the rooms of `experiments/photograph` they scatter by 0.04 pixels, from a wrong start by more than one."""


class Photograph(NamedTuple):
    """A photograph as it is measured.

    Args:
        light: scene-linear, the mean of its channels.
        grey: 8 bits, for OpenCV.
        name: for messages.
        orientation: how EXIF says that it was turned to be upright.
    """

    light: Float[np.ndarray, "height width"]
    grey: UInt8[np.ndarray, "height width"]
    name: str
    orientation: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.light.shape[1], self.light.shape[0]

    @property
    def size_on_sensor(self) -> tuple[int, int]:
        """Width and height before it was turned."""
        width, height = self.size
        return (width, height) if self.orientation < 5 else (height, width)


def photograph_of(image: Float[np.ndarray, "3 height width"], name: str, orientation: int = 1) -> Photograph:
    """A scene-linear picture as it is measured: OpenCV sees it as a screen shows it, its brightest hundredth white."""
    light = np.mean(np.asarray(image, np.float64), axis=0)
    white = max(float(np.percentile(light, 99)), 1e-9)
    grey = np.round(255 * np.clip(light / white, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return Photograph(light, grey, name, orientation)


class FoundCamera(NamedTuple):
    """A camera, from what is seen directly of a board.

    Args:
        view: its corners, and the camera's numbers; the ball's are held, for nothing is known of them.
        covariance: of the numbers.
        blur: standard deviation of the camera's blur, in pixels.
        sigma: the scatter of corners, in pixels.
    """

    view: PhotoView
    covariance: Float[np.ndarray, "numbers numbers"]
    blur: float
    sigma: float

    @property
    def lens(self) -> LensPrior:
        """The camera's lens, as this picture tells it."""
        return LensPrior(self.view.numbers[LENS], self.covariance[LENS, LENS])


def find_camera(photograph: Photograph, board: CharucoBoard, markers: Markers, lens: LensPrior) -> FoundCamera:
    """The camera from what is seen directly: from markers, from refined corners, at last from patches.

    Args:
        photograph: what was taken.
        board: what it shows.
        markers: that were decoded in it.
        lens: what is known of the camera.
    """
    # Markers are found without a start, but roughly: they choose among angles of view.
    size, direct = photograph.size, markers.direct
    seen = markers.corners[direct].reshape(-1, 2)
    corners = Corners(seen, board.markers[markers.place[direct]].reshape(-1, 2), np.full(len(seen), 0.5))
    guesses = (float(lens.mean[0]),) if np.isfinite(lens.covariance[0, 0]) else ANGLES
    starts = [_pose(corners, fov, lens, size) for fov in guesses]
    known = known_before(lens, (0.0, 0.0))

    def adjusted(numbers, corners):
        return adjust([_camera_alone(numbers, size, corners, lens)], known)

    found = [adjusted(start, corners) for start in starts]
    numbers = min(found, key=lambda one: one.cost).views[0].numbers

    # Corners that OpenCV refines are good to a tenth of a pixel: near enough for a patch to find its place.
    for _ in range(2):
        sight = Sight(numbers, size)
        expected = sight.where(board.corners)
        pixels, good = _refined(photograph.grey, expected, _square_sizes(sight, board))
        corners = Corners(pixels, board.corners, np.full(len(pixels), 0.1)).where(good)
        numbers = adjusted(numbers, corners).views[0].numbers

    # Patches, drawn with the camera's blur, measure corners to hundredths of a pixel.
    sight = Sight(numbers, size)
    expected, places = sight.where(corners.places), corners.places
    some = slice(None, None, max(1, len(places) // 40))
    blur = best_blur(photograph.light, board, places[some], expected[some], sight.directly)
    found = align(photograph.light, board, places, expected, sight.directly, blur)
    is_placed = found.good & (found.spread < LARGEST_SPREAD)
    corners = Corners(found.pixels, places, found.spread).where(is_placed)
    (done,) = adjusted(numbers, corners).views
    least, largest = LEAST_CORNERS, LARGEST_SCATTER * size[0]
    if len(corners.pixels) < least or done.sigma[0] > largest:
        raise PictureError(
            f"{photograph.name}: {len(corners.pixels)} corners of the board are seen directly, and they scatter by "
            f"{done.sigma[0]:.2g} pixels; {least} are wanted within {largest:.2g}: is {board.path} the "
            "board of this photograph, is it flat, and is the picture whole, as the camera took it?"
        )
    return FoundCamera(_camera_alone(done.numbers, size, corners, lens), done.covariance, blur, done.sigma[0])


def known_before(lens: LensPrior, radius: tuple[float, float]) -> Known:
    """What is known before of the camera's and the ball's numbers: of the lens and the radius."""
    mean, root = np.zeros(BALL.stop), np.zeros((len(lens.mean) + 1, BALL.stop))
    mean[LENS], mean[COUNT + RADIUS] = lens.mean, radius[0]
    variance = np.diagonal(lens.covariance)
    is_known = np.isfinite(variance) & (variance > 0)
    if is_known.any():
        precision = np.linalg.inv(lens.covariance[np.ix_(is_known, is_known)])
        root[np.ix_(np.arange(is_known.sum()), FOV + np.flatnonzero(is_known))] = np.linalg.cholesky(precision).T
    if radius[1] > 0:
        root[-1, COUNT + RADIUS] = 1 / radius[1]
    return Known(mean, root)


def step_scales(numbers: Float[np.ndarray, " numbers"], radius: tuple[float, float], lens: LensPrior):
    """About how far each number may move; 0 for what is known exactly."""
    distance = float(np.linalg.norm(numbers[3:6]))
    of_lens = (1.0, 0.02, 0.02, 0.01, 0.01)
    scale = np.array([*[0.02] * 3, *[0.02 * distance] * 3, *of_lens, 0.05, *[0.1 * radius[0]] * 3, radius[1]])
    scale[LENS] *= np.diagonal(lens.covariance) > 0
    return scale


def _camera_alone(numbers: Float[np.ndarray, " numbers"], size, corners: Corners, lens: LensPrior) -> PhotoView:
    """A view without a ball."""
    scale = step_scales(numbers, (0.0, 0.0), lens)
    scale[BALL] = 0
    return PhotoView(numbers, scale, size, corners, Corners.none())


def _pose(corners: Corners, fov: float, lens: LensPrior, size: tuple[int, int]) -> Float[np.ndarray, " numbers"]:
    """Numbers whose camera has this angle of view and sees the corners (OpenCV's `solvePnP`), and a ball of no size."""
    cv2 = opencv("a photograph of a board")
    focal = size[0] / (2 * np.tan(np.radians(fov) / 2))
    across, down = (np.asarray(size) - 1) / 2 + lens.mean[3:] * size[0]
    matrix = np.array([[focal, 0, across], [0, focal, down], [0, 0, 1]])
    points = np.concatenate([corners.places, np.zeros_like(corners.places[:, :1])], axis=1)
    _, turn, shift = cv2.solvePnP(points, corners.pixels, matrix, np.array([*lens.mean[1:3], 0.0, 0.0]))
    return np.concatenate([turn.ravel(), shift.ravel(), [fov, *lens.mean[1:]], [1.5, 0, 0, 0, 1]])


def _square_sizes(sight: Sight, board: CharucoBoard) -> Float[np.ndarray, " corners"]:
    """The shorter side of a square at each corner, in pixels."""
    here = sight.where(board.corners)
    steps = np.array([[board.square, 0.0], [0.0, board.square]])
    return np.minimum(*(np.linalg.norm(sight.where(board.corners + step) - here, axis=1) for step in steps))


def _refined(
    grey: UInt8[np.ndarray, "height width"], expected: Float[np.ndarray, "n 2"], sizes: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Refine corners that are expected in pixels, each in a window of its own size, and tell which were found.

    `sizes` are the shorter sides of squares there, in pixels.
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
