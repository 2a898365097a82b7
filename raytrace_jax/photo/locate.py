"""From a photograph of a board behind a ball of glass to its camera, the ball's place and a first index."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.alignment import align, best_blur
from raytrace_jax.photo.boards import Board
from raytrace_jax.photo.bundle import BALL, Adjusted, Corners, Known, adjust
from raytrace_jax.photo.cameras import COUNT, FOV, K1
from raytrace_jax.photo.corners import refined, where_seen
from raytrace_jax.photo.find_ball import find_ball
from raytrace_jax.photo.markers import Markers, find_markers
from raytrace_jax.photo.opencv import opencv
from raytrace_jax.photo.sight import Sight
from raytrace_jax.photo.through_glass import RADIUS

GUESSES = (20.0, 30.0, 40.0, 55.0, 70.0)
"""Angles of view in degrees, of which the best is the start where nothing is known."""

USUAL_K1, USUAL_K2 = 0.1, 0.05
"""Standard deviations of a lens's distortion that was not calibrated: cameras correct their pictures, or nearly."""

ROUNDS = 4
"""Of corners through the glass: the first start may be off by some pixels."""

REACH = 0.94
"""Of the outline: nearer to the rim nothing is measured through the glass, it is squashed and shows the room."""

LEAST_SQUARE = 4.0
"""Pixels of a square through the glass in its shorter direction: of less a patch shows a blur."""

LARGEST_SPREAD = 0.3
"""Pixels: a corner that its patch places no better is none."""

LARGEST_SCATTER = 0.5
"""Pixels of corners, seen directly or through the glass: in the rooms of `experiments/photograph` they scatter by 0.04,
from a wrong start by more than one."""

MORE_SCATTER, LEAST_SCATTER = 3.0, 0.15
"""Of the corners' that are seen directly, and in pixels: where it is more, something is not as it was taken to be. In a
photograph that was cut, whose middle is not where the lens looked, it is 3.5 times as much and 0.45."""

LEAST_DIRECT = 20
"""Corners seen directly: a camera has up to nine numbers."""

LEAST_THROUGH = 8
"""Corners seen through the glass: they have four numbers to tell, and err."""

DIRECT_CORNERS = 40
"""Among which the camera's blur is found."""


class Lens(NamedTuple):
    """What is known of a camera's lens before.

    Args:
        mean: its angle of view in degrees, and k1 and k2 as `scene.distortion` has them.
        covariance: of these three; infinite where nothing is known.
    """

    mean: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]


def uncalibrated(fov: float | None = None, spread: float = 0.0) -> Lens:
    """A lens of which at most the angle of view is known, in degrees, with its standard deviation."""
    variance = spread**2 if fov else np.inf
    return Lens(np.array([fov or 0.0, 0, 0]), np.diag([variance, USUAL_K1**2, USUAL_K2**2]))


