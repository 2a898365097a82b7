"""The picture of samples like the target's, and steps on it with the derivative of the edge-aware one."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.observe.noise import explains
from raytrace_jax.inverse.observe.sampling import (
    COARSE_SAMPLES,
    Moments,
    disagreement,
    lattice_offsets,
    lattice_size,
    pixel_moments,
    point_sampled,
    storage_bias,
)
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.forward import PredictedPicture
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.problem.unknowns import Covariance, Image, PixelJacobian, Values, Vector
from raytrace_jax.inverse.solve.solvers import gauss_newton
from raytrace_jax.inverse.solve.steps import Recorder, shorten_step
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY, finite_or_last


@dataclasses.dataclass(frozen=True)
class ResampledPicture:
    """Means of samples in each pixel, for unknowns so near a place that no edge leaves the listed pixels.

    Args:
        samples: samples a pixel and side of the target's regular grid; None for means over pixels, of a lattice.
        offsets: where in a pixel they lie.
        jacobian: derivative of the edge-aware picture there, after the film, by the unknowns.
    """

    problem: Problem
    samples: int | None
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
        step = (np.asarray(y, np.float64) - self.y)[list(self.problem.unknowns.traced)]
        image = self.mean + np.tensordot(step, np.asarray(self.radiance.jacobian, np.float64), 1)
        problem = self.problem
        sampled = pixel_moments(problem, problem.scene_at(y), self.column, self.row, self.offsets)
        image[:, self.row, self.column] = sampled.mean
        radiance = PredictedPicture(problem.array(image), self.radiance.jacobian)
        found = problem.development.picture(radiance, y, problem.frame())
        if problem.storage is None:
            return found
        whole = np.asarray(found.image, np.float64)
        stored = problem.array(whole + storage_bias(problem, problem.storage, whole))
        return dataclasses.replace(found, image=stored)

    def state(self, problem: Problem, y: Vector, stage: Stage) -> FitState:
        """The state of a fit there, whose problem may weigh pixels otherwise."""
        return FitState(problem, y, stage, problem.linearize_picture(self.at(y), y, stage))

    @functools.cached_property
    def mean(self) -> Image:
        """The picture at the place, before the film."""
        return np.asarray(self.radiance.image, np.float64)

    @property
    def jump(self) -> Float[np.ndarray, " listed"]:
        """The change of a listed pixel when one of its samples changes sides of an edge, all channels together.

        It is 0 where there is no edge that counts, or the pixel has no weight.
        """
        root = np.asarray(self.problem.observation.root_weight, np.float64)[self.row, self.column]
        # What varies less than a tenth of the strongest edge may do so smoothly.
        jump = self.any_jump
        return np.where((jump > 0.1 * np.max(jump, initial=TINY)) & (root > 0), jump, 0.0)

    @property
    def any_jump(self) -> Float[np.ndarray, " listed"]:
        """The change of a listed pixel when one of its samples changes sides, however weak its edge is.

        It is `c / N` of `N` samples, where `c` is the contrast of the edge, which the variance tells: within a pixel
        with a fraction `f` on one side it is `c^2 f (1 - f)`.
        """
        # The mean of `f (1 - f)` is 1/6 where any fraction `f` of the pixel is as likely.
        return np.sqrt(self.variance.sum(axis=0) / (1 / 6)) / len(self.offsets)

    @functools.cached_property
    def is_along(self) -> Bool[np.ndarray, " listed"]:
        """Listed pixels that see an edge along the grid, or are beside one: a line of a board before a level camera.

        All samples of a row or column change sides of such an edge at once. Such a pixel is known by its two neighbours
        along the edge, which have its colour. A pixel whose edge lies just beyond the last samples is known by them
        too. Where two lines meet, a pixel has no such neighbours; it counts because a pixel beside it has.
        """
        tolerance = self.any_jump / 2 + 1e-3 * np.max(self.any_jump, initial=TINY)
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
        """The problem that leads steps, in which edges along a grid hardly count.

        Such an edge tells a place only in large jumps. The edge-aware derivative takes it to move with every step, so
        that it would hold the step where it is.
        """
        if self.samples is None:
            return self.problem
        weight = np.ones(self.mean.shape[1:])
        # All of them, some thousands, count less than one other pixel, and still determine what nothing else does.
        weight[self.row[self.is_along], self.column[self.is_along]] = 1e-6
        return self.problem.weighted(weight)

    def resolution(self) -> Covariance:
        """Covariance of unknowns whose pictures are the same: that of `apart`; 0 where the target has other samples."""
        return self.apart @ self.apart.T if self.samples is not None else np.zeros((len(self.y),) * 2)

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
        slopes = self.jacobian[:, :, self.row, self.column][:, :, seen] / np.maximum(jump[seen], TINY)
        count = len(slopes)
        flat = slopes.reshape(count, -1)
        length = np.sqrt(np.maximum(np.sum(flat**2, axis=1), TINY))
        _, axes = np.linalg.eigh((flat @ flat.T) / np.outer(length, length))
        # `crossed` is m(u) of each direction u, the rows of `axes.T / length`.
        moved = np.tensordot(axes.T / length, slopes, 1)
        crossed = np.sum(np.linalg.norm(moved, axis=1), axis=1)
        return axes / length[:, None] * (count / np.maximum(crossed, TINY))


def resampled(
    problem: Problem, y: Vector, stage: Stage, samples: int | None, size: int, coarse: Moments | None = None
) -> ResampledPicture:
    """The picture of n x n samples a pixel, or of a lattice of `size` points, near `y`.

    Args:
        coarse: `COARSE_SAMPLES` samples a pixel and side at `y`, if they are known.
    """
    aware, radiance = problem.picture(y, stage.edges), problem.radiance(y, stage.edges)
    if coarse is None:
        coarse = point_sampled(problem, y, COARSE_SAMPLES)
    # Everywhere: a parabola through the pixel's centre and the mean of its coarse samples.
    center = point_sampled(problem, y, 1).mean
    # The mean of n x n samples of a parabola lies above its centre by 1 - 1/n^2 of what the mean over the pixel does.
    bend = (coarse.mean - center) / (1 - 1 / COARSE_SAMPLES**2)
    mean = center + (1 - 1 / samples**2 if samples is not None else 1) * bend
    # List the pixels in which that may fail, and sample these as the target is.
    # Elsewhere the parabola lacks what is of fourth order, far below the square of a ten-thousandth.
    is_varied = np.abs(coarse.mean - center).max(axis=0) > 1e-4 * problem.light_unit
    is_varied |= disagreement(problem, y, np.asarray(aware.image), coarse)
    # An edge that cuts no more than a corner of a pixel is not seen by few samples, but by footprints.
    assert aware.sees_edge is not None
    row, column = np.nonzero(is_varied | aware.sees_edge)
    offsets = lattice_offsets(size) if samples is None else sample_offsets(samples)
    moments = pixel_moments(problem, problem.scene_at(y), column, row, offsets)
    mean[:, row, column] = moments.mean
    place, jacobian = np.asarray(y, np.float64), np.asarray(aware.jacobian, np.float64)
    radiance = PredictedPicture(problem.array(mean), radiance.jacobian)
    return ResampledPicture(problem, samples, offsets, place, radiance, jacobian, row, column, moments.variance)


def settle(
    problem: Problem, solution: FitState, samples: int | None, recorder: Recorder, coarse: Moments | None = None
) -> FitState:
    """Take steps on the picture of samples like the target's; the edge-aware derivative leads.

    That picture has no derivative of use: it changes only where an edge crosses a sample, and then in a jump. But on
    average it changes as the area on one side of the edge does, whose derivative is the edge-aware one. So each step
    leads to where few samples are on the wrong side, and the next one ends nearer: a step with the derivative `A'` of a
    picture that changes by `S'` leaves `1 - A'^+ S'` of the error. A step samples the pixels at edges anew, which is
    cheap beside a derivative.

    Args:
        samples: samples a pixel and side of the target's regular grid. Without one its pixels are taken for means of
            samples of its own, and ours are as many as it takes for their error to be a small part of the residual.
        coarse: `COARSE_SAMPLES` samples a pixel and side at the solution, if they are known.
    """
    stage, size = solution.stage, lattice_size()
    whose = "a supersampled picture" if samples is None else "a picture of the target's own samples"
    recorder.phase(f"comparing with {whose}")
    picture = resampled(problem, solution.y, stage, samples, size, coarse)
    lowest = descend(picture, picture.leading, solution.y, stage, recorder)
    # Go on from there with more samples, or with another derivative and list of pixels, which hold up to a tenth of a
    # pixel of a large ball. What is not explained will not be explained by them.
    for _ in range(3):
        wanted = size if samples is not None else max(size, needed_size(picture, lowest))
        moved = problem.scaled_distance(problem.values(lowest.y), problem.values(problem.array(picture.y)))
        if not (moved >= 1e-3 or wanted > size) or not explains(lowest):
            break
        recorder.phase(f"comparing with {whose}")
        size = wanted
        if moved >= 1e-3:
            picture = resampled(problem, lowest.y, stage, samples, size)
        else:
            picture = dataclasses.replace(picture, offsets=lattice_offsets(size))
        lowest = descend(picture, picture.leading, lowest.y, stage, recorder)
    if samples is not None and not is_told(picture, lowest):
        # Place what the derivative cannot lead, and hold it there while that leads the others.
        start = look_around(picture, lowest, stage)
        picture = resampled(problem, start, stage, samples, size)
        lowest = descend(picture, picture.problem, start, stage, recorder)
    # The solution there has the edge-aware picture and its bias.
    aware = problem.picture(lowest.y, stage.edges)
    corrected = problem.with_bias(np.asarray(lowest.linearization.image) - np.asarray(aware.image))
    linearization = corrected.linearize(lowest.y, stage)
    return dataclasses.replace(
        lowest,
        problem=corrected,
        linearization=linearization,
        settled=lowest.settled and linearization.is_finite,
        target_samples=samples,
        resolution=lowest.resolution + picture.resolution() if lowest.resolution is not None else None,
    )


def descend(picture: ResampledPicture, problem: Problem, y: Vector, stage: Stage, recorder: Recorder) -> FitState:
    """The best place of Gauss-Newton steps from `y`, with the derivative of the list's place.

    Args:
        problem: its weights lead: those of `picture.leading`, or all to hold what edges along the grid tell.
    """
    start = picture.state(problem, problem.array(y), stage)
    return gauss_newton(start, lambda y: picture.state(problem, y, stage), recorder.step)


def needed_size(picture: ResampledPicture, state: FitState) -> int:
    """The points of a lattice whose own error is a tenth of the squared residual at edges, or as many as time allows.

    A lattice of N points errs in the area of a straight edge by `.25 c N^-3/4`, rms over all edges of contrast c, whose
    mean variance within a pixel is `c^2 / 6`.
    """
    root = np.asarray(state.problem.observation.root_weight, np.float64)[picture.row, picture.column]
    within = float(np.sum(picture.variance * root**2)) * 6 * 0.25**2
    seen = float(np.sum(np.asarray(state.residual)[:, picture.row, picture.column] ** 2))
    return lattice_size((10 * within / max(seen, TINY)) ** (2 / 3), most=2e7 / max(len(picture.row), 1))


def is_told(picture: ResampledPicture, state: FitState) -> bool:
    """Whether the next step is so short that a few samples on the wrong side of edges may make it."""
    if state.next_move < 2:
        return True
    spread = np.sqrt(np.maximum(np.diagonal(picture.resolution()), 0))
    step = np.sqrt(np.diagonal(state.resolution)) if state.resolution is not None else np.full_like(spread, np.inf)
    # A few samples make steps to and fro of 2.5 resolutions on a large board.
    return bool(np.all(step < 5.0 * spread))


def look_around(grid: ResampledPicture, lowest: FitState, stage: Stage) -> Vector:
    """The best of places around one where steps with the derivative end above what is there.

    Lines of a board that are parallel to the rows change sides all at once: the derivative of areas leads nowhere. So
    places along the directions in which the picture tells places apart are tried by their costs alone, at several
    lengths, one direction after the other, twice at most (a pattern search, Hooke and Jeeves 1961).
    """
    problem = grid.problem

    def at(y: Values) -> FitState:
        place = problem.array(shorten_step(problem, lowest.y, y))
        return grid.state(problem, place, stage)

    best = at(np.asarray(lowest.y))
    for _ in range(2):
        before = best
        for direction in grid.apart.T:
            tried = [at(np.asarray(best.y) + length * direction) for length in (-2.0, -0.5, 0.5, 2.0)]
            best = min([best, *tried], key=lambda state: finite_or_last(state.linearization.cost))
        if best is before:
            break
    return best.y
