"""The samples of pixels: points, regular grids and lattices; and the picture of samples like the target's."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Int

from ...scene.scene import map_scenes
from ...tracer.pixels import sample_offsets
from ...util.numerics import TINY, on_host, solve_normal
from ..options import Stage
from .noise import compressed
from .prediction import PredictedPicture
from .problem import FitState, Problem
from .unknowns import Covariance, Image, Images, PixelIndices, PixelJacobian, Values, Vector


def supersampled(problem: Problem, y: Vector, samples: int) -> Image:
    """The picture at `y`, each pixel the mean of a regular grid of point samples."""
    return problem.apply_response(point_sampled(problem, y, samples)[0], y)


def point_sampled(problem: Problem, y: Vector, samples: int) -> tuple[Image, Image]:
    """Mean and variance within each of the target's pixels, of a regular grid of `samples` points a side."""
    mean, variance = pixel_moments(problem, y, *problem.places(), sample_offsets(samples))
    return mean.reshape(problem.observation.target.shape), variance.reshape(problem.observation.target.shape)


def pixel_moments(
    problem: Problem,
    y: Vector,
    column: PixelIndices,
    row: PixelIndices,
    offsets: Float[np.ndarray, "samples 2"],
) -> tuple[Float[np.ndarray, "3 pixels"], Float[np.ndarray, "3 pixels"]]:
    """Mean and variance of point samples at these offsets within some of the target's pixels, before the response."""
    scenes = map_scenes(lambda x: np.asarray(x)[None], problem.scene_at(y))
    total, squares = np.zeros((2, 3, len(column)))
    # Some at a time, so that columns and rows take at most 16 MB.
    for chunk in np.array_split(offsets, max(1, offsets.size * len(column) // 1_000_000)):
        right, down = chunk.T[:, :, None]
        points = problem.points((column + right).reshape(-1), (row + down).reshape(-1))
        colors = problem.model.points(scenes, points, problem.base).astype(np.float64)
        colors = colors.reshape(3, len(chunk), len(column))
        total += colors.sum(axis=1)
        squares += np.sum(colors**2, axis=1)
    mean = total / len(offsets)
    return mean, np.maximum(squares / len(offsets) - mean**2, 0.0)


COARSE_SAMPLES = 2
"""Samples a pixel and side with which the edge-aware picture is compared everywhere: the fewest that see an edge."""

LATTICES = (89, 233, 610, 1597)
"""Points of the lattices that a pixel may be sampled with: Fibonacci numbers."""


def lattice_size(least: float = 0, most: float = np.inf) -> int:
    """The number of points of the smallest lattice with `least` or more, but not more than `most` if one has so few."""
    sizes = [size for size in LATTICES if size <= most] or [LATTICES[0]]
    return next((size for size in sizes if size >= least), sizes[-1])


def lattice_offsets(size: int) -> Float[np.ndarray, "samples 2"]:
    """Offsets of samples from a pixel's middle: a Fibonacci lattice of `size` points (Niederreiter and Sloan 1994).

    A regular grid of as many errs as much in the area of an edge of any direction, but five times as much where the
    edge is nearly along its rows, and then alike in all pixels of a line of a level board.
    """
    # The Fibonacci number before is this one over the golden ratio, rounded.
    index, step = np.arange(size), round(size * 2 / (1 + 5**0.5))
    return np.stack([(index + 0.5) / size, np.mod(index * step + 0.5, size) / size], axis=1) - 0.5


@dataclasses.dataclass(frozen=True)
class ResampledPicture:
    """Means of samples in each pixel, for unknowns so near a place that no edge leaves the listed pixels.

    Args:
        offsets: where in a pixel they lie.
        jacobian: derivative of the edge-aware picture there, after the film, by the unknowns.
    """

    problem: Problem
    offsets: Float[np.ndarray, "samples 2"]
    y: Values
    radiance: PredictedPicture
    jacobian: PixelJacobian
    row: Int[np.ndarray, " listed"]
    column: Int[np.ndarray, " listed"]
    variance: Float[np.ndarray, "3 listed"]

    def at(self, y: Vector) -> PredictedPicture:
        """The picture at unknowns nearby; its derivative is that at the place."""
        # Listed pixels are sampled anew, all others follow the derivative.
        problem, image, move = self.problem, self.mean, on_host(y) - self.y
        if move.any():
            step = move[problem.local.traced]
            image = image + np.tensordot(step, on_host(self.radiance.jacobian), 1)
            image[:, self.row, self.column] = pixel_moments(problem, y, self.column, self.row, self.offsets)[0]
        radiance = PredictedPicture(problem.array(image), self.radiance.jacobian)
        picture = problem.camera.picture(radiance, y, problem.frame())
        image = on_host(picture.image)
        if problem.storage is not None:
            image = compressed(problem.storage, problem.observation, image)
        return dataclasses.replace(picture, image=problem.array(image))

    def state(self, y: Vector, stage: Stage) -> FitState:
        """The state of a fit there."""
        return FitState(self.problem, y, stage, self.problem.linearize(y, stage, self.at(y)))

    def needed_size(self, state: FitState, error: Values | None = None) -> int:
        """The points of a lattice whose own error is a tenth of the squared residual at edges, or what time allows.

        A lattice of N points errs in the area of a straight edge by `.25 c N^-3/4`, rms over all edges of contrast c,
        whose mean variance within a pixel is `c^2 / 6`. A regular grid that is known has no error of its own. Fewer
        points do where they move the estimate by no more than a hundredth of its squared `error`.
        """
        if self.problem.samples is not None:
            return 0
        root = on_host(state.problem.observation.root_weight)[:, self.row, self.column]
        within = float(np.sum(self.variance * root**2)) * 6 * 0.25**2
        left = float(np.sum(np.asarray(state.residual)[:, self.row, self.column] ** 2))
        ratio = 10 * within / max(left, TINY)
        if error is not None and np.all(error > 0):
            pull = pulls(self.problem, self.jacobian, error)[:, :, self.row, self.column]
            ratio = min(ratio, 100 * 6 * 0.25**2 * float(np.max(np.sum(pull**2 * self.variance, axis=(1, 2)))))
        return lattice_size(ratio ** (2 / 3), most=2e7 / max(len(self.row), 1))

    @functools.cached_property
    def mean(self) -> Image:
        """The picture at the place, before the film."""
        return on_host(self.radiance.image)

    @property
    def weighted_variance(self) -> Image:
        """The variance within each pixel, in the unit of a squared residual; 0 where it is not listed."""
        root = on_host(self.problem.observation.root_weight)
        variance = np.zeros(root.shape)
        variance[:, self.row, self.column] = self.variance
        return variance * root**2

    @property
    def jump(self) -> Float[np.ndarray, " listed"]:
        """The change of a listed pixel when one of its samples changes sides of an edge, all channels together.

        It is `c / N` of `N` samples, where `c` is the contrast of the edge, which the variance tells: within a pixel
        with a fraction `f` on one side it is `c^2 f (1 - f)`, whose mean over `f` is `c^2 / 6`. It is 0 where there is
        no edge that counts, or the pixel has no weight.
        """
        jump = np.sqrt(6 * np.sum(self.variance * self.seen, axis=0)) / len(self.offsets)
        # Below a tenth of the strongest contrast it is smooth shading and no edge.
        return np.where(jump > 0.1 * np.max(jump, initial=TINY), jump, 0.0)

    @property
    def seen(self) -> Bool[np.ndarray, "3 listed"]:
        """Which numbers of the listed pixels have a weight."""
        return self.problem.observation.seen[:, self.row, self.column]

    def confusion(self) -> Covariance | None:
        """Covariance of unknowns whose pictures are the same; None where the target's samples are no known grid.

        It is `D D^T` of steps in conjugate directions, each as long as it takes to tell two places apart. The mean of a
        pixel's samples changes in jumps `j`, one each time an edge crosses a sample. Over a step `d` it changes by
        `J d` on average, so that `|J d| / j` samples of the pixel change sides. Their sum over the listed pixels is
        `m(d)`. Two places `d` apart are told apart where `m(d)` is the number `p` of unknowns, one sample for each. `m`
        grows in proportion to the length of `d`: along a direction `u` that is the step `u p / m(u)`.

        The directions are `p` conjugate ones of `M = sum J J^T / j^2`: eigenvectors of `M` with each unknown in units
        of its own slope, so that they do not depend on its unit.
        """
        if self.problem.samples is None:
            return None
        jump = self.jump
        jumps = jump > 0
        slopes = (self.jacobian[:, :, self.row, self.column] * self.seen)[:, :, jumps] / np.maximum(jump[jumps], TINY)
        count = len(slopes)
        flat = slopes.reshape(count, -1)
        length = np.sqrt(np.maximum(np.sum(flat**2, axis=1), TINY))
        _, axes = np.linalg.eigh((flat @ flat.T) / np.outer(length, length))
        # `crossed` is m(u) of each direction u, the rows of `axes.T / length`.
        moved = np.tensordot(axes.T / length, slopes, 1)
        crossed = np.sum(np.linalg.norm(moved, axis=1), axis=1)
        apart = axes / length[:, None] * (count / np.maximum(crossed, TINY))
        return apart @ apart.T


def pulls(problem: Problem, jacobian: PixelJacobian, error: Values) -> PixelJacobian:
    """How far each number of a picture pulls the unknowns per unit of light, in their errors: `J^+ / error`."""
    root = on_host(problem.observation.root_weight)
    flat = (jacobian * root).reshape(len(jacobian), -1)
    pull = solve_normal(flat @ flat.T, flat) / np.maximum(error, TINY)[:, None]
    return pull.reshape(jacobian.shape) * root


def resampled(
    problem: Problem,
    y: Vector,
    stage: Stage,
    size: int,
    coarse: Images | None = None,
    noise: float = 0.0,
) -> ResampledPicture:
    """The picture of n x n samples a pixel, or of a lattice of `size` points, near `y`.

    Args:
        coarse: `COARSE_SAMPLES` samples a pixel and side at `y`, if they are known.
        noise: standard deviation of the weighted residuals: pixels that are off by far less are not sampled.
    """
    aware, radiance, samples = problem.picture(y, stage.edges), problem.radiance(y, stage.edges), problem.samples
    coarse_mean, _ = coarse or point_sampled(problem, y, COARSE_SAMPLES)
    # Everywhere: a parabola through the pixel's centre and the mean of its coarse samples.
    center, _ = point_sampled(problem, y, 1)
    # The mean of n x n samples of a parabola lies above its centre by 1 - 1/n^2 of what the mean over the pixel does.
    bend = (coarse_mean - center) / (1 - 1 / COARSE_SAMPLES**2)
    mean = center + (1 - 1 / samples**2 if samples is not None else 1) * bend
    # List the pixels in which that may fail, or where the edge-aware picture differs: these are sampled as the target.
    # A ten-thousandth is a fortieth of a step of 8 bits; half and double leave the same error. A tenth of the noise is
    # a hundredth of its square. Elsewhere the parabola lacks what is of fourth order, far below the square of that.
    image = problem.apply_response(coarse_mean, y)
    off = np.maximum(np.abs(coarse_mean - center), np.abs(image - np.asarray(aware.image)))
    root = on_host(problem.observation.root_weight)
    is_varied = np.any(off * root > np.maximum(1e-4 * problem.observation.light_unit * root, 0.1 * noise), axis=0)
    # An edge that cuts no more than a corner of a pixel is not seen by few samples, but by footprints.
    assert aware.sees_edge is not None
    row, column = np.nonzero(is_varied | aware.sees_edge)
    offsets = lattice_offsets(size) if samples is None else sample_offsets(samples)
    mean[:, row, column], variance = pixel_moments(problem, y, column, row, offsets)
    place, jacobian = on_host(y), on_host(aware.jacobian)
    radiance = PredictedPicture(problem.array(mean), radiance.jacobian)
    return ResampledPicture(problem, offsets, place, radiance, jacobian, row, column, variance)