class Located(NamedTuple):
    """What the corners in a photograph say.

    Args:
        board: what it shows.
        size: width and height of the photograph.
        numbers: of the camera and the ball, in the board's frame, as `photo.bundle` has them.
        covariance: of them all.
        sigma: standard deviations of corners that are seen directly, and through the glass, in pixels.
        direct, through: the corners that count.
        markers: that were decoded.
        blur: standard deviation of the camera's blur, in pixels.
    """

    board: Board
    size: tuple[int, int]
    numbers: Float[np.ndarray, " numbers"]
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    direct: Corners
    through: Corners
    markers: Markers
    blur: float

    @property
    def sight(self) -> Sight:
        """What the photograph's pixels see."""
        return Sight(self.numbers, self.size)

    @property
    def index(self) -> tuple[float, float]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The ball's index over the air's, and its standard deviation."""
        return float(self.numbers[COUNT]), float(np.sqrt(self.covariance[COUNT, COUNT]))


class Photograph(NamedTuple):
    """A photograph as it is measured.

    Args:
        light: scene-linear, the mean of its channels.
        grey: 8 bits, for OpenCV.
        name: for messages.
    """

    light: Float[np.ndarray, "height width"]
    grey: UInt8[np.ndarray, "height width"]
    name: str

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.light.shape[1], self.light.shape[0]


def photograph_of(image: Float[np.ndarray, "3 height width"], name: str) -> Photograph:
    """A scene-linear picture as it is measured: OpenCV sees it as a screen shows it, its brightest hundredth white."""
    light = np.mean(np.asarray(image, np.float64), axis=0)
    white = max(float(np.percentile(light, 99)), 1e-9)
    grey = np.round(255 * np.clip(light / white, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return Photograph(light, grey, name)


def locate(photograph: Photograph, board: Board, radius: tuple[float, float], lens: Lens) -> Located:
    """Find camera and ball from the board's corners, seen directly and through the glass.

    Args:
        photograph: what was taken.
        board: what it shows.
        radius: of the ball, and its standard deviation, in the board's unit.
        lens: what is known of the camera.

    Returns:
        Camera, ball and their joint covariance, all from one adjustment.

    Raises:
        PictureError: too few markers or corners are found; the message says what to do.
    """
    markers = find_markers(photograph.grey, board, photograph.name)
    seen = find_camera(photograph, board, markers, lens)
    numbers, direct, blur = np.array(seen.numbers), seen.corners, seen.blur
    numbers[COUNT + RADIUS] = radius[0]

    # The ball: where the board is hidden; then all corners that are seen through it, expected better each time.
    numbers = find_ball(photograph.light, board, numbers, blur, photograph.name)
    known, scale = known_before(lens, radius), scale_of(numbers, radius, lens)
    through, found = Corners.none(), None
    for number in range(ROUNDS):
        rounds = 2 if number == ROUNDS - 1 else 1
        through = _corners_through(photograph, board, Sight(numbers, photograph.size), blur, rounds)
        if len(through.pixels) < LEAST_THROUGH:
            raise PictureError(
                f"{photograph.name}: {len(through.pixels)} corners of the board are found through the ball, and "
                f"{LEAST_THROUGH} are wanted: photograph from nearer, use smaller squares, or put the ball nearer to "
                "the board."
            )
        found = adjust(numbers, photograph.size, direct, through, scale, known)
        numbers = found.numbers
    assert found is not None
    center, reach = Sight(numbers, photograph.size).outline
    if np.any(center - reach < 0) or np.any(center + reach > np.array(photograph.size)):
        raise PictureError(
            f"{photograph.name}: the ball reaches beyond the picture's border, at column {center[0]:.0f}, row "
            f"{center[1]:.0f} with a radius of {reach:.0f} pixels: photograph all of it."
        )
    if found.sigma[1] > min(LARGEST_SCATTER, max(MORE_SCATTER * found.sigma[0], LEAST_SCATTER)):
        raise PictureError(
            f"{photograph.name}: the corners that are seen through the ball scatter by {found.sigma[1]:.2g} pixels, "
            f"and those beside it by {found.sigma[0]:.2g}: they are not what they are taken for. Put the ball so that "
            "more squares are seen through it, photograph from nearer, and see that its radius is right and the "
            "picture whole, as the camera took it."
        )
    direct, through = direct.where(found.used[0]), through.where(found.used[1])
    return Located(board, photograph.size, numbers, found.covariance, found.sigma, direct, through, markers, blur)


class FoundCamera(NamedTuple):
    """A camera, from what is seen directly of a board.

    Args:
        numbers: the camera's, and a ball's of which nothing is known.
        covariance: of the camera's.
        corners: that are seen directly.
        blur: standard deviation of the camera's blur, in pixels.
        sigma: the scatter of corners, in pixels.
    """

    numbers: Float[np.ndarray, " numbers"]
    covariance: Float[np.ndarray, "numbers numbers"]
    corners: Corners
    blur: float
    sigma: float

    @property
    def lens(self) -> Float[np.ndarray, "3"]:
        """Its angle of view, k1 and k2."""
        return self.numbers[FOV:COUNT]

    @property
    def lens_covariance(self) -> Float[np.ndarray, "3 3"]:
        """The covariance of these three."""
        return self.covariance[FOV:COUNT, FOV:COUNT]


def find_camera(photograph: Photograph, board: Board, markers: Markers, lens: Lens) -> FoundCamera:
    """The camera from what is seen directly: from markers, from refined corners, at last from patches.

    Args:
        photograph: what was taken.
        board: what it shows.
        markers: that were decoded in it.
        lens: what is known of the camera.
    """
    size, direct = photograph.size, markers.direct
    seen = markers.corners[direct].reshape(-1, 2)
    corners = Corners(seen, board.markers[markers.place[direct]].reshape(-1, 2), np.full(len(seen), 0.5))
    guesses = (float(lens.mean[0]),) if np.isfinite(lens.covariance[0, 0]) else GUESSES
    starts = [_pose(corners, fov, lens, size) for fov in guesses]
    found = [_adjusted_camera(start, size, corners, lens) for start in starts]
    numbers = min(found, key=lambda one: one.cost).numbers
    for _ in range(2):
        sight = Sight(numbers, size)
        expected = sight.where(board.corners)
        pixels, good = refined(photograph.grey, expected, _square_sizes(sight, board))
        corners = Corners(pixels, board.corners, np.full(len(pixels), 0.1)).where(good)
        numbers = _adjusted_camera(numbers, size, corners, lens).numbers

    sight = Sight(numbers, size)
    expected, places = sight.where(corners.places), corners.places
    some = slice(None, None, max(1, len(places) // DIRECT_CORNERS))
    blur = best_blur(photograph.light, board, places[some], expected[some], sight.directly)
    found = align(photograph.light, board, places, expected, sight.directly, blur)
    corners = Corners(found.pixels, places, found.spread).where(found.good & (found.spread < LARGEST_SPREAD))
    done = _adjusted_camera(numbers, size, corners, lens)
    if len(corners.pixels) < LEAST_DIRECT or done.sigma[0] > LARGEST_SCATTER:
        raise PictureError(
            f"{photograph.name}: {len(corners.pixels)} corners of the board are seen directly, and they scatter by "
            f"{done.sigma[0]:.2g} pixels; {LEAST_DIRECT} are wanted within {LARGEST_SCATTER:g}: is {board.path} the "
            "board of this photograph, is it flat, and is the picture whole, as the camera took it?"
        )
    return FoundCamera(done.numbers, done.covariance, corners, blur, done.sigma[0])


def known_before(lens: Lens, radius: tuple[float, float]) -> Known:
    """What is known before of the camera's and the ball's numbers: of the lens and the radius."""
    mean, root = np.zeros(BALL.stop), np.zeros((4, BALL.stop))
    mean[FOV : K1 + 2], mean[COUNT + RADIUS] = lens.mean, radius[0]
    variance = np.diagonal(lens.covariance)
    is_known = np.isfinite(variance) & (variance > 0)
    if is_known.any():
        precision = np.linalg.inv(lens.covariance[np.ix_(is_known, is_known)])
        root[np.ix_(np.arange(is_known.sum()), FOV + np.flatnonzero(is_known))] = np.linalg.cholesky(precision).T
    if radius[1] > 0:
        root[3, COUNT + RADIUS] = 1 / radius[1]
    return Known(mean, root)


def scale_of(numbers: Float[np.ndarray, " numbers"], radius: tuple[float, float], lens: Lens):
    """About how far each number may move; what is known exactly does not."""
    distance = float(np.linalg.norm(numbers[3:6]))
    scale = np.array([*[0.02] * 3, *[0.02 * distance] * 3, 1.0, 0.02, 0.02, 0.05, *[0.1 * radius[0]] * 3, radius[1]])
    scale[FOV : K1 + 2] *= np.diagonal(lens.covariance) > 0
    return scale


def _adjusted_camera(numbers: Float[np.ndarray, " numbers"], size, corners: Corners, lens: Lens) -> Adjusted:
    scale = scale_of(numbers, (0.0, 0.0), lens)
    scale[BALL] = 0
    return adjust(numbers, size, corners, Corners.none(), scale, known_before(lens, (0.0, 0.0)))


def _pose(corners: Corners, fov: float, lens: Lens, size: tuple[int, int]) -> Float[np.ndarray, " numbers"]:
    """Numbers whose camera has this angle of view and sees the corners (OpenCV's `solvePnP`), and a ball of no size."""
    cv2 = opencv("a photograph of a board")
    focal = size[0] / (2 * np.tan(np.radians(fov) / 2))
    matrix = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    points = np.concatenate([corners.places, np.zeros_like(corners.places[:, :1])], axis=1)
    _, turn, shift = cv2.solvePnP(points, corners.pixels, matrix, np.array([*lens.mean[1:], 0.0, 0.0]))
    return np.concatenate([turn.ravel(), shift.ravel(), [fov, *lens.mean[1:]], [1.5, 0, 0, 0, 1]])


def _corners_through(photograph: Photograph, board: Board, sight: Sight, blur: float, rounds: int) -> Corners:
    """The corners that are seen through the ball, by patches."""

    def see(pixels):
        seen = sight.through(pixels)
        inside = np.all(np.abs(seen.place) < board.half, axis=1)
        return seen.place, seen.valid & (seen.reach < REACH) & inside

    def see_all(pixels):
        seen = sight.through(pixels)
        return seen.place, seen.valid

    center, radius = sight.outline
    expected, stretch, visible = where_seen(see, sight.slopes, center, radius, board.places)
    chosen = visible & (stretch * board.square > LEAST_SQUARE)
    found = align(photograph.light, board, board.places[chosen], expected[chosen], see_all, blur, rounds)
    corners = Corners(found.pixels, board.places[chosen], found.spread)
    return corners.where(found.good & (found.spread < LARGEST_SPREAD))


def _square_sizes(sight: Sight, board: Board) -> Float[np.ndarray, " corners"]:
    """The shorter side of a square at each corner, in pixels."""
    here = sight.where(board.corners)
    steps = np.array([[board.square, 0.0], [0.0, board.square]])
    return np.minimum(*(np.linalg.norm(sight.where(board.corners + step) - here, axis=1) for step in steps))
