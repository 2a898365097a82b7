"""The picture of a target's own grid of samples, and steps on it, to where the fewest lie beyond an edge."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.forward import PredictedPicture
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem import FitState, Problem
from raytrace_jax.inverse.sampling import COARSE_SAMPLES, Moments, disagreement, pixel_moments, point_sampled
from raytrace_jax.inverse.solvers import FARTHEST, REST, gauss_newton_step, move_in_errors
from raytrace_jax.inverse.steps import Recorder, Step, iterate, project_gradient, shorten_step
from raytrace_jax.inverse.unknowns import Covariance, Image, PixelJacobian, Values, Vector
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY, finite_or_last


@dataclasses.dataclass(frozen=True)
class GridPicture:
    """Means of n x n samples a pixel, for unknowns so near a place that no edge leaves the listed pixels.

    Args:
        jacobian: derivative of the edge-aware picture there, after the film, by the unknowns.
    """

    problem: Problem
    samples: int
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
        problem, offsets = self.problem, sample_offsets(self.samples)
        sampled = pixel_moments(problem, problem.scene_at(y), self.column, self.row, offsets)
        image[:, self.row, self.column] = sampled.mean
        radiance = PredictedPicture(self.problem.array(image), self.radiance.jacobian)
        return self.problem.development.picture(radiance, y, self.problem.frame())

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

        It is `c / n^2`, where `c` is the contrast of the edge, which the variance tells: within a pixel with a fraction
        `f` on one side it is `c^2 f (1 - f)`.
        """
        # The mean of `f (1 - f)` is 1/6 where any fraction `f` of the pixel is as likely.
        return np.sqrt(self.variance.sum(axis=0) / (1 / 6)) / self.samples**2

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
        """The problem that leads steps, in which edges along the grid hardly count.

        Such an edge tells a place only in large jumps. The edge-aware derivative takes it to move with every step, so
        that it would hold the step where it is.
        """
        weight = np.ones(self.mean.shape[1:])
        # All of them, some thousands, count less than one other pixel, and still determine what nothing else does.
        weight[self.row[self.is_along], self.column[self.is_along]] = 1e-6
        return self.problem.weighted(weight)

    def resolution(self) -> Covariance:
        """Covariance of unknowns whose pictures are the same: that of `apart`."""
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
        slopes = self.jacobian[:, :, self.row, self.column][:, :, seen] / np.maximum(jump[seen], TINY)
        count = len(slopes)
        flat = slopes.reshape(count, -1)
        length = np.sqrt(np.maximum(np.sum(flat**2, axis=1), TINY))
        _, axes = np.linalg.eigh((flat @ flat.T) / np.outer(length, length))
        # `crossed` is m(u) of each direction u, the rows of `axes.T / length`.
        moved = np.tensordot(axes.T / length, slopes, 1)
        crossed = np.sum(np.linalg.norm(moved, axis=1), axis=1)
        return axes / length[:, None] * (count / np.maximum(crossed, TINY))


