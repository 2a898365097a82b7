"""A ball before a board whose camera is known: where it is, and a first index.

An outline and its radius tell how far away it is. Then the index is the one with which the board, drawn as it is seen
through such a ball, looks like the photograph.
"""

import itertools

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.boards import CharucoBoard
from raytrace_jax.photo.bundle import BALL
from raytrace_jax.photo.cameras import COUNT
from raytrace_jax.photo.grids import PixelGrid
from raytrace_jax.photo.outline import Disc, NoBall
from raytrace_jax.photo.sight import Sight

BALL_WIDTHS = (56, 130)
"""About how many pixels wide the ball is where its index is looked for. The second is taken where the first shows the
board in no disc surely: through a ball that stands far from a large board many small squares are seen."""

MOST_STARTS, APART, LESS_ALIKE = 4, 0.06, 0.2
"""So many of the scan's places are refined, whose indices differ by more than this, so that they are not all in one
valley, and which are less alike than the best one by this much at most."""

WITHIN = 0.85
"""Photograph and drawing are compared within this share of the outline's radius."""

LEAST_ALIKE, SURELY_ALIKE = 0.35, 0.6
"""The least correlation of a photograph and a drawing of the same, and that from which no other disc is tried."""

INDICES = np.arange(1.2, 2.25, 0.02)
"""Indices of the scan."""

FARTHER = np.arange(-0.03, 0.051, 0.01)
"""The scan moves the ball farther away by these shares of its distance, for an outline is some per cent too large."""

ASIDE = (0.0, -0.04, 0.04)
"""The quick look moves the ball by so many radii, for what holds it may shift its outline."""

STEPS = np.array([0.02, 0.01, 0.02, 0.02])
"""The refinement's first steps: in the index, in the share of the distance, and in radii aside and upwards."""


def find_ball(
    light: Float[np.ndarray, "height width"],
    board: CharucoBoard,
    numbers: Float[np.ndarray, " numbers"],
    blur: float,
    name: str,
    discs: list[Disc],
) -> Float[np.ndarray, " numbers"]:
    """The numbers with a ball: in the disc, and with the index, in which it looks best.

    Args:
        light: the photograph, scene-linear.
        board: what it shows.
        numbers: the camera's, and the ball's radius.
        blur: standard deviation of the camera's blur in pixels.
        name: of the photograph, for messages.
        discs: where its outline may be.

    Raises:
        NoBall: nothing is seen through any of them.
        PictureError: the board is seen through two.
    """
    # A quick look says which are likely; the first that shows the board well is the ball.
    glance: list[float] = []
    found: list[tuple[float, Disc, Float[np.ndarray, " numbers"]]] = []
    for width in BALL_WIDTHS:
        trials = [_Trial(light, board, numbers, blur, disc, width) for disc in discs]
        glance = [one.glance() for one in trials]
        for k in np.argsort(-np.array(glance)):
            alike, candidate = trials[k].best()
            found.append((alike, discs[k], candidate))
            if alike > SURELY_ALIKE:
                break
        if found[-1][0] > SURELY_ALIKE:
            break
    alike, first, best = max(found, key=lambda one: one[0])
    if alike < LEAST_ALIKE:
        how = "shows no board" if alike == -1 else f"does not look like the board (correlation {alike:.2f})"
        raise NoBall(
            f"{name}: what is seen through the ball {how}: put the ball so that some squares are seen through it, "
            "upright or upside down; is its radius right?"
        )
    for disc, looks in zip(discs, glance, strict=True):
        is_beside = np.hypot(*(disc.center - first.center)) > disc.radius + first.radius
        if is_beside and looks > LEAST_ALIKE:
            raise PictureError(
                f"{name}: the board is seen through two balls, at {first}, and at {disc}; one is wanted, or --ball "
                "to say which."
            )
    return best


