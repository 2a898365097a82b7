"""The sampling of pixels: points, means of regular grids, means over areas; and how to tell which a target has."""

import dataclasses
import threading
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...images.jpeg import JpegStorage
from ...scene.scene import Scene, map_scenes
from ...scene.setting_words import MAX_SAMPLES
from ...tracer.pixels import sample_offsets
from ...util.numerics import TINY
from ..problem.linearize import Linearization
from ..problem.observation import Observation
from ..problem.problem import Problem
from ..problem.stages import ObservationStage
from ..problem.unknowns import Covariance, Image, Vector
from .noise import Noise
from .storing import Compression, Rounding


@dataclasses.dataclass(frozen=True)
class Sampling(ObservationStage):
    """The samples of which each pixel of a target is the mean.

    Args:
        samples: how many a side a regular grid has; None for the mean over the pixel, or samples that are not known.
        confused: covariance of unknowns whose pictures of these samples are the same, where that was found out.
        variance: that within each pixel, weighted, where it was found out and the samples are not known.
    """

    samples: int | None = None
    confused: Covariance | None = None
    variance: Image | None = None

    @property
    def advice(self) -> str:
        """What a user may know of the samples."""
        return "say how the target was sampled with --target-samples" if self.samples is None else ""

    def confusion(self, count: int) -> Covariance:
        """That of places between which no sample passes an edge."""
        return super().confusion(count) if self.confused is None else self.confused

    def obscures(self, sigma: float) -> Bool[np.ndarray, "*shape"]:
        """The numbers in which a few samples may err by a tenth of such noise."""
        # Four samples: a hundredth more of the squares, of which nobody knows the noise to 2 %.
        return np.zeros((), bool) if self.variance is None else self.variance > 4 * (0.1 * sigma) ** 2

    def bound(self, observation: Observation) -> Float[np.ndarray, ""]:
        """A step and a half of 16 bits, white being a power of two: renderers store the samples before their mean."""
        most = float(np.max(np.asarray(observation.target, np.float64)))
        is_mean = self.samples != 1 and most > 0
        return np.array(1.5 * 2.0 ** np.ceil(np.log2(most)) / 65535 if is_mean else 0.0)

    def jump(self, observation: Observation) -> float:
        """The change of a number by a few samples beyond an edge, of a grid whose steps have come to their end."""
        if self.samples is None or self.confused is None:
            return 0.0
        # Two: of a board, 320 x 240 with 8 x 8 samples, at a place right to 1.5e-8, less than one does.
        return 2 * float(np.ptp(np.asarray(observation.target, np.float64))) / self.samples**2


def stages_of(samples: int | None, storage: JpegStorage | None = None) -> tuple[ObservationStage, ...]:
    """The stages of a target by what is known of them."""
    compressed = () if storage is None else (Compression(storage),)
    return (Sampling(samples), *compressed, Rounding(), Noise())


def sampled(problem: Problem, sampling: Sampling) -> Problem:
    """The problem of a target that was sampled so."""
    stages = (sampling if isinstance(stage, Sampling) else stage for stage in problem.stages)
    return dataclasses.replace(problem, stages=tuple(stages))


def samples_of(problem: Problem) -> int | None:
    """The samples a side of the target's pixels, where they are known."""
    return next((stage.samples for stage in problem.stages if isinstance(stage, Sampling)), None)


class Moments(NamedTuple):
    """Mean and variance of the samples within each pixel, before the film."""

    mean: Float[np.ndarray, "3 *pixels"]
    variance: Float[np.ndarray, "3 *pixels"]


def supersampled(problem: Problem, y: Vector, samples: int) -> Image:
    """The picture at `y` with so many point samples a pixel and side."""
    return problem.camera.image(point_sampled(problem, y, samples).mean, problem.values(y), problem.raster().frame)


def point_sampled(problem: Problem, y: Vector, samples: int) -> Moments:
    """Mean and variance of so many point samples a pixel and side, of all of the target's pixels."""
    moments = pixel_moments(problem, problem.scene_at(y), *problem.raster().places, sample_offsets(samples))
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
        points = problem.raster().points((column + right).reshape(-1), (row + down).reshape(-1))
        colors = problem.model.points(scenes, points, problem.base).astype(np.float64)
        colors = colors.reshape(3, len(some), len(column))
        total += colors.sum(axis=1)
        squares += np.sum(colors**2, axis=1)
    mean = total / len(offsets)
    return Moments(mean, np.maximum(squares / len(offsets) - mean**2, 0.0))


COARSE_SAMPLES = 2
"""Samples a pixel and side with which the edge-aware picture is compared everywhere: the fewest that see an edge."""

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


GRIDS = (*range(1, 17), 20)
"""Samples a pixel and side that are tried. Means of more are those over the pixel, for all that a fit can tell."""


