"""A ball before a board whose camera is known: its outline, from where the board is not seen, and a first index.

What is seen directly is known once the camera is. Where the photograph shows something else as large as a disc, there
is the ball; its outline and its radius tell how far away it is. Then the index is the one with which the board, drawn
as it is seen through such a ball, looks like the photograph.
"""

import itertools
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.boards import Board
from raytrace_jax.photo.bundle import BALL
from raytrace_jax.photo.cameras import COUNT, FOV
from raytrace_jax.photo.grids import Grid, offsets
from raytrace_jax.photo.light_field import fit_light_field
from raytrace_jax.photo.sight import Sight


class BallSearch(NamedTuple):
    """How the ball is looked for: first its outline, then its index.

    Args:
        width: about how many pixels wide the picture is in which the outline is looked for.
        differs: a pixel whose brightness is off by more than this share of paper's shows something else than the board.
        round: the least ratio of a disc's height to its width, and of its area to an ellipse's; a ball with a stand
            has less.
        least_radius: in pixels of the reduced picture; nothing is seen through a smaller disc.
        ball_width: about how many pixels wide the ball is where its index is looked for.
        most_starts: so many of the best places of the scan are refined.
        apart: starts differ by more than this in the index, so that they are not all in one valley.
        reach: photograph and drawing are compared within this share of the outline's radius.
        least_alike: the least correlation of a photograph and a drawing that show the same.
    """

    width: int = 480
    differs: float = 0.3
    round: float = 0.8
    least_radius: float = 9.0
    ball_width: int = 56
    most_starts: int = 4
    apart: float = 0.06
    reach: float = 0.85
    least_alike: float = 0.35


SEARCH = BallSearch()

INDICES = np.arange(1.2, 2.25, 0.02)
"""Indices of the scan."""

FARTHER = np.arange(-0.08, 0.081, 0.01)
"""The scan moves the ball farther away by these shares of its distance, for the outline tells it to some per cent."""

STEPS = np.array([0.02, 0.01, 0.02, 0.02])
"""The refinement's first steps: in the index, in the share of the distance, and in radii aside and upwards."""


class Disc(NamedTuple):
    """An outline in the photograph: its middle and its radius, in pixels."""

    center: Float[np.ndarray, "2"]
    radius: float


def find_ball(
    light: Float[np.ndarray, "height width"],
    board: Board,
    numbers: Float[np.ndarray, " numbers"],
    blur: float,
    name: str,
) -> Float[np.ndarray, " numbers"]:
    """The numbers with a ball: where its outline is, with the index that looks best.

    Args:
        light: the photograph, scene-linear.
        board: what it shows.
        numbers: the camera's, and the ball's radius.
        blur: standard deviation of the camera's blur in pixels.
        name: of the photograph, for messages.

    Raises:
        PictureError: there is no ball, or nothing is seen through it.
    """
    # The outline and the known radius tell where the ball is.
    size = (light.shape[1], light.shape[0])
    disc = find_disc(light, board, numbers, blur, name)
    start = np.array(numbers)
    start[BALL.start + 1 : BALL.start + 4] = center_of(numbers, size, disc)
    picture, grid = _flat_ball(light, board, numbers, disc)

    # A candidate has an index, and is moved along the line of sight and aside, which the outline tells less well.
    eye = Sight(start, size).viewpoint
    toward = start[COUNT + 1 : COUNT + 4] - eye
    radius = float(numbers[COUNT + 4])

    def with_ball(where: Float[np.ndarray, "4"]) -> Float[np.ndarray, " numbers"]:
        index, farther, aside, upwards = where
        trial = np.array(start)
        trial[COUNT] = index
        off = radius * np.array([aside, upwards, 0.0])
        trial[COUNT + 1 : COUNT + 4] = eye + (1 + farther) * toward + off
        return trial

    def unlike(where: Float[np.ndarray, "4"]) -> float:
        return -_alike(Sight(with_ball(where), size), board, picture, grid, blur)

    # Drawings look alike at several indices: the scan keeps the best places of several valleys.
    scan = [np.array([index, farther, 0, 0]) for index, farther in itertools.product(INDICES, FARTHER)]
    starts: list[np.ndarray] = []
    for _, place in sorted((unlike(where), k) for k, where in enumerate(scan)):
        if len(starts) < SEARCH.most_starts and all(abs(scan[place][0] - one[0]) > SEARCH.apart for one in starts):
            starts.append(scan[place])

    # Each valley is searched to its bottom, and the likest drawing tells the index.
    found = []
    for one in starts:
        simplex = one + np.concatenate([np.zeros((1, 4)), np.diag(STEPS)])
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": 160}
        done = optimize.minimize(unlike, one, method="Nelder-Mead", options=options)
        found.append((float(done.fun), done.x))
    least, best = min(found, key=lambda one: one[0])
    if -least < SEARCH.least_alike:
        raise PictureError(
            f"{name}: what is seen through the ball does not look like the board (correlation {-least:.2f}): put the "
            "ball so that some squares are seen through it, upright or upside down; is its radius right?"
        )
    return with_ball(best)