class _Trial:
    """A disc as the outline of a ball: how much what is seen through it looks like the board.

    A candidate has an index, and is moved along the line of sight and aside, which the outline tells less well.
    """

    def __init__(
        self, light, board: CharucoBoard, numbers: Float[np.ndarray, " numbers"], blur: float, disc: Disc, width: int
    ):
        self.size = (light.shape[1], light.shape[0])
        self.board, self.blur, self.start = board, blur, np.array(numbers)
        self.start[BALL.start + 1 : BALL.start + 4] = center_of(numbers, self.size, disc)
        grid = PixelGrid.of(self.size, max(1, round(2 * disc.radius / width)))
        self.grid = grid.around(disc.center, disc.radius)
        self.picture = self.grid.parts(light[None]).mean(axis=-1)[0]
        self.eye = Sight(self.start, self.size).viewpoint
        self.aside = np.zeros(2)

    def numbers(self, where: Float[np.ndarray, "4"]) -> Float[np.ndarray, " numbers"]:
        """The numbers of a candidate."""
        index, farther, aside, upwards = where
        trial, center = np.array(self.start), self.start[COUNT + 1 : COUNT + 4]
        trial[COUNT] = index
        off = self.start[COUNT + 4] * np.array([aside, upwards, 0.0])
        trial[COUNT + 1 : COUNT + 4] = self.eye + (1 + farther) * (center - self.eye) + off
        return trial

    def alike(self, where: Float[np.ndarray, "4"]) -> float:
        """Correlation of photograph and drawing, of what varies over a few pixels, within the ball; -1 without any."""
        ball = Sight(self.numbers(where), self.size).through(self.grid.pixels)
        brightness = self.board.brightness(ball.place)
        use = (ball.valid & (ball.reach < WITHIN) & np.isfinite(brightness)).reshape(self.picture.shape)
        if np.sum(use) < 0.3 * np.sum(ball.reach < WITHIN):
            return -1.0
        smooth = max(1.0, self.blur / self.grid.binning)
        drawn = np.where(use, np.nan_to_num(brightness).reshape(self.picture.shape), 0.5)
        drawn, seen = (ndimage.gaussian_filter(one, smooth) for one in (drawn, self.picture))
        # Uneven light and reflections vary slowly.
        both = [one - ndimage.gaussian_filter(one, 8.0) for one in (drawn, seen)]
        a, b = (one[use] - one[use].mean() for one in both)
        return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-12))

    def glance(self) -> float:
        """How alike the likest of few candidates is; the search goes on from how far aside it is."""
        places = [np.array([index, 0, *aside]) for index in INDICES[::2] for aside in itertools.product(ASIDE, ASIDE)]
        alike = [self.alike(where) for where in places]
        self.aside = places[int(np.argmax(alike))][2:]
        return max(alike)

    def best(self) -> tuple[float, Float[np.ndarray, " numbers"]]:
        """How alike the likest candidate is, and its numbers."""

        def unlike(where: Float[np.ndarray, "4"]) -> float:
            return -self.alike(where)

        # Drawings look alike at several indices: the scan keeps the best places of several valleys.
        scan = [np.array([index, farther, *self.aside]) for index, farther in itertools.product(INDICES, FARTHER)]
        starts: list[np.ndarray] = []
        alike = np.array([self.alike(where) for where in scan])
        for k in np.argsort(-alike)[: np.sum(alike > alike.max() - LESS_ALIKE)]:
            if len(starts) < MOST_STARTS and all(abs(scan[k][0] - one[0]) > APART for one in starts):
                starts.append(scan[k])

        # Each valley is searched to its bottom, and the likest drawing tells the index.
        found = []
        for one in starts:
            simplex = one + np.concatenate([np.zeros((1, 4)), np.diag(STEPS)])
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": 160}
            done = optimize.minimize(unlike, one, method="Nelder-Mead", options=options)
            found.append((-float(done.fun), self.numbers(done.x)))
        return max(found, key=lambda one: one[0])


def center_of(numbers: Float[np.ndarray, " numbers"], size: tuple[int, int], disc: Disc) -> Float[np.ndarray, "3"]:
    """Where a ball of the numbers' radius is that has this outline."""
    sight = Sight(numbers, size)
    tangent = disc.radius / float(sight.focal_at(disc.center))
    distance = numbers[BALL.start + 4] * np.sqrt(1 + 1 / tangent**2)
    return sight.viewpoint + distance * sight.toward(disc.center)
