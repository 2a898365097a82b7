"""Discs before a board whose camera is known, where the board is not seen: one of them is the ball.

What is seen directly is known once the camera is. A ball hides the board in a disc, of a size that its radius, the
camera and the board allow; what it stands on, or what holds it, hides more of it to some sides.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from ..errors import PictureError
from .boards import CharucoBoard
from .geometry import Setup
from .illumination import fit_illumination
from .photograph import Photograph, PixelGrid, Place, offsets
from .sight import Projection

Circle = Float[np.ndarray, "3"]
"""A circle's middle and its radius, in pixels of a reduced picture."""


class NothingThrough(PictureError):
    """A photograph that shows nothing through a ball or a tank."""


FILLING = (np.arange(24) + 0.5) / 24
"""Radii at which the inside of a disc is looked at."""

ANGLES = np.arange(32) * (2 * np.pi / 32)
TOWARD = np.stack([np.cos(ANGLES), np.sin(ANGLES)], -1)
INSIDE, AROUND = np.array([0.2, 0.4, 0.6, 0.75, 0.87, 0.96]), np.array([1.06, 1.14, 1.22])
"""Where a disc and what is around it are looked at, at each angle, in radii."""


class Disc(NamedTuple):
    """An outline in the photograph: its middle and its radius, in pixels."""

    center: Place
    radius: float

    def __str__(self) -> str:
        return f"column {self.center[0]:.0f}, row {self.center[1]:.0f}, with a radius of {self.radius:.0f} pixels"


def find_discs(photograph: Photograph, board: CharucoBoard, setup: Setup, blur: float) -> list[Disc]:
    """Discs of the photograph that hide the board and are as large as the ball may be, the most distinct one first.

    Args:
        setup: the camera, and the ball's radius.
        blur: standard deviation of the camera's blur in pixels.

    Raises:
        PictureError: there is no disc, or a ball is too small in such a photograph.
    """
    name, size = photograph.name, photograph.size
    sight, grid = Projection(setup, size), PixelGrid.of(size, max(1, round(size[0] / 480)))
    differs, known, square = _differs(photograph.light, board, sight, blur, grid)
    # Where this share of the pixels around differ from the board, all of it is hidden: in a ball about half do.
    share = 0.35
    hidden = np.minimum(ndimage.gaussian_filter(differs, max(2.0, 0.35 * square)) / share, 1)

    # All middles amid what is hidden are tried, with the radii that a ball can have there.
    low, high = (radii.reshape(hidden.shape) / grid.binning for radii in _radii(sight, grid.pixels))
    least, largest = float(np.min(low[known > 0])), float(np.max(high[known > 0]))
    if largest < 9.0:  # Nothing is seen through so small a disc.
        raise PictureError(
            f"{name}: a ball of this radius is {2 * largest * grid.binning:.0f} pixels wide at most before this board: "
            "photograph from nearer; is its radius right?"
        )
    if 2 * least > min(hidden.shape):
        raise NothingThrough(
            f"{name}: a ball of this radius is {2 * least * grid.binning:.0f} pixels wide at least before this board, "
            f"and the picture is {size[0]} x {size[1]}: is its radius right?"
        )
    # The inside of a disc is hidden by so much more than half of what is around it.
    least_score = 0.4
    amid = ndimage.gaussian_filter(hidden, least / 2) > 0.5 * least_score
    step = max(1, round(0.15 * least))
    row, column = (step * at for at in np.nonzero(amid[::step, ::step]))
    count = int(np.ceil(np.log(float(np.max(high / low))) / np.log(1.07)))
    growth = 1.07 ** np.arange(-1, count + 1)
    circles = np.concatenate([np.stack([column, row, low[row, column] * by], -1) for by in growth])
    circles = circles[circles[:, 2] < np.tile(high[row, column], len(growth))]
    scores = _scores(hidden * known, known, circles)

    # The best one of each place is fitted to the ragged outline of what differs.
    order = circles[np.argsort(-scores)][: np.sum(scores > least_score)]
    sharp = np.minimum(ndimage.gaussian_filter(differs, 2.0) / share, 1)
    discs = _distinct((_fitted(one, sharp, known) for one in _distinct(order, 0.3)), 0.1)
    if not discs:
        raise NothingThrough(
            f"{name}: there is no ball before the board: nothing hides it in a disc of a radius of "
            f"{least * grid.binning:.0f} to {largest * grid.binning:.0f} pixels, as its own radius allows. Stand the "
            "ball before the middle."
        )

    # From the reduced picture's pixels back to the photograph's.
    first = (grid.binning - 1) / 2 + np.array(grid.left)
    return [Disc(one[:2] * grid.binning + first, float(one[2] * grid.binning)) for one in discs]


def _radii(sight: Projection, pixels: Float[np.ndarray, "n 2"]):
    """The least and the largest radius of a ball's outline about pixels: on the board, and halfway to the camera."""
    place = sight.directly(pixels).place
    away = np.linalg.norm(np.pad(place, ((0, 0), (0, 1))) - sight.viewpoint, axis=1)
    radius = sight.setup.glass.radius
    return [
        sight.focal_at(pixels) * radius / np.sqrt(np.maximum((away * share) ** 2 - radius**2, 1e-9))
        for share in (max(1 - radius / sight.viewpoint[2], 0.5), 0.5)
    ]


