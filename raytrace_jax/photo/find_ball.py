"""A ball before a board whose camera is known: where it is, and a first index.

An outline and its radius tell how far away it is. Then the index is the one with which the board, drawn as it is seen
through such a ball, looks like the photograph.
"""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize

from ..errors import PictureError
from .boards import CharucoBoard
from .geometry import Ball, Setup
from .outline import Disc, NothingThrough
from .photograph import Photograph, PixelGrid
from .sight import Projection


def find_ball(photograph: Photograph, board: CharucoBoard, setup: Setup, blur: float, discs: list[Disc]) -> Setup:
    """The set-up with a ball: in the disc, and with the index, in which it looks best.

    Args:
        setup: the camera, and the ball's radius.
        blur: standard deviation of the camera's blur in pixels.
        discs: where its outline may be.

    Raises:
        NothingThrough: nothing is seen through any of them.
        PictureError: the board is seen through two.
    """
    # A quick look says which are likely; the first that shows the board well is the ball.
    name, glance = photograph.name, []
    least, sure = 0.35, 0.6  # The least correlation of photograph and drawing, and that which ends the search.
    found: list[tuple[float, Disc, Setup]] = []
    # About the width of the ball in pixels: through one far from a large board many small squares are seen.
    for width in (56, 130):
        trials = [_Trial(photograph, board, setup, blur, disc, width) for disc in discs]
        glance = [one.glance() for one in trials]
        for k in np.argsort(-np.array(glance)):
            alike, candidate = trials[k].best()
            found.append((alike, discs[k], candidate))
            if alike > sure:
                break
        if found[-1][0] > sure:
            break
    alike, first, best = max(found, key=lambda one: one[0])
    if alike < least:
        how = "shows no board" if alike == -1 else f"does not look like the board (correlation {alike:.2f})"
        raise NothingThrough(
            f"{name}: what is seen through the ball {how}: put the ball so that some squares are seen through it, "
            "upright or upside down; is its radius right?"
        )
    for disc, looks in zip(discs, glance, strict=True):
        is_beside = np.hypot(*(disc.center - first.center)) > disc.radius + first.radius
        if is_beside and looks > least:
            raise PictureError(
                f"{name}: the board is seen through two balls, at {first}, and at {disc}; one is wanted, or --ball "
                "to say which."
            )
    return best


class _Trial:
    """A disc as the outline of a ball: how much what is seen through it looks like the board.

    A candidate is an index, a fraction of the distance by which the ball is farther away, and how many radii it is
    aside and upwards; the outline tells these less well than where the ball is seen.
    """

    def __init__(self, photograph: Photograph, board: CharucoBoard, setup: Setup, blur: float, disc: Disc, width: int):
        self.board, self.size = board, photograph.size
        sight = Projection(setup, self.size)
        self.eye, self.start, self.center = sight.viewpoint, setup, sight.center_of(*disc)
        grid = PixelGrid.of(self.size, max(1, round(2 * disc.radius / width))).around(disc.center, disc.radius)
        self.pixels, self.smooth = grid.pixels, max(1.0, blur / grid.binning)
        self.picture = grid.parts(photograph.light[None]).mean(axis=-1)[0]
        self.indices = np.arange(1.2, 2.25, 0.02)
        self.aside = np.zeros(2)

    def setup(self, candidate: Float[np.ndarray, "4"]) -> Setup:
        """The set-up with a candidate for the ball."""
        ior, farther, aside, upwards = candidate
        center, radius = self.eye + (1 + farther) * (self.center - self.eye), self.start.glass.radius
        ball = Ball(ior, center + radius * np.array([aside, upwards, 0.0]), radius)
        return dataclasses.replace(self.start, glass=ball)

    def correlation(self, candidate: Float[np.ndarray, "4"]) -> float:
        """Normalised cross-correlation of photograph and drawing within the ball; -1 where nothing is seen.

        Only what varies over a few pixels counts.
        """
        ball = Projection(self.setup(candidate), self.size).through(self.pixels)
        brightness, inside = self.board.brightness(ball.place), ball.reach < 0.85
        use = (ball.valid & inside & np.isfinite(brightness)).reshape(self.picture.shape)
        if np.sum(use) < 0.3 * np.sum(inside):
            return -1.0
        drawn = np.where(use, np.nan_to_num(brightness).reshape(self.picture.shape), 0.5)
        drawn, seen = (ndimage.gaussian_filter(one, self.smooth) for one in (drawn, self.picture))
        # Uneven light and reflections vary slowly.
        both = [one - ndimage.gaussian_filter(one, 8.0) for one in (drawn, seen)]
        a, b = (one[use] - one[use].mean() for one in both)
        return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-12))

    def glance(self) -> float:
        """How alike the likest of few candidates is; the search goes on from how far aside it is.

        They lie some hundredths of a radius aside, for a hand or a stand biases the outline.
        """
        offsets = (0.0, -0.04, 0.04)
        candidates = [np.array([index, 0, *aside]) for index in self.indices[::2]
                      for aside in itertools.product(offsets, offsets)]  # fmt: skip
        alike = [self.correlation(one) for one in candidates]
        self.aside = candidates[int(np.argmax(alike))][2:]
        return max(alike)

    def best(self) -> tuple[float, Setup]:
        """How alike the likest candidate is, and its set-up."""
        # Balls farther away are tried rather than nearer ones, for an outline is some per cent too large.
        distances = np.arange(-0.03, 0.051, 0.01)
        scan = np.array([[*both, *self.aside] for both in itertools.product(self.indices, distances)])
        alike = np.array([self.correlation(one) for one in scan])
        # Drawings look alike at several indices: the scan keeps the best places of several valleys.
        starts: list[np.ndarray] = []
        for k in np.argsort(-alike)[: np.sum(alike > alike.max() - 0.2)]:
            if len(starts) < 4 and all(abs(scan[k][0] - one[0]) > 0.06 for one in starts):
                starts.append(scan[k])

        # Each valley is searched to its bottom, and the likest drawing tells the index.
        found, steps = [], np.concatenate([np.zeros((1, 4)), np.diag([0.02, 0.01, 0.02, 0.02])])
        for one in starts:
            simplex = one + steps
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": 160}
            done = optimize.minimize(lambda at: -self.correlation(at), one, method="Nelder-Mead", options=options)
            found.append((-float(done.fun), self.setup(done.x)))
        return max(found, key=lambda one: one[0])
