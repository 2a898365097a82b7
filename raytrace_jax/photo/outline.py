"""The outline of a ball before a board whose camera is known: where the board is not seen.

What is seen directly is known once the camera is. Where the photograph shows something else as large as a disc, there
is the ball.
"""

from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.boards import Board
from raytrace_jax.photo.grids import Grid, offsets
from raytrace_jax.photo.light_field import fit_light_field
from raytrace_jax.photo.sight import Sight


class OutlineSearch(NamedTuple):
    """How the outline is looked for.

    Args:
        width: about how many pixels wide the picture is in which the outline is looked for.
        differs: a pixel whose brightness is off by more than this share of paper's shows something else than the board.
        round: the least ratio of a disc's height to its width, and of its area to an ellipse's; a ball with a stand
            has less.
        least_radius: in pixels of the reduced picture; nothing is seen through a smaller disc.
    """

    width: int = 480
    differs: float = 0.3
    round: float = 0.8
    least_radius: float = 9.0


OUTLINE_SEARCH = OutlineSearch()


class Disc(NamedTuple):
    """An outline in the photograph: its middle and its radius, in pixels."""

    center: Float[np.ndarray, "2"]
    radius: float


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
    grid = Grid.of(size, max(1, round(size[0] / OUTLINE_SEARCH.width)))
    shape = grid.size[::-1]
    seen, expected = _expected(Sight(numbers, size), board, grid, blur)
    on_board = np.isfinite(expected)
    flat = grid.parts(light[None]).mean(axis=-1).reshape(-1)
    field = fit_light_field(np.repeat(flat[None, on_board], 3, 0), seen[on_board], expected[on_board], board.half)
    wanted = field.ink[0] + (1 - field.ink[0]) * np.nan_to_num(expected)
    differs = np.abs(flat / np.maximum(field.at(np.nan_to_num(seen))[0], 1e-6) - wanted)

    # Where much differs is the ball. It counts what differs in about a square, for the edges of squares differ by blur
    # alone, and in a ball only half of all pixels differ.
    off = np.where(on_board, np.minimum(differs, 1), 0).reshape(shape)
    share = ndimage.gaussian_filter((off > OUTLINE_SEARCH.differs).astype(float), 2.0)
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
    if abs(found[2]) < OUTLINE_SEARCH.least_radius:
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
        is_long = min(height, width) <= OUTLINE_SEARCH.round * max(height, width)
        is_round = not is_long and OUTLINE_SEARCH.round < fills < 1 / OUTLINE_SEARCH.round
        if is_round and areas[number - 1] > np.pi * OUTLINE_SEARCH.least_radius**2:
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