def _distinct(circles: Iterable[Circle], apart: float) -> list[Circle]:
    """The first six circles, of which no two have middles and radii nearer to each other than so much of a radius."""
    kept: list[np.ndarray] = []
    for circle in circles:
        is_new = all(
            np.hypot(*(circle[:2] - one[:2])) > apart * one[2] or abs(np.log(circle[2] / one[2])) > apart
            for one in kept
        )
        if is_new and len(kept) < 6:
            kept.append(circle)
    return kept


def _fitted(circle: Circle, hidden, known) -> Circle:
    """The circle nearby that holds most of what is hidden and least of what is not, which count alike.

    Where much is hidden around it too, something holds the ball, and the border there is not looked for: the circle is
    fitted again without these directions.
    """
    whole = balance = known * (hidden - 0.5)
    row, column = np.indices(hidden.shape)
    for _ in range(2):

        def unlike(x: Circle, start=circle, balance=balance) -> float:
            growth = np.log(max(x[2], 1.0) / start[2])
            places = x[:2] + x[2] * FILLING[:, None, None] * TOWARD
            inside = _between_pixels(balance, places)
            is_far = max(abs(growth) - 0.4, 0)
            return float(-np.exp(2 * growth) * (inside.mean(axis=1) @ FILLING) + is_far * len(FILLING))

        simplex = circle + circle[2] * np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
        options = {"initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-4}
        circle = optimize.minimize(unlike, circle, method="Nelder-Mead", options=options).x
        beyond = circle[:2] + circle[2] * AROUND[:, None, None] * TOWARD
        around = _between_pixels(hidden * known, beyond).mean(axis=0)
        if np.sum(is_held := around > 0.5) > len(TOWARD) // 2:
            break
        sector = np.round(np.arctan2(row - circle[1], column - circle[0]) / ANGLES[1]).astype(int) % len(TOWARD)
        balance = np.where(is_held[sector], 0.0, whole)
    return circle


def _between_pixels(image: np.ndarray, places: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, " *any"]:
    """A picture's values at columns and rows that lie between its pixels; 0 beyond its border."""
    return ndimage.map_coordinates(image, np.moveaxis(places, -1, 0)[::-1], order=1)


def _scores(
    hidden: Float[np.ndarray, "height width"], known: np.ndarray, circles: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """How much more is hidden inside of circles than around them, to the half of all sides where least is.

    To the other sides may be what the ball stands on, or what holds it. Where there is no board none is seen.
    """

    def at(shares):
        places = circles[:, None, None, :2] + circles[:, None, None, 2:] * shares[:, None] * TOWARD[:, None]
        return (_between_pixels(one, places) for one in (hidden, known))

    inside, is_known = at(INSIDE)
    area = np.maximum((is_known * INSIDE).sum(axis=(1, 2)), 0.5 * INSIDE.sum() * len(TOWARD))
    outside, is_known = at(AROUND)
    around = np.sort((outside + 1 - is_known).mean(axis=2), axis=1)[:, : len(TOWARD) // 2]
    return (inside * INSIDE).sum(axis=(1, 2)) / area - around.mean(axis=1)


def _differs(light, board: CharucoBoard, sight: Projection, blur: float, grid: PixelGrid):
    """Which pixels show something else than the board in the light that lies on it, which see it, a square's side."""
    # How bright the board is in each pixel's mean, blurred.
    seen, shape = sight.directly(grid.pixels).place, grid.size[::-1]
    rays = offsets(grid.binning)
    mean = np.mean([board.brightness(sight.directly(grid.pixels + off).place) for off in rays], axis=0).reshape(shape)
    smooth = ndimage.gaussian_filter(np.nan_to_num(mean), blur / grid.binning)
    expected = np.where(np.isfinite(mean), smooth, np.nan).reshape(-1)
    known = np.isfinite(expected)
    flat = grid.parts(light[None]).mean(axis=-1).reshape(-1)
    # A pixel that is mostly paper tells of its light as paper alone would.
    as_paper = flat / np.where(expected > 0.5, expected, 1.0)
    clear = known & (np.abs(np.nan_to_num(expected) - 0.5) > 0.2)
    field = fit_illumination(np.repeat(as_paper[None, clear], 3, 0), seen[clear], expected[clear], board.half)
    wanted = (field.ink[0] + (1 - field.ink[0]) * np.nan_to_num(expected)).reshape(shape)
    divided = (flat / np.maximum(field.at(np.nan_to_num(seen))[0], 1e-6)).reshape(shape)
    known = known.reshape(shape).astype(float)

    # In a shadow the board is darker, but seen: there its own light, in about a square, makes it what is wanted.
    across = sight.where(np.array([[-board.square / 2, 0], [board.square / 2, 0]]))
    square = float(np.linalg.norm(across[1] - across[0])) / grid.binning
    product, squared = (ndimage.gaussian_filter(known * one * wanted, square) for one in (divided, wanted))
    nearby = np.clip(product / np.maximum(squared, 1e-6), 0.4, 1)
    off = np.minimum(np.abs(divided - wanted), np.abs(divided / nearby - wanted))
    return known * (off > 0.3), known, square
