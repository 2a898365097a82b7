"""Samples within pixels: the bias of an edge-aware picture, and detection of a target's sampling."""

import threading
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from raytrace_jax.images.jpeg import JpegStorage
from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.unknowns import AnyArray, Image, Mask, Vector
from raytrace_jax.scene.scene import Scene, map_scenes
from raytrace_jax.scene.setting_words import MAX_SAMPLES
from raytrace_jax.tracer.pixels import sample_offsets


class Moments(NamedTuple):
    """Mean and variance of the samples within each pixel, before the film."""

    mean: Float[np.ndarray, "3 *pixels"]
    variance: Float[np.ndarray, "3 *pixels"]


def supersampled(problem: Problem, y: Vector, samples: int) -> Image:
    """The picture at `y` with so many point samples a pixel and side."""
    return developed(problem, y, point_sampled(problem, y, samples).mean)


def point_sampled(problem: Problem, y: Vector, samples: int) -> Moments:
    """Mean and variance of so many point samples a pixel and side, of all of the target's pixels."""
    moments = pixel_moments(problem, problem.scene_at(y), *problem.all_pixels(), sample_offsets(samples))
    return Moments(*(part.reshape(problem.observation.target.shape) for part in moments))


def pixel_moments(
    problem: Problem,
    scene: Scene,
    column: Int[np.ndarray, " pixels"],
    row: Int[np.ndarray, " pixels"],
    offsets: Float[np.ndarray, "samples 2"],
) -> Moments:
    """Mean and variance of the point samples at these offsets within each of some of the target's pixels."""
    scenes = map_scenes(lambda x: np.asarray(x)[None], scene)
    total, squares = np.zeros((2, 3, len(column)))
    # Some at a time, so that columns and rows take at most 16 MB.
    for some in np.array_split(offsets, max(1, offsets.size * len(column) // 1_000_000)):
        right, down = some.T[:, :, None]
        points = problem.picture_points((column + right).reshape(-1), (row + down).reshape(-1))
        colors = problem.model.points(scenes, points, problem.base).astype(np.float64)
        colors = colors.reshape(3, len(some), len(column))
        total += colors.sum(axis=1)
        squares += np.sum(colors**2, axis=1)
    mean = total / len(offsets)
    return Moments(mean, np.maximum(squares / len(offsets) - mean**2, 0.0))


def developed(problem: Problem, y: Vector, image: Image) -> Image:
    """The developed picture at `y`, from that of the light."""
    return problem.development.image(image, problem.values(y), problem.frame()).astype(np.float64)


COARSE_SAMPLES = 2
"""Samples a pixel and side with which the edge-aware picture is compared everywhere: the fewest that see an edge."""

DISAGREEMENT = 1e-4
"""A pixel is sampled finely where edge-aware picture and coarse samples differ by more in any channel, as a part of the
target's light: a fortieth of a step of 8 bits. Half and double leave the same error, tenfold half as much again or more
(experiments/tuning)."""

LATTICES = (89, 233, 610, 1597)
"""Points of the lattices that a pixel may be sampled with: Fibonacci numbers."""


def lattice_size(least: float = 0, most: float = np.inf) -> int:
    """The points of the smallest lattice that has at least so many; at most `most`, if the first has."""
    sizes = [size for size in LATTICES if size <= most] or [LATTICES[0]]
    return next((size for size in sizes if size >= least), sizes[-1])


def lattice_offsets(size: int) -> Float[np.ndarray, "samples 2"]:
    """Places of so many samples in a pixel, from its middle: a Fibonacci lattice (Niederreiter and Sloan 1994).

    A regular grid of as many errs as much in the area of an edge of any direction, but five times as much where the
    edge is nearly along its rows, and then alike in all pixels of a line of a level board.
    """
    # The Fibonacci number before is this one over the golden ratio, rounded.
    index, step = np.arange(size), round(size * 2 / (1 + 5**0.5))
    return np.stack([(index + 0.5) / size, np.mod(index * step + 0.5, size) / size], axis=1) - 0.5


def disagreement(problem: Problem, y: Vector, aware: Image, coarse: Moments) -> Mask:
    """The pixels where edge-aware picture and coarse samples differ, so that one of them is wrong."""
    return np.abs(developed(problem, y, coarse.mean) - aware).max(axis=0) > DISAGREEMENT * problem.light_unit


def storage_bias(problem: Problem, storage: JpegStorage, picture: Image) -> Image:
    """The change that a lossy file makes to a picture with the target's noise, on average.

    A JPEG keeps few of the finest patterns, and fewer of colours: edges become softer, and colours mix across them.
    Noise decides for many patterns whether they are kept, so that pictures with noise are compressed. It is taken to be
    white in the stored numbers, as the shot noise of a camera nearly is, and as large as the residual's.
    """
    # How large the target's noise is, in the stored numbers.
    observed = problem.observation
    counts = np.asarray(observed.root_weight) > 0
    numbers, target = storage.encode(picture), storage.encode(np.asarray(observed.target, np.float64))
    off = (target - numbers)[:, counts]
    sigma = MAD_TO_SIGMA * np.median(np.abs(off - np.median(off, axis=1, keepdims=True)), axis=1)
    random, total = np.random.default_rng(0), np.zeros_like(picture)
    # The noise that is left in a mean of 16 adds a sixteenth to the target's variance.
    draws = 16
    for _ in range(draws):
        total += storage.compress(numbers + sigma[:, None, None] * random.normal(size=picture.shape))
    return total / draws - picture


GRIDS = (*range(1, 17), 20)
"""Samples a pixel and side that are tried. Means of more are those over the pixel, for all that a fit can tell."""


def detect_grid(
    problem: Problem, y: Vector, coarse: Moments, jacobian: Float[AnyArray, "parameters 3 height width"]
) -> int | None:
    """The samples a pixel and side of the regular grid whose means the target's pixels are; None if no grid stands out.

    Pictures of several grids are compared with the target, in some pixels whose inside varies, beside those of a
    lattice and of a finer grid, which stand for the mean over the pixel. The right grid is nearer to the target than
    any other picture in most pixels (a sign test: the few in which a sample lies beyond an edge, since the unknowns are
    those of an edge-aware picture, would rule sums of squares). What a step of the unknowns explains of a residual is
    taken off first: it would hide which grid is right. Of a painted board, 512 x 384, it was 2.4 times as much as what
    told 8 samples from 7.
    """
    target, root = np.asarray(problem.observation.target), np.asarray(problem.observation.root_weight)
    variance = np.where(root > 0, coarse.variance.max(axis=0), 0.0)
    row, column = np.nonzero(variance > 0.1 * np.max(variance))
    # If the film mixes pixels, a few of them tell nothing.
    if not len(column) or problem.film_reach(y) > 0:
        return None
    scene, order = problem.scene_at(y), np.random.default_rng(0).permutation(len(row))
    derivative = np.asarray(jacobian, np.float64)[:, :, row, column]

    def residual(offsets: Float[np.ndarray, "samples 2"], some: Int[np.ndarray, " some"]) -> np.ndarray:
        light, (where, at) = np.zeros(target.shape), (row[some], column[some])
        light[:, where, at] = pixel_moments(problem, scene, at, where, offsets).mean
        off = (developed(problem, y, light) - target)[:, where, at] * root[where, at]
        slopes = derivative[:, :, some].reshape(len(derivative), -1).T
        return off - (slopes @ np.linalg.lstsq(slopes, off.reshape(-1))[0]).reshape(off.shape)

    # A few pixels leave a grid or two to be told by many. Of another target half of the pixels are nearer, and 0.6 of
    # 512 by a chance of 1e-5. Where noise makes it less of a right grid, that grid would tell little.
    clearly, tried = 0.6, [*GRIDS]
    for count in (64, 512):
        some = order[:count]
        finer = [np.sum(residual(offsets, some) ** 2, axis=0) for offsets in (lattice_offsets(610), sample_offsets(24))]
        distances = {n: np.sum(residual(sample_offsets(n), some) ** 2, axis=0) for n in tried}
        tried = [n for n in tried if all(np.mean(distances[n] < other) > clearly for other in finer)]
        if not tried:
            return None
    told = [
        n for n in tried if all(np.mean(distances[n] < distances[other]) > clearly for other in tried if other != n)
    ]
    return told[0] if told else None


Sampling = Literal["box", "point"]


def cached_detection(problem: Problem) -> Callable[[Vector], Sampling]:
    """`detect_sampling` of a problem, computed once for each place: a thread that asks meanwhile waits."""
    lock, found = threading.Lock(), dict[bytes, Sampling]()

    def detect(y: Vector) -> Sampling:
        with lock:
            key = np.asarray(y).tobytes()
            if key not in found:
                found[key] = detect_sampling(problem, y)
            return found[key]

    return detect


def detect_sampling(problem: Problem, y: Vector) -> Sampling:
    """The target's sampling: that of the kind of picture which is nearer to it on average, near the answer.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples = problem.base.samples

    def distance(samples: int) -> float:
        return float(np.mean(np.abs(problem.residual(supersampled(problem, y, samples)))))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"
