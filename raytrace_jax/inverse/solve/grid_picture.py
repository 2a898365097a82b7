"""The picture of a target's own samples near a place: sampled where a pixel's inside varies, linear elsewhere."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.light_picture import Picture
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.solve.sampling import COARSE_SAMPLES, Moments, disagreement, pixel_moments, point_sampled
from raytrace_jax.tracer.programs.tiles import sample_offsets
from raytrace_jax.util.numerics import TINY

SMOOTH = 1e-4
"""Where the coarse samples' mean and the colour at the pixel's centre differ by less than this, and no edge is found,
a parabola goes through them: what it lacks is of fourth order, and far below the square of this."""

MEAN_OF_SHARES = 1 / 6
"""Of `f (1 - f)`, where an edge leaves the share `f` of a pixel on one side and any share is as likely."""

CONTRASTS = 0.1
"""Share of the strongest edge's contrast from which on one counts: what varies less may do so smoothly."""

SAME = 1e-3
"""Colours that differ by less than so many jumps of one sample are the same, but for rounding."""

LITTLE = 1e-6
"""Weight of a pixel that sees an edge along the grid. All of them, some thousands, count less than one other pixel, and
still determine what nothing else does. Of a ball before a level board, its place, its index and the field of view
free, a step leads two fifths of the way to the true field of view, and a hundredth where they count as others do."""


@dataclasses.dataclass(frozen=True)
class GridPicture:
    """Means of n x n samples a pixel, for unknowns so near a place that no edge leaves the listed pixels.

    Args:
        problem: what is fitted.
        samples: n.
        y: the place.
        light: the picture there before the film, and the derivatives of the edge-aware one.
        columns: derivative of the edge-aware picture there, after the film, by the unknowns.
        row, column: of the listed pixels.
        variance: of the samples within these.
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
        """By how much a sample that changes sides changes a listed pixel, all channels together; 0 without an edge."""
        root = np.asarray(self.problem.observation.root_weight, np.float64)[self.row, self.column]
        jump = self.any_jump
        return np.where((jump > CONTRASTS * np.max(jump, initial=TINY)) & (root > 0), jump, 0.0)

    @property
    def any_jump(self) -> Float[np.ndarray, " listed"]:
        """The same where an edge is weak, or none.

        `c / n^2`, where the contrast `c` of the edge is what the variance `c^2 f (1 - f)` within the pixel tells.
        """
        return np.sqrt(self.variance.sum(axis=0) / MEAN_OF_SHARES) / self.samples**2

    @functools.cached_property
    def is_along(self) -> Bool[np.ndarray, " listed"]:
        """Which listed pixels see an edge along the grid, or are beside one: a line of a board before a level camera.

        There a pixel's neighbours along the edge have its colour: all samples of a row or column change sides at once.
        So have they where an edge lies just beyond the last samples. Where two lines meet only pixels beside it tell.
        """
        tolerance = self.any_jump / 2 + SAME * np.max(self.any_jump, initial=TINY)
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
        """The problem that leads steps: edges along the grid hardly count, since they tell a place only in large jumps.

        An edge-aware derivative has them move with every step, so that they would hold it where they are.
        """
        weight = np.ones(self.mean.shape[1:])
        weight[self.row[self.is_along], self.column[self.is_along]] = LITTLE
        return self.problem.weighted(weight)

    def resolution(self) -> Float[np.ndarray, "parameters parameters"]:
        """How far apart places are whose pictures are the same, as a covariance of the unknowns.

        A mean of samples changes in jumps `j`, where an edge crosses one of them. Between two places, `d` apart,
        `sum |J d| / j` samples change sides over the listed pixels. Along each axis of the ellipsoid
        `d^T (sum J J^T / j^2) d = 1` places are told apart where one does for each of the unknowns.
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
        # Samples that change sides for a step of 1 along each axis, in units of `length`.
        moved = np.tensordot(axes.T / length, slopes, 1)
        crossed = np.sum(np.linalg.norm(moved, axis=1), axis=1)
        steps = axes / length[:, None] * (count / np.maximum(crossed, TINY))
        return steps @ steps.T


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
        samples: of the target's regular grid, a pixel and side.
        coarse: `COARSE_SAMPLES` samples a pixel and side at `y`, if they are known.
    """
    aware, light = problem.picture(y, comparison.edges), problem.picture_of_light(y, comparison.edges)
    if coarse is None:
        coarse = point_sampled(problem, y, COARSE_SAMPLES)
    center = point_sampled(problem, y, 1).mean
    # The mean of n x n samples of a parabola lies above its centre by 1 - 1/n^2 of what the mean over the pixel does.
    bend = (coarse.mean - center) / (1 - 1 / COARSE_SAMPLES**2)
    mean = center + (1 - 1 / samples**2) * bend
    is_varied = np.abs(coarse.mean - center).max(axis=0) > SMOOTH
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
