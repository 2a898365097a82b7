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

WIDTH = 480
"""About how many pixels wide the picture is in which the ball is looked for."""

DIFFERS = 0.3
"""Of paper: a pixel that is off by more shows something else than the board."""

ROUND = 0.8
"""Of its width the height of a disc, and of an ellipse its area, at least; a ball with a stand has less."""

LEAST_RADIUS = 9.0
"""Pixels of that picture: a smaller disc is no ball that anything is seen through."""

BALL_WIDTH = 56
"""About how many pixels wide the ball is where its index is looked for."""

INDICES, FARTHER = np.arange(1.2, 2.25, 0.02), np.arange(-0.08, 0.081, 0.01)
"""What is tried: indices, and shares by which the ball may be farther away than its outline tells, for the outline is
found to some per cent."""

MOST_STARTS, APART = 4, 0.06
"""From how many of these a place is looked for at which photograph and drawing are most alike, and by how much their
indices differ."""

STEPS = np.array([0.02, 0.01, 0.02, 0.02])
"""First steps of that: of the index, of the share, and aside and upwards in radii."""

REACH = 0.85
"""Of the outline, within which photograph and drawing are compared."""

LEAST_ALIKE = 0.35
"""Correlation of photograph and drawing: of less they do not show the same."""


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
    size = (light.shape[1], light.shape[0])
    disc = find_disc(light, board, numbers, blur, name)
    start = np.array(numbers)
    start[BALL.start + 1 : BALL.start + 4] = center_of(numbers, size, disc)
    picture, grid = _flat_ball(light, board, numbers, disc)
    eye = Sight(start, size).viewpoint

    toward = start[COUNT + 1 : COUNT + 4] - eye

    def with_ball(where: Float[np.ndarray, "4"]) -> Float[np.ndarray, " numbers"]:
        index, farther, aside, upwards = where
        trial = np.array(start)
        trial[COUNT] = index
        off = radius * np.array([aside, upwards, 0.0])
        trial[COUNT + 1 : COUNT + 4] = eye + (1 + farther) * toward + off
        return trial

    def unlike(where: Float[np.ndarray, "4"]) -> float:
        return -_alike(Sight(with_ball(where), size), board, picture, grid, blur)

    radius = float(numbers[COUNT + 4])
    scan = [np.array([index, farther, 0, 0]) for index, farther in itertools.product(INDICES, FARTHER)]
    starts: list[np.ndarray] = []
    for _, place in sorted((unlike(where), k) for k, where in enumerate(scan)):
        if len(starts) < MOST_STARTS and all(abs(scan[place][0] - one[0]) > APART for one in starts):
            starts.append(scan[place])
    found = []
    for one in starts:
        simplex = one + np.concatenate([np.zeros((1, 4)), np.diag(STEPS)])
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": 160}
        done = optimize.minimize(unlike, one, method="Nelder-Mead", options=options)
        found.append((float(done.fun), done.x))
    least, best = min(found, key=lambda one: one[0])
    if -least < LEAST_ALIKE:
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
    size = (light.shape[1], light.shape[0])
    grid = Grid.of(size, max(1, round(size[0] / WIDTH)))
    shape = grid.size[::-1]
    seen, expected = _expected(Sight(numbers, size), board, grid, blur)
    on_board = np.isfinite(expected)
    flat = grid.parts(light[None]).mean(axis=-1).reshape(-1)
    field, _ = fit_light_field(np.repeat(flat[None, on_board], 3, 0), seen[on_board], expected[on_board], board.half)
    wanted = field.ink[0] + (1 - field.ink[0]) * np.nan_to_num(expected)
    differs = np.abs(flat / np.maximum(field.at(np.nan_to_num(seen))[0], 1e-6) - wanted)
    # A mean over about a square: the edges of squares differ by blur alone, and in a ball half of all pixels differ.
    off = np.where(on_board, np.minimum(differs, 1), 0).reshape(shape)
    share = ndimage.gaussian_filter((off > DIFFERS).astype(float), 2.0)
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

    # The outline: inside of it much differs, just outside little.
    row, column = np.mgrid[: shape[0], : shape[1]]
    valid = on_board.reshape(shape)

    def overlap(x):
        distance = np.hypot(column - x[0], row - x[1]) / max(abs(x[2]), 1.0)
        inside, around = (distance < 0.97) & valid, (distance > 1.03) & (distance < 1.4) & valid
        if not inside.any() or not around.any():
            return 1.0
        # Of two discs that differ as much inside the larger one is the ball.
        return float(share[around].mean() - share[inside].mean() - 0.05 * np.log(max(abs(x[2]), 1.0) / radius))

    simplex = start + np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 0.2 * radius]])
    found = optimize.minimize(
        overlap, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 0.05}
    ).x
    if abs(found[2]) < LEAST_RADIUS:
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
        is_round = min(height, width) > ROUND * max(height, width) and ROUND < fills < 1 / ROUND
        if is_round and areas[number - 1] > np.pi * LEAST_RADIUS**2:
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
    """The ball in about `BALL_WIDTH` pixels."""
    grid = Grid.of((light.shape[1], light.shape[0]), max(1, round(2 * disc.radius / BALL_WIDTH)))
    grid = grid.around(disc.center, disc.radius)
    return grid.parts(light[None]).mean(axis=-1)[0], grid


def _alike(sight: Sight, board: Board, picture: Float[np.ndarray, "rows columns"], grid: Grid, blur: float) -> float:
    """Correlation of photograph and drawing, of what varies over a few pixels, within the ball."""
    ball = sight.through(grid.pixels)
    brightness = board.brightness(ball.place)
    use = (ball.valid & (ball.reach < REACH) & np.isfinite(brightness)).reshape(picture.shape)
    if np.sum(use) < 0.3 * np.sum(ball.reach < REACH):
        return -1.0
    smooth = max(1.0, blur / grid.binning)
    drawn = ndimage.gaussian_filter(np.where(use, np.nan_to_num(brightness).reshape(picture.shape), 0.5), smooth)
    seen = ndimage.gaussian_filter(picture, smooth)
    # Uneven light and reflections vary slowly.
    both = [one - ndimage.gaussian_filter(one, 8.0) for one in (drawn, seen)]
    a, b = (one[use] - one[use].mean() for one in both)
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-12))
