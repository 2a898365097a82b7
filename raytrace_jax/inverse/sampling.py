"""Samples within pixels: the bias of an edge-aware picture, and detection of a target's sampling."""

import threading
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from raytrace_jax.images.jpeg import JpegStorage
from raytrace_jax.inverse.problem import Problem
from raytrace_jax.inverse.uncertainty import MAD_TO_SIGMA
from raytrace_jax.inverse.unknowns import AnyArray, Image, Mask, Vector
from raytrace_jax.scene.scene import Scene, map_scenes
from raytrace_jax.scene.setting_words import MAX_SAMPLES
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY


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

LATTICES = ((89, 55), (233, 144), (610, 377), (1597, 987))
"""Neighbouring Fibonacci numbers, whose lattices cover a square evenly."""


def lattice_size(least: float = 0, most: float = np.inf) -> int:
    """The points of the smallest lattice that has at least so many; at most `most`, if the first has."""
    sizes = [size for size, _ in LATTICES if size <= most] or [LATTICES[0][0]]
    return next((size for size in sizes if size >= least), sizes[-1])


def lattice_offsets(size: int) -> Float[np.ndarray, "samples 2"]:
    """Places of so many samples in a pixel, from its middle: a Fibonacci lattice (Niederreiter and Sloan 1994).

    A regular grid of as many errs as much in the area of an edge of any direction, but five times as much where the
    edge is nearly along its rows, and then alike in all pixels of a line of a level board.
    """
    index = np.arange(size)
    step = dict(LATTICES)[size]
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


GRIDS = (*range(1, 17), 20, 24, 32, 40)
"""Samples a pixel and side that are tried: those that renderers are asked for, and those of binned targets."""


def detect_grid(
    problem: Problem, y: Vector, coarse: Moments, jacobian: Float[AnyArray, "parameters 3 height width"]
) -> int | None:
    """The samples a pixel and side of the regular grid whose means the target's pixels are; None if no grid stands out.

    Pictures of several grids are compared with the target, in some pixels whose inside varies, beside one of a lattice,
    which stands for the mean over the pixel. If the target `t` is the picture `a` and noise, then another picture `b`
    is farther away: `|b - t|^2 - |a - t|^2` is `|a - b|^2` on average. So the difference of the two sums of squares is
    measured in units of the squares between the two pictures: it is 1 where `a` is the target's grid, -1 where `b` is.
    What a step of the unknowns explains of a residual is taken off first: these unknowns are those of an edge-aware
    picture, and what they are off by would hide which grid is right. Of a painted board, 512 x 384, it was 2.4 times as
    much as what told 8 samples from 7.
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

    # A few pixels leave few grids, mostly none or one; 1024 tell it under noise of .05, which 128 did not.
    tried, found, most = list(GRIDS), np.zeros((0, 3, 0)), 1024
    for count in (64, most):
        some = order[:count]
        found = np.array([residual(sample_offsets(samples), some) for samples in tried])
        whole = residual(lattice_offsets(233), some)
        nearer, error = nearness(found, whole)
        # The right grid at the truth has 1; unknowns 1e-4 off leave it 0.4. What no number of pixels can tell is out.
        kept = (nearer + 4 * error > 0.3) & (5 * error < np.sqrt(most / count))
        tried, found = [n for n, one in zip(tried, kept, strict=True) if one], found[kept]
        if not tried:
            return None
    best = int(np.argmin(np.sum(found**2, axis=(1, 2))))
    nearer, error = nearness(found[best][None], np.concatenate([np.delete(found, best, axis=0), whole[None]]))
    return tried[best] if np.all(nearer > np.maximum(0.3, 5 * error)) else None


def nearness(
    one: Float[np.ndarray, "*#pictures 3 pixels"], other: Float[np.ndarray, "*#pictures 3 pixels"]
) -> tuple[Float[np.ndarray, " pictures"], Float[np.ndarray, " pictures"]]:
    """The ratio of sums that `detect_grid` explains, by residuals of two pictures, and its standard error."""
    between = np.sum((one - other) ** 2, axis=-2)
    gain = np.sum(other**2, axis=-2) - np.sum(one**2, axis=-2)
    length = np.maximum(between.sum(axis=-1), TINY)
    nearer = gain.sum(axis=-1) / length
    return nearer, np.linalg.norm(gain - nearer[..., None] * between, axis=-1) / length


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