def grid_picture(problem: Problem, y: Vector, stage: Stage, samples: int, coarse: Moments | None = None) -> GridPicture:
    """The picture of n x n samples a pixel, near `y`.

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
    mean = center + (1 - 1 / samples**2) * bend
    # List the pixels in which that may fail, and sample these as the target is.
    # Elsewhere the parabola lacks what is of fourth order, far below the square of a ten-thousandth.
    is_varied = np.abs(coarse.mean - center).max(axis=0) > 1e-4
    is_varied |= disagreement(problem, y, np.asarray(aware.image), coarse)
    # An edge that cuts no more than a corner of a pixel is not seen by few samples, but by footprints.
    assert aware.sees_edge is not None
    row, column = np.nonzero(is_varied | aware.sees_edge)
    moments = pixel_moments(problem, problem.scene_at(y), column, row, sample_offsets(samples))
    mean[:, row, column] = moments.mean
    place, jacobian = np.asarray(y, np.float64), np.asarray(aware.jacobian, np.float64)
    radiance = PredictedPicture(problem.array(mean), radiance.jacobian)
    return GridPicture(problem, samples, place, radiance, jacobian, row, column, moments.variance)


def settle_on_grid(
    problem: Problem,
    solution: FitState,
    samples: int,
    recorder: Recorder,
    coarse: Moments | None = None,
) -> FitState:
    """Take steps on the picture of the target's n x n samples; the edge-aware derivative leads.

    That picture has no derivative of use: it changes only where an edge crosses a sample, and then in a jump. But on
    average it changes as the area on one side of the edge does, whose derivative is the edge-aware one. So each step
    leads to where few samples are on the wrong side, and the next one ends nearer. A step samples the pixels at edges
    anew, which is cheap beside a derivative.

    Args:
        coarse: `COARSE_SAMPLES` samples a pixel and side at the solution, if they are known.
    """
    stage, start = solution.stage, solution.y
    # Follow the derivative; three lists of pixels at most, each made where the steps with the one before ended.
    lists = 0
    while True:
        recorder.phase("comparing with a picture of the target's own samples")
        grid = grid_picture(problem, start, stage, samples, coarse)
        lowest = descend(grid, grid.leading, stage, recorder)
        # Beyond a tenth of a pixel of a large ball another derivative holds, and edges may have left the listed pixels.
        moved = problem.scaled_distance(problem.values(lowest.y), problem.values(start))
        lists += 1
        if moved < 1e-3 or lists == 3:
            break
        start, coarse = lowest.y, None
    if not lowest.settled:
        # Place what the derivative cannot lead, and hold it there while that leads the others.
        start = look_around(grid, lowest, stage)
        grid = grid_picture(problem, start, stage, samples)
        lowest = descend(grid, grid.problem, stage, recorder)
    # The solution there has the edge-aware picture and its bias.
    aware = problem.picture(lowest.y, stage.edges)
    corrected = problem.with_bias(np.asarray(lowest.linearization.image) - np.asarray(aware.image))
    linearization = corrected.linearize(lowest.y, stage)
    return dataclasses.replace(
        solution,
        problem=corrected,
        y=lowest.y,
        linearization=linearization,
        settled=lowest.settled and linearization.is_finite,
        next_move=lowest.next_move,
        target_samples=grid.samples,
        resolution=grid.resolution(),
    )


def descend(grid: GridPicture, problem: Problem, stage: Stage, recorder: Recorder) -> FitState:
    """The lowest place of Gauss-Newton steps with the derivative of the list's place.

    It is at rest where the next step is about as long as the picture tells places apart.

    Args:
        problem: its weights lead: those of `grid.leading`, or all to hold what edges along the grid tell.
    """
    spread = np.sqrt(np.maximum(np.diagonal(grid.resolution()), 0))

    def at(y: Vector) -> FitState:
        return FitState(problem, y, stage, problem.linearize_picture(grid.at(y), y, stage))

    def look(last: Step[int], y: Vector) -> FitState:
        return last.best if y is last.best.y else at(y)

    def propose(last: Step[int], seen: FitState) -> Step[int]:
        # See whether the step before was worth it.
        lowest, y, linearization = last.best, seen.y, seen.linearization
        is_first = seen is lowest
        is_lowest = is_first or (linearization.is_finite and linearization.cost < lowest.linearization.cost)
        # Of a board with a free field of view ten steps in a row took off 0.1 to 0.3 each; with 0.3 the fit ended at
        # the third, its index off by 2e-4 in place of 1e-5.
        is_worth = is_first or linearization.cost < (1 - 0.1) * lowest.linearization.cost
        in_vain = 0 if is_worth else last.memory + 1
        # Choose the next step; its length decides whether this place is one of rest.
        free = project_gradient(linearization, y, problem.unknowns)
        step, move = gauss_newton_step(free), move_in_errors(free)
        to = problem.array(shorten_step(problem, y, y + step))
        reach = problem.scaled_distance(problem.values(to), problem.values(y))
        # The longest part of the step, in standard deviations of the resolution.
        beside = float(np.max(np.divide(np.abs(step), spread, out=np.full_like(step, np.inf), where=spread > 0)))
        if is_lowest:
            # A few samples on the wrong side of edges make steps to and fro, of 2.5 resolutions on a large board.
            is_at_rest = reach < FARTHEST and (move < REST or beside < 5.0)
            lowest = dataclasses.replace(seen, settled=is_at_rest, next_move=move)
        # End where the next step would tell nothing more, or leaves the neighbourhood in which the derivative holds.
        is_short = move < 0.1 or (in_vain > 0 and beside < 0.3)
        ends = in_vain == 2 or is_short or not 0 < reach < FARTHEST
        return Step(lowest, is_lowest, None if ends else to, in_vain)

    start = at(problem.array(grid.y))
    begin = Step(start, True, start.y, 0)
    # Two or three steps take off most, but a free field of view before a level board wants fifteen.
    return iterate(begin, look, propose, 24, recorder.step)


def look_around(grid: GridPicture, lowest: FitState, stage: Stage) -> Vector:
    """The best of places around one where steps with the derivative end above what is there.

    Lines of a board that are parallel to the rows change sides all at once: the derivative of areas leads nowhere. So
    places along the directions in which the picture tells places apart are tried by their costs alone, at several
    lengths, one direction after the other, twice at most (a pattern search, Hooke and Jeeves 1961).
    """
    problem = grid.problem

    def at(y: Values) -> FitState:
        place = problem.array(shorten_step(problem, lowest.y, y))
        return FitState(problem, place, stage, problem.linearize_picture(grid.at(place), place, stage))

    best = at(np.asarray(lowest.y))
    for _ in range(2):
        before = best
        for direction in grid.apart.T:
            tried = [at(np.asarray(best.y) + length * direction) for length in (-2.0, -0.5, 0.5, 2.0)]
            best = min([best, *tried], key=lambda state: finite_or_last(state.linearization.cost))
        if best is before:
            break
    return best.y