def find_disc(
    light: Float[np.ndarray, "height width"],
    board: Board,
    numbers: Float[np.ndarray, " numbers"],
    blur: float,
    name: str,
) -> Disc:
    """The largest disc of the photograph that does not show the board as the camera sees it directly.

    Args:
        light: the photograph, scene-linear.
        board: what it shows.
        numbers: the camera's, and the ball's radius.
        blur: standard deviation of the camera's blur in pixels.
        name: of the photograph, for messages.

    Raises:
        PictureError: there is no disc, or only a small one.
    """
    # The board as it would be seen without a ball, in the light that lies on it.
    size = (light.shape[1], light.shape[0])
    grid = Grid.of(size, max(1, round(size[0] / SEARCH.width)))
    shape = grid.size[::-1]
    seen, expected = _expected(Sight(numbers, size), board, grid, blur)
    on_board = np.isfinite(expected)
    flat = grid.parts(light[None]).mean(axis=-1).reshape(-1)
    field, _ = fit_light_field(np.repeat(flat[None, on_board], 3, 0), seen[on_board], expected[on_board], board.half)
    wanted = field.ink[0] + (1 - field.ink[0]) * np.nan_to_num(expected)
    differs = np.abs(flat / np.maximum(field.at(np.nan_to_num(seen))[0], 1e-6) - wanted)

    # Where much differs is the ball. It counts what differs in about a square, for the edges of squares differ by blur
    # alone, and in a ball only half of all pixels differ.
    off = np.where(on_board, np.minimum(differs, 1), 0).reshape(shape)
    share = ndimage.gaussian_filter((off > SEARCH.differs).astype(float), 2.0)
    opened = ndimage.binary_opening(share > 0.3, iterations=2)
    labels, count = cast("tuple[np.ndarray, int]", ndimage.label(opened))
    if not count:
        raise PictureError(
            f"{name}: there is no ball before the board: nothing of it is hidden or displaced. Stand the ball before "
            "its middle."
        )
    rows, columns = np.nonzero(labels == _ball_among(labels, count, name))
    radius = float(np.sqrt(len(rows) / np.pi))
    start = np.array([np.median(columns), np.median(rows), radius])

    # The outline of that part is ragged, so a circle is fitted: inside of it much differs, just outside little.
    row, column = np.mgrid[: shape[0], : shape[1]]
    valid = on_board.reshape(shape)

    def overlap(x):
        distance = np.hypot(column - x[0], row - x[1]) / max(abs(x[2]), 1.0)
        inside, around = (distance < 0.97) & valid, (distance > 1.03) & (distance < 1.4) & valid
        if not inside.any() or not around.any():
            return 1.0
        # The last term prefers the larger of two discs that differ as much inside: that is the ball.
        return float(share[around].mean() - share[inside].mean() - 0.05 * np.log(max(abs(x[2]), 1.0) / radius))

    simplex = start + np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 0.2 * radius]])
    found = optimize.minimize(
        overlap, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 0.05}
    ).x

    # From the reduced picture's pixels back to the photograph's.
    if abs(found[2]) < SEARCH.least_radius:
        raise PictureError(
            f"{name}: there is no ball before the board: the largest disc that does not show it is "
            f"{2 * abs(found[2]) * grid.binning:.0f} pixels wide. Stand the ball before the board's middle, and "
            "photograph from nearer."
        )
    center = found[:2] * grid.binning + (grid.binning - 1) / 2 + np.array(grid.left)
    return Disc(center, float(abs(found[2]) * grid.binning))


