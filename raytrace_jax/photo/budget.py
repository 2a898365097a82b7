"""What the error of an index is made of, and what would lessen it most."""

from typing import NamedTuple

import numpy as np

from raytrace_jax.photo.bundle import Adjusted
from raytrace_jax.photo.cameras import COUNT, LENS
from raytrace_jax.photo.through_glass import RADIUS


class Budget(NamedTuple):
    """Parts of an index's standard deviation, whose squares add up to its square; and what it would be.

    Args:
        radius: of what was known of the radius, and with it of the ruler.
        corners: of the corners' scatter.
        lens: of what was known of the lens.
        without_radius: the whole if radius and ruler were exact.
        without_lens: the whole if the lens were.
        fourfold: the whole with four times as many photographs like these.
    """

    radius: float
    corners: float
    lens: float
    without_radius: float
    without_lens: float
    fourfold: float

    @property
    def advice(self) -> str:
        """A sentence on what would lessen the error most."""
        ways = {
            "measure ball and ruler better: were they exact, {:.2g} would be left": self.without_radius,
            "calibrate the lens, or with more tilted pictures: were it exact, {:.2g} would be left": self.without_lens,
            "take more photographs, the ball at other places: four times as many would leave {:.2g}": self.fourfold,
        }
        best = min(ways, key=lambda way: ways[way])
        return f"To lessen the index's error, {best.format(ways[best])}."


def budget(adjusted: Adjusted) -> Budget:
    """The parts of the error of an adjusted index, which follows linearly from corners, lens and radius."""
    covariance, root = adjusted.covariance, adjusted.known
    variance = covariance[COUNT, COUNT]
    moved, of_radius = root @ covariance[COUNT], root[:, COUNT + RADIUS] != 0
    radius, lens = (float(np.sum(moved[rows] ** 2)) for rows in (of_radius, ~of_radius))

    def exact(places: list[int]) -> float:
        """The index's variance if these numbers were known."""
        across = covariance[COUNT, places]
        return float(variance - across @ np.linalg.pinv(covariance[np.ix_(places, places)]) @ across)

    # In units of each number's error; the corners' precision is what is left of all precision.
    spread = np.sqrt(np.diagonal(covariance))
    free = np.flatnonzero(spread > 0)
    before = root[:, free] * spread[free]
    whole = np.linalg.pinv(covariance[np.ix_(free, free)] / np.outer(spread[free], spread[free]))
    more = np.linalg.pinv(4 * whole - 3 * before.T @ before)
    fourfold = more[(place := int(np.flatnonzero(free == COUNT)[0])), place] * variance
    parts = (radius, variance - radius - lens, lens, exact([COUNT + RADIUS]), exact([*range(LENS.start, LENS.stop)]))
    return Budget(*(float(np.sqrt(max(part, 0.0))) for part in (*parts, fourfold)))
