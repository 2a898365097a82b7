"""What an edge-aware picture lacks of the mean over each pixel, from many samples where they are needed."""

import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import map_scenes
from raytrace_jax.tracer.points import prepare_points, render_points
from raytrace_jax.tracer.tiles import sample_offsets

COARSE_SAMPLES = 2
"""Samples a pixel and side with which the edge-aware picture is compared everywhere: the fewest that see an edge. 3 and
4 leave about the same error (experiments/tuning)."""

DISAGREEMENT = 1e-4
"""Where the two differ by more than this in any channel, one may be wrong: the pixel is sampled finely. A
fortieth of a step of 8 bits: half and double leave the same error, tenfold half as much again or more
(experiments/tuning)."""

FINE_SAMPLES = (32, 24, 16, 12, 8)
"""Samples a pixel and side there: the first of these that costs at most `MOST_RAYS`, roughly the last. Of a small
picture 8 leave a half to two error bars of noise of 1/255, 16 a tenth to a third, 32 a tenth (experiments/tuning)."""

MOST_RAYS = 2e7
"""Camera rays of the finely sampled pixels: those of 640 x 480 pixels at 8 x 8 samples, some seconds of two cores. It
bounds the time, and only chooses among `FINE_SAMPLES`."""

MOST_POINTS = 1_000_000
"""About as many are listed at once: 16 MB of columns and rows."""


def supersampled(problem: Problem, y: Float[Array, " parameters"], samples: int) -> Float[np.ndarray, "3 height width"]:
    """The picture at `y` with so many point samples a pixel and side."""
    return exposed(problem, y, point_sampled(problem, y, samples))


def point_sampled(
    problem: Problem, y: Float[Array, " parameters"], samples: int
) -> Float[np.ndarray, "3 height width"]:
    """The same, not exposed."""
    column, row = all_pixels(problem)
    means = pixel_means(problem, problem.scene_at(y), column, row, sample_offsets(samples))
    return means.reshape(problem.observation.target.shape)


def prepare_point_sampled(problem: Problem, y: Float[Array, " parameters"]) -> None:
    """Plan and compile what `point_sampled` will run, and run nothing."""
    prepare_points(problem.scene_at(y), problem.places(*all_pixels(problem)), problem.base)


def all_pixels(problem: Problem) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"]]:
    """Columns and rows of all of the target's pixels, in their order."""
    _, height, width = problem.observation.target.shape
    row, column = np.divmod(np.arange(height * width), width)
    return column, row


def pixel_means(
    problem: Problem,
    scene: Scene,
    column: Int[np.ndarray, " pixels"],
    row: Int[np.ndarray, " pixels"],
    offsets: Float[np.ndarray, "samples 2"],
) -> Float[np.ndarray, "3 pixels"]:
    """Means over some of the target's pixels, of point samples at these offsets from each."""
    scenes = map_scenes(lambda x: np.asarray(x)[None], scene)
    total = np.zeros((3, len(column)))
    for some in np.array_split(offsets, max(1, offsets.size * len(column) // MOST_POINTS)):
        right, down = some.T[:, :, None]
        points = problem.places((column + right).reshape(-1), (row + down).reshape(-1))
        total += render_points(scenes, points, problem.base).reshape(3, -1, len(column)).sum(axis=1)
    return total / len(offsets)


def exposed(
    problem: Problem, y: Float[Array, " parameters"], image: Float[np.ndarray, "3 *pixels"]
) -> Float[np.ndarray, "3 *pixels"]:
    """A picture, or some pixels of it, with the exposure and the offset at `y`, where these are free."""
    return problem.unknowns.expose(image, problem.values(y))


def correct(problem: Problem, y: Float[Array, " parameters"], comparison: Comparison, roughly: bool = False) -> Problem:
    """The problem with the bias of its edge-aware picture at `y`, so that both add up to the mean over each pixel.

    An edge-aware picture errs where its model of an edge is too simple, one of a few samples where anything happens
    between them. Where the two agree both are right; the other pixels, about one in four of a small picture and one in
    twelve of a large one, are sampled so finely that what is left of the error is a fifth of the error bars of a
    target with noise of 1/255.

    Args:
        problem: what is fitted.
        y: the unknowns.
        comparison: how edge-aware picture and target are compared.
        roughly: whether a finer correction follows.
    """
    aware = np.asarray(problem.linearize(y, comparison).image)
    coarse = max(COARSE_SAMPLES, problem.base.samples)
    mean = point_sampled(problem, y, coarse)
    row, column = np.nonzero(np.abs(exposed(problem, y, mean) - aware).max(axis=0) > DISAGREEMENT)

    fits = (n for n in FINE_SAMPLES if len(row) * n**2 <= MOST_RAYS)
    samples = FINE_SAMPLES[-1] if roughly else next(fits, FINE_SAMPLES[-1])
    offsets = sample_offsets(max(samples, coarse))
    mean[:, row, column] = pixel_means(problem, problem.scene_at(y), column, row, offsets)
    return problem.with_bias(exposed(problem, y, mean) - aware)
