"""The picture of a target's own samples near a place: sampled where a pixel's inside varies, linear elsewhere."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.forward_model import Picture
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.solve.sampling import COARSE_SAMPLES, Moments, disagreement, pixel_moments, point_sampled
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY


class GridPixels(NamedTuple):
    """Which pixels are sampled as the target is, and what those that see an edge count.

    Args:
        smooth: a pixel that shows no edge is not sampled where the coarse samples' mean and the colour at its centre
            differ by less than this. A parabola goes through them: what it lacks is of fourth order, and far below the
            square of this.
        contrasts: share of the strongest edge's contrast from which on an edge counts: what varies less may do so
            smoothly.
        same: colours that differ by less than so many jumps of one sample are the same, but for rounding.
        little: weight of a pixel that sees an edge along the grid. All of them, some thousands, count less than one
            other pixel, and still determine what nothing else does. Of a ball before a level board, its place, its
            index and the field of view free, a step leads two fifths of the way to the true field of view, and a
            hundredth where they count as others do.
    """

    smooth: float = 1e-4
    contrasts: float = 0.1
    same: float = 1e-3
    little: float = 1e-6


GRID_PIXELS = GridPixels()


@dataclasses.dataclass(frozen=True)
class GridPicture:
    """Means of n x n samples a pixel, for unknowns so near a place that no edge leaves the listed pixels.

    Args:
        problem: what is fitted.
        samples: the n of n x n samples a pixel.
        y: unknowns of the place.
        light: the picture there before the film, and the derivatives of the edge-aware one.
        columns: derivative of the edge-aware picture there, after the film, by the unknowns.
        row, column: where the listed pixels are.
        variance: variance of the samples within each listed pixel.
    """

    problem: Problem
    samples: int
    y: Float[np.ndarray, " parameters"]
    light: Picture
    columns: Float[np.ndarray, "parameters 3 height width"]
    row: Int[np.ndarray, " listed"]
    column: Int[np.ndarray, " listed"]
    variance: Float[np.ndarray, "3 listed"]

    def at(self, y: Float[Array, " parameters"]) -> Picture:
        """The picture at unknowns nearby; its derivative is that at the place."""
        # Listed pixels are sampled anew, all others follow the derivative.
        step = (np.asarray(y, np.float64) - self.y)[list(self.problem.unknowns.light_places)]
        image = self.mean + np.tensordot(step, np.asarray(self.light.columns, np.float64), 1)
        image[:, self.row, self.column] = sampled(self.problem, y, self.row, self.column, self.samples).mean
        light = Picture(self.problem.array(image), self.light.columns)
        return self.problem.development.picture(light, y, self.problem.frame())

    @functools.cached_property
    def mean(self) -> Float[np.ndarray, "3 height width"]:
        """The picture at the place, before the film."""
        return np.asarray(self.light.image, np.float64)

    @property
    def jump(self) -> Float[np.ndarray, " listed"]:
        """The change of a listed pixel when one of its samples changes sides of an edge, all channels together.

        It is 0 where there is no edge that counts, or the pixel has no weight.
        """
        root = np.asarray(self.problem.observation.root_weight, np.float64)[self.row, self.column]
        jump = self.any_jump
        return np.where((jump > GRID_PIXELS.contrasts * np.max(jump, initial=TINY)) & (root > 0), jump, 0.0)

    @property
    def any_jump(self) -> Float[np.ndarray, " listed"]:
        """The change of a listed pixel when one of its samples changes sides, however weak its edge is.

        It is `c / n^2`, where `c` is the contrast of the edge. The variance within a pixel with a share `f` on one side
        is `c^2 f (1 - f)`, which tells `c`.
        """
        # The mean of `f (1 - f)` is 1/6 where any share `f` of the pixel is as likely.
        return np.sqrt(self.variance.sum(axis=0) / (1 / 6)) / self.samples**2

    @functools.cached_property
    def is_along(self) -> Bool[np.ndarray, " listed"]:
        """Which listed pixels see an edge along the grid, or are beside one: a line of a board before a level camera.

        All samples of a row or column change sides of such an edge at once. Such a pixel is known by its two neighbours
        along the edge, which have its colour. A pixel whose edge lies just beyond the last samples is known by them
        too. Where two lines meet, a pixel has no such neighbours; it counts because a pixel beside it has.
        """
        tolerance = self.any_jump / 2 + GRID_PIXELS.same * np.max(self.any_jump, initial=TINY)
        padded = np.pad(self.mean, ((0, 0), (1, 1), (1, 1)), mode="edge")
        row, column, mean = self.row + 1, self.column + 1, self.mean[:, self.row, self.column]

        def differs(down: int, right: int) -> Bool[np.ndarray, " listed"]:
            return np.linalg.norm(padded[:, row + down, column + right] - mean, axis=0) > tolerance

        upright, level = (~differs(-a, -b) & ~differs(a, b) for a, b in ((1, 0), (0, 1)))
        is_along = np.zeros(self.mean.shape[1:], bool)
        is_along[self.row, self.column] = upright | level
        return ndimage.binary_dilation(is_along)[self.row, self.column]

    @functools.cached_property
    def leading(self) -> Problem:
        """The problem that leads steps, in which edges along the grid hardly count.

        Such an edge tells a place only in large jumps. The edge-aware derivative takes it to move with every step, so
        that it would hold the step where it is.
        """
        weight = np.ones(self.mean.shape[1:])
        weight[self.row[self.is_along], self.column[self.is_along]] = GRID_PIXELS.little
        return self.problem.weighted(weight)

    def resolution(self) -> Float[np.ndarray, "parameters parameters"]:
        """How far apart places are whose pictures are the same, as a covariance of the unknowns: that of `apart`."""
        return self.apart @ self.apart.T

    @functools.cached_property
    def apart(self) -> Float[np.ndarray, "parameters directions"]:
        """Steps in conjugate directions, each as long as it takes to tell two places apart.

        The mean of a pixel's samples changes in jumps `j`, one each time an edge crosses a sample. Over a step `d` it
        changes by `J d` on average, so that `|J d| / j` samples of the pixel change sides. Their sum over the listed
        pixels is `m(d)`. Two places `d` apart are told apart where `m(d)` is the number `p` of unknowns, one sample for
        each. `m` grows in proportion to the length of `d`: along a direction `u` that is the step `u p / m(u)`.

        The directions are `p` conjugate ones of `M = sum J J^T / j^2`: eigenvectors of `M` with each unknown in units
        of its own slope, so that they do not depend on its unit.
        """
        jump = self.jump
        seen = jump > 0
        # Edges along the grid tell a place only where there are no others.
        seen = others if (others := seen & ~self.is_along).any() else seen
        slopes = self.columns[:, :, self.row, self.column][:, :, seen] / np.maximum(jump[seen], TINY)
        count = len(slopes)
        flat = slopes.reshape(count, -1)
        length = np.sqrt(np.maximum(np.sum(flat**2, axis=1), TINY))
        _, axes = np.linalg.eigh((flat @ flat.T) / np.outer(length, length))
        # `crossed` is m(u) of each direction u, the rows of `axes.T / length`.
        moved = np.tensordot(axes.T / length, slopes, 1)
        crossed = np.sum(np.linalg.norm(moved, axis=1), axis=1)
        return axes / length[:, None] * (count / np.maximum(crossed, TINY))


def grid_picture(
    problem: Problem,
    y: Float[Array, " parameters"],
    comparison: Comparison,
    samples: int,
    coarse: Moments | None = None,
) -> GridPicture:
    """The picture of n x n samples a pixel, near `y`.

    Args:
        problem: what is fitted.
        y: unknowns near the answer.
        comparison: how edge-aware picture and target are compared.
        samples: how many the target's regular grid has, a pixel and side.
        coarse: `COARSE_SAMPLES` samples a pixel and side at `y`, if they are known.
    """
    aware, light = problem.picture(y, comparison.edges), problem.picture_of_light(y, comparison.edges)
    if coarse is None:
        coarse = point_sampled(problem, y, COARSE_SAMPLES)
    # Everywhere: a parabola through the pixel's centre and the mean of its coarse samples.
    center = point_sampled(problem, y, 1).mean
    # The mean of n x n samples of a parabola lies above its centre by 1 - 1/n^2 of what the mean over the pixel does.
    bend = (coarse.mean - center) / (1 - 1 / COARSE_SAMPLES**2)
    mean = center + (1 - 1 / samples**2) * bend
    # List the pixels in which that may fail, and sample these as the target is.
    is_varied = np.abs(coarse.mean - center).max(axis=0) > GRID_PIXELS.smooth
    is_varied |= disagreement(problem, y, np.asarray(aware.image), coarse)
    # An edge that cuts no more than a corner of a pixel is not seen by few samples, but by footprints.
    assert aware.sees_edge is not None
    row, column = np.nonzero(is_varied | aware.sees_edge)
    moments = sampled(problem, y, row, column, samples)
    mean[:, row, column] = moments.mean
    place, columns = np.asarray(y, np.float64), np.asarray(aware.columns, np.float64)
    light = Picture(problem.array(mean), light.columns)
    return GridPicture(problem, samples, place, light, columns, row, column, moments.variance)


def sampled(
    problem: Problem,
    y: Float[Array, " parameters"],
    row: Int[np.ndarray, " pixels"],
    column: Int[np.ndarray, " pixels"],
    samples: int,
) -> Moments:
    """Mean and variance of n x n samples in each of some pixels."""
    return pixel_moments(problem, problem.scene_at(y), column, row, sample_offsets(samples))
