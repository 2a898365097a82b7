"""Samples within pixels: the bias of an edge-aware picture, and detection of a target's sampling."""

import threading
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from raytrace_jax.images.jpeg import JpegStorage
from raytrace_jax.inverse.options import Stage
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
"""A pixel is sampled finely where edge-aware picture and coarse samples differ by more in any channel, a fortieth of a
step of 8 bits. Half and double leave the same error, tenfold half as much again or more (experiments/tuning)."""

FINE_SAMPLES = (32, 24, 16, 12, 8)
"""Samples a pixel and side of a correction, the first that the time allows: of a small picture 8 leave a half to two
error bars of noise of 1/255, 16 a tenth to a third, 32 a tenth (experiments/tuning)."""


def disagreement(problem: Problem, y: Vector, aware: Image, coarse: Moments) -> Mask:
    """The pixels where edge-aware picture and coarse samples differ, so that one of them is wrong."""
    return np.abs(developed(problem, y, coarse.mean) - aware).max(axis=0) > DISAGREEMENT


def correct(problem: Problem, y: Vector, stage: Stage, roughly: bool = False) -> tuple[Problem, Moments]:
    """The problem with the bias of its edge-aware picture at `y`, and the moments of the samples in each pixel.

    An edge-aware picture errs where its model of an edge is too simple. A picture of a few samples errs where anything
    happens between them. Where the two agree, both are taken to be right. The other pixels, about one in four of a
    small picture and one in twelve of a large one, are sampled finely: what is left of the error is a fifth of the
    error bars of a target with noise of 1/255. The bias of a lossy file is added. `refine.refine` says why steps on a
    picture that is corrected again and again converge.
    """
    aware = np.asarray(problem.linearize(y, stage).image)
    moments = point_sampled(problem, y, COARSE_SAMPLES)
    row, column = np.nonzero(disagreement(problem, y, aware, moments))

    # As finely as the time allows, or only roughly: the rays of 640 x 480 pixels at 8 x 8 take two cores some seconds.
    fits = (n for n in FINE_SAMPLES if len(row) * n**2 <= 2e7)
    samples = FINE_SAMPLES[-1] if roughly else next(fits, FINE_SAMPLES[-1])
    fine = pixel_moments(problem, problem.scene_at(y), column, row, sample_offsets(samples))
    for part, some in zip(moments, fine, strict=True):
        part[:, row, column] = some
    whole = developed(problem, y, moments.mean)
    bias = whole - aware
    if problem.storage is not None:
        bias += storage_bias(problem, problem.storage, whole)
    return problem.with_bias(bias), moments


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


GRIDS = ((*range(1, 11), 12, 16, 24), (11, 13, 14, 15, 20, 32, 40))
"""Samples a pixel and side that are tried: those that renderers are asked for, and, where none of them stands out, the
others up to 16, and 32, of an 8 x 8 target that was binned by 4. The finest so far stands for the mean over the pixel:
a target that is nearer to it has more samples, or others, than a grid's."""


def detect_grid(
    problem: Problem, y: Vector, coarse: Moments, jacobian: Float[AnyArray, "parameters 3 height width"]
) -> int | None:
    """The samples a pixel and side of the regular grid whose means the target's pixels are; None if no grid stands out.

    Pictures of several grids are compared with the target in some pixels whose inside varies. If the target `t` is the
    picture `a` and noise, then another picture `b` is farther away: `|b - t|^2 - |a - t|^2` is `|a - b|^2` on average.
    So the difference of the two sums of squares is measured in units of the squares between the two pictures. What a
    step of the unknowns explains of a residual is taken off first: these unknowns are those of an edge-aware picture,
    and what they are off by would hide which grid is right. Of a painted board, 512 x 384, it was 2.4 times as much as
    what told 8 samples from 7.
    """
    # Some pixels at random, of those that count and whose inside varies. 1024 take a second or some of two cores. With
    # 128 the grid of a board of 80 x 60 was not told under noise of .05.
    target, root = np.asarray(problem.observation.target), np.asarray(problem.observation.root_weight)
    variance = np.where(root > 0, coarse.variance.max(axis=0), 0.0)
    row, column = np.nonzero(variance > 0.1 * np.max(variance))
    some = np.random.default_rng(0).permutation(len(row))[:1024]
    row, column = row[some], column[some]
    # If the film mixes pixels, a few of them tell nothing.
    if not len(column) or problem.film_reach(y) > 0:
        return None
    scene = problem.scene_at(y)
    derivative = np.asarray(jacobian, np.float64)[:, :, row, column].reshape(len(jacobian), -1).T

    def residual(samples: int) -> Float[np.ndarray, "3 pixels"]:
        light = np.zeros(target.shape)
        light[:, row, column] = pixel_moments(problem, scene, column, row, sample_offsets(samples)).mean
        off = (developed(problem, y, light) - target)[:, row, column] * root[row, column]
        step = np.linalg.lstsq(derivative, off.reshape(-1))[0]
        return off - (derivative @ step).reshape(off.shape)

    residuals: dict[int, np.ndarray] = {}
    for grids in GRIDS:
        residuals |= {samples: residual(samples) for samples in grids}
        best = nearest_by_far(residuals)
        if best is not None:
            return best
    return None


def nearest_by_far(residuals: dict[int, Float[np.ndarray, "3 pixels"]]) -> int | None:
    """The number of samples whose residuals are clearly smaller than those of any other; never the finest."""
    tried, each = list(residuals), np.array(list(residuals.values()))
    squares = np.sum(each**2, axis=1)
    best = int(np.argmin(squares.mean(axis=1)))
    if tried[best] == max(tried):
        return None
    # The ratio of sums that `detect_grid` explains, for each other picture, and its standard error over pixels.
    between = np.delete(np.sum((each - each[best]) ** 2, axis=1), best, axis=0)
    gain = np.delete(squares - squares[best], best, axis=0)
    length = np.maximum(between.sum(axis=1), TINY)
    nearer = gain.sum(axis=1) / length
    error = np.linalg.norm(gain - nearer[:, None] * between, axis=1) / length
    # The ratio is 1 of the right grid at the truth. Values 1e-4 off leave it 0.4; the best wrong grid, of a target that
    # no grid has made, has less than 0 beside the finest. It must be clear of chance by five standard errors besides.
    return tried[best] if np.all(nearer > np.maximum(0.3, 5.0 * error)) else None


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
