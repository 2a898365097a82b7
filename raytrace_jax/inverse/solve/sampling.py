"""Point samples within pixels, and what an edge-aware picture lacks of the mean of many of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.images.jpeg_compression import JpegStorage
from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import map_scenes
from raytrace_jax.tracer.programs.tiles import sample_offsets

MOST_POINTS = 1_000_000
"""About as many are listed at once: 16 MB of columns and rows."""


class Moments(NamedTuple):
    """What samples within pixels come to, before the film.

    Args:
        mean: of each pixel and channel.
        variance: the same, over the pixel's samples.
    """

    mean: Float[np.ndarray, "3 *pixels"]
    variance: Float[np.ndarray, "3 *pixels"]


def supersampled(problem: Problem, y: Float[Array, " parameters"], samples: int) -> Float[np.ndarray, "3 height width"]:
    """The picture at `y` with so many point samples a pixel and side."""
    return developed(problem, y, point_sampled(problem, y, samples).mean)


def point_sampled(problem: Problem, y: Float[Array, " parameters"], samples: int) -> Moments:
    """Mean and variance of so many point samples a pixel and side, of all of the target's pixels."""
    column, row = all_pixels(problem)
    moments = pixel_moments(problem, problem.scene_at(y), column, row, sample_offsets(samples))
    return Moments(*(part.reshape(problem.observation.target.shape) for part in moments))


def prepare_point_sampled(problem: Problem, y: Float[Array, " parameters"]) -> None:
    """Plan and compile what `point_sampled` will run, and run nothing."""
    problem.model.prepare_points(problem.scene_at(y), problem.places(*all_pixels(problem)), problem.base)


def all_pixels(problem: Problem) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"]]:
    """Columns and rows of all of the target's pixels, in their order."""
    _, height, width = problem.observation.target.shape
    row, column = np.divmod(np.arange(height * width), width)
    return column, row


def pixel_moments(
    problem: Problem,
    scene: Scene,
    column: Int[np.ndarray, " pixels"],
    row: Int[np.ndarray, " pixels"],
    offsets: Float[np.ndarray, "samples 2"],
) -> Moments:
    """Mean and variance over some of the target's pixels, of point samples at these offsets from each."""
    scenes = map_scenes(lambda x: np.asarray(x)[None], scene)
    total, squares = np.zeros((2, 3, len(column)))
    for some in np.array_split(offsets, max(1, offsets.size * len(column) // MOST_POINTS)):
        right, down = some.T[:, :, None]
        points = problem.places((column + right).reshape(-1), (row + down).reshape(-1))
        colors = problem.model.points(scenes, points, problem.base).reshape(3, -1, len(column)).astype(np.float64)
        total += colors.sum(axis=1)
        squares += np.sum(colors**2, axis=1)
    mean = total / len(offsets)
    return Moments(mean, np.maximum(squares / len(offsets) - mean**2, 0.0))


def developed(
    problem: Problem, y: Float[Array, " parameters"], image: Float[np.ndarray, "3 height width"]
) -> Float[np.ndarray, "3 height width"]:
    """What the film at `y` makes of a picture of the light."""
    return problem.development.image(image, problem.values(y), problem.frame()).astype(np.float64)


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


COMPRESSED = 16
"""Pictures with noise that are compressed for the bias of a JPEG: what they leave of their own noise adds a sixteenth
to the target's variance."""


def disagreement(
    problem: Problem, y: Float[Array, " parameters"], aware: Float[np.ndarray, "3 height width"], coarse: Moments
) -> Bool[np.ndarray, "height width"]:
    """The pixels where edge-aware picture and coarse samples differ, so that one of them is wrong."""
    return np.abs(developed(problem, y, coarse.mean) - aware).max(axis=0) > DISAGREEMENT


def correct(
    problem: Problem, y: Float[Array, " parameters"], comparison: Comparison, roughly: bool = False
) -> tuple[Problem, Moments]:
    """The problem with the bias of its edge-aware picture at `y`, so that both add up to the mean over each pixel.

    An edge-aware picture errs where its model of an edge is too simple, one of a few samples where anything happens
    between them. Where the two agree both are right; the other pixels, about one in four of a small picture and one in
    twelve of a large one, are sampled so finely that what is left of the error is a fifth of the error bars of a
    target with noise of 1/255. The bias of a lossy file is added.

    Args:
        problem: what is fitted.
        y: the unknowns.
        comparison: how edge-aware picture and target are compared.
        roughly: whether a finer correction follows.

    Returns:
        The problem, and mean and variance of the samples in each pixel.
    """
    aware = np.asarray(problem.linearize(y, comparison).image)
    moments = point_sampled(problem, y, COARSE_SAMPLES)
    row, column = np.nonzero(disagreement(problem, y, aware, moments))

    fits = (n for n in FINE_SAMPLES if len(row) * n**2 <= MOST_RAYS)
    samples = FINE_SAMPLES[-1] if roughly else next(fits, FINE_SAMPLES[-1])
    fine = pixel_moments(problem, problem.scene_at(y), column, row, sample_offsets(samples))
    for part, some in zip(moments, fine, strict=True):
        part[:, row, column] = some
    whole = developed(problem, y, moments.mean)
    bias = whole - aware
    if problem.storage is not None:
        bias += storage_bias(problem, problem.storage, whole)
    return problem.with_bias(bias), moments


def storage_bias(
    problem: Problem, storage: JpegStorage, picture: Float[np.ndarray, "3 height width"]
) -> Float[np.ndarray, "3 height width"]:
    """By how much a lossy file changes a picture with the target's noise, on average.

    A JPEG keeps few of the finest patterns, and fewer of colours: edges become softer, and colours mix across them.
    Noise decides for many patterns whether they are kept, so that pictures with noise are compressed. It is taken to be
    white in the stored numbers, as the shot noise of a camera nearly is, and as large as the residual's.

    Args:
        problem: has the target.
        storage: how its file compresses.
        picture: what is thought to have been compressed.
    """
    observed = problem.observation
    counts = np.asarray(observed.root_weight) > 0
    numbers, target = storage.encode(picture), storage.encode(np.asarray(observed.target, np.float64))
    off = (target - numbers)[:, counts]
    sigma = MAD_TO_SIGMA * np.median(np.abs(off - np.median(off, axis=1, keepdims=True)), axis=1)
    random, total = np.random.default_rng(0), np.zeros_like(picture)
    for _ in range(COMPRESSED):
        total += storage.compress(numbers + sigma[:, None, None] * random.normal(size=picture.shape))
    return total / COMPRESSED - picture