def _ball_among(labels: np.ndarray, count: int, name: str) -> int:
    """Which part of a picture is the ball: the one that is round, else the largest, with what it stands on."""
    areas = ndimage.sum_labels(np.ones(labels.shape), labels, np.arange(1, count + 1))
    round_ones = []
    for number, part in enumerate(ndimage.find_objects(labels), start=1):
        height, width = (one.stop - one.start for one in part)
        fills = areas[number - 1] / (np.pi / 4 * height * width)
        is_long = min(height, width) <= SEARCH.round * max(height, width)
        is_round = not is_long and SEARCH.round < fills < 1 / SEARCH.round
        if is_round and areas[number - 1] > np.pi * SEARCH.least_radius**2:
            round_ones.append(number)
    largest = 1 + int(np.argmax(areas))
    if sum(areas[number - 1] > 0.5 * areas[largest - 1] for number in round_ones) > 1:
        raise PictureError(f"{name}: there are {len(round_ones)} balls or discs before the board, and one is wanted.")
    return max(round_ones, key=lambda number: areas[number - 1]) if round_ones else largest


def _expected(sight: Sight, board: Board, grid: Grid, blur: float):
    """The place of the board that each pixel sees directly, and how bright it is in the pixel's mean, blurred."""
    seen, _ = sight.directly(grid.pixels)
    rays = offsets(grid.binning)
    mean = np.mean([board.brightness(sight.directly(grid.pixels + off)[0]) for off in rays], axis=0)
    mean = mean.reshape(grid.size[::-1])
    smooth = ndimage.gaussian_filter(np.nan_to_num(mean), blur / grid.binning)
    return seen, np.where(np.isfinite(mean), smooth, np.nan).reshape(-1)


def center_of(numbers: Float[np.ndarray, " numbers"], size: tuple[int, int], disc: Disc) -> Float[np.ndarray, "3"]:
    """Where a ball of the numbers' radius is that has this outline."""
    sight = Sight(numbers, size)
    focal = size[0] / (2 * np.tan(np.radians(numbers[FOV]) / 2))
    off = np.sum((disc.center - sight.principal_point) ** 2) / focal**2
    # Off the middle an outline is drawn out: its mean radius grows by about this.
    tangent = disc.radius / (focal * (1 + off))
    distance = numbers[BALL.start + 4] * np.sqrt(1 + 1 / tangent**2)
    return sight.viewpoint + distance * sight.toward(disc.center)


def _flat_ball(light, board: Board, numbers, disc: Disc):
    """The ball in about `SEARCH.ball_width` pixels, and their grid."""
    grid = Grid.of((light.shape[1], light.shape[0]), max(1, round(2 * disc.radius / SEARCH.ball_width)))
    grid = grid.around(disc.center, disc.radius)
    return grid.parts(light[None]).mean(axis=-1)[0], grid


def _alike(sight: Sight, board: Board, picture: Float[np.ndarray, "rows columns"], grid: Grid, blur: float) -> float:
    """Correlation of photograph and drawing, of what varies over a few pixels, within the ball."""
    ball = sight.through(grid.pixels)
    brightness = board.brightness(ball.place)
    use = (ball.valid & (ball.reach < SEARCH.reach) & np.isfinite(brightness)).reshape(picture.shape)
    if np.sum(use) < 0.3 * np.sum(ball.reach < SEARCH.reach):
        return -1.0
    smooth = max(1.0, blur / grid.binning)
    drawn = ndimage.gaussian_filter(np.where(use, np.nan_to_num(brightness).reshape(picture.shape), 0.5), smooth)
    seen = ndimage.gaussian_filter(picture, smooth)
    # Uneven light and reflections vary slowly.
    both = [one - ndimage.gaussian_filter(one, 8.0) for one in (drawn, seen)]
    a, b = (one[use] - one[use].mean() for one in both)
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-12))