def detect_samples(
    problem: Problem, y: Vector, coarse: Moments, linearization: Linearization
) -> int | Literal["aware"] | None:
    """How the target's pixels were sampled, near the answer: by n x n samples on a regular grid, or edge-aware.

    None if neither stands out. Pictures of several grids and the edge-aware one are compared with the target, in some
    pixels whose inside varies, beside those of a lattice and of a finer grid, which stand for the mean over the pixel.
    The right one is nearer to the target than any other in most pixels, but for the few in which a sample lies beyond
    an edge, since the unknowns are those of an edge-aware picture: these would rule sums of squares. What a step of the
    unknowns explains of a residual is taken off first: it would hide which grid is right. Of a painted board,
    512 x 384, it was 2.4 times as much as what told 8 samples from 7.

    Args:
        coarse: `COARSE_SAMPLES` samples a pixel and side at `y`.
        linearization: that of the edge-aware picture there.
    """
    target, root = np.asarray(problem.observation.target), np.asarray(problem.observation.root_weight)
    variance = np.where(root > 0, coarse.variance, 0.0).max(axis=0)
    row, column = np.nonzero(variance > 0.1 * np.max(variance))
    # A lossy file leaves nothing of a grid. If the film mixes pixels, a few of them tell nothing.
    if any(isinstance(stage, Compression) for stage in problem.stages):
        return None
    if not len(column) or problem.camera.reach(problem.values(y)) > 0:
        return None
    scene, order = problem.scene_at(y), np.random.default_rng(0).permutation(len(row))
    camera, values, frame = problem.camera, problem.values(y), problem.raster().frame
    derivative = np.asarray(linearization.pixel_jacobian, np.float64)[:, :, row, column]
    off_aware = problem.observation.residual(np.asarray(linearization.image, np.float64))[:, row, column]

    def distance(off: Float[np.ndarray, "3 some"], some: Int[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
        """Squared residual of each pixel, but for what a step of the unknowns explains."""
        slopes = derivative[:, :, some].reshape(len(derivative), -1).T
        left = off - (slopes @ np.linalg.lstsq(slopes, off.reshape(-1))[0]).reshape(off.shape)
        return np.sum(left**2, axis=0)

    def of_samples(offsets: Float[np.ndarray, "samples 2"], some: Int[np.ndarray, " some"]) -> np.ndarray:
        light, (where, at) = np.zeros(target.shape), (row[some], column[some])
        light[:, where, at] = pixel_moments(problem, scene, at, where, offsets).mean
        return distance((camera.image(light, values, frame) - target)[:, where, at] * root[:, where, at], some)

    def evidence(better: np.ndarray, other: np.ndarray) -> float:
        """Standard errors by which one picture is nearer (Vuong 1989), by the log likelihood of Cauchy's noise.

        It tells a grid where nearly all of its pixels are exact, and where noise hides each of them.
        """
        gain = np.log((other + noise) / (better + noise))
        return float(np.sum(gain) / max(np.linalg.norm(gain), TINY))

    # A few pixels tell a grid without noise, and leave some to be told by many. The mean over a pixel is told by more
    # samples than any grid has. Of other targets no grid had more than 0.7 standard errors in 40 draws of noise of 1, 2
    # or 4 of 255; of 8 x 8 samples the right one had 5.9 at least, 3.3 and .8.
    tried: list[int | Literal["aware"]] = ["aware", *GRIDS]
    for count in (96, 512):
        some = order[:count]
        finer = [of_samples(offsets, some) for offsets in (lattice_offsets(610), sample_offsets(24))]
        distances: dict[int | Literal["aware"], np.ndarray] = {
            n: distance(off_aware[:, some], some) if n == "aware" else of_samples(sample_offsets(n), some)
            for n in tried
        }
        noise = float(np.median(np.min([*finer, *distances.values()], axis=0))) + TINY
        for n, own in distances.items():
            others = [*finer, *(distances[other] for other in tried if other != n)]
            if all(evidence(own, other) > 3.0 for other in others):
                return n
        tried = [n for n in tried if all(evidence(distances[n], other) > 1.0 for other in finer)]
        if not tried:
            return None
    return None


SamplingKind = Literal["box", "point"]


def cached_detection(problem: Problem) -> Callable[[Vector], SamplingKind]:
    """`detect_sampling` of a problem, computed once for each place: a thread that asks meanwhile waits."""
    lock, found = threading.Lock(), dict[bytes, SamplingKind]()

    def detect(y: Vector) -> SamplingKind:
        with lock:
            key = np.asarray(y).tobytes()
            if key not in found:
                found[key] = detect_sampling(problem, y)
            return found[key]

    return detect


def detect_sampling(problem: Problem, y: Vector) -> SamplingKind:
    """The target's sampling: that of the kind of picture which is nearer to it on average, near the answer.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples, light = problem.base.samples, np.zeros(problem.observation.target.shape)
    camera, values, frame, scene = problem.camera, problem.values(y), problem.raster().frame, problem.scene_at(y)
    column, row = problem.raster().places
    # Some of a large picture's pixels tell as well, unless the film mixes them.
    if camera.reach(values) == 0:
        some = np.random.default_rng(0).permutation(len(row))[:40_000]
        column, row = column[some], row[some]

    def distance(samples: int) -> float:
        light[:, row, column] = pixel_moments(problem, scene, column, row, sample_offsets(samples)).mean
        residual = problem.observation.residual(camera.image(light, values, frame))
        return float(np.mean(np.abs(residual[:, row, column])))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"
