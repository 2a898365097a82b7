"""Detection of how a target was sampled: by points, by means of regular grids, edge-aware, or over areas."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...scene.setting_words import MAX_SAMPLES
from ...tracer.pixels import sample_offsets
from ...util.numerics import TINY, on_host
from .problem import FitState, Problem
from .sampling import lattice_offsets, pixel_moments
from .unknowns import Image, Vector

Samples = int | Literal["aware"]
"""Samples a pixel and side of a regular grid, or edge-aware pixels."""

GRIDS = (*range(1, 17), 20)
"""Samples a pixel and side that are tried. Means of more are those over the pixel, for all that a fit can tell."""


def detect_samples(state: FitState, variance: Image) -> Samples | None:
    """How the target's pixels were sampled, near the answer: by n x n samples on a regular grid, or edge-aware.

    None if neither stands out. Pictures of several grids and the edge-aware one are compared with the target, in some
    pixels whose inside varies, beside those of a lattice and of a finer grid, which stand for the mean over the pixel.
    The right one is nearer to the target than any other in most pixels, but for the few in which a sample lies beyond
    an edge, since the unknowns are those of an edge-aware picture: these would rule sums of squares. What a step of the
    unknowns explains of a residual is taken off first: it would hide which grid is right. Of a painted board,
    512 x 384, it was 2.4 times as much as what told 8 samples from 7.

    Args:
        state: that of the edge-aware picture.
        variance: within each pixel, of `COARSE_SAMPLES` samples a side.
    """
    problem, y, linearization = state.problem, state.y, state.linearization
    target, root = np.asarray(problem.observation.target), np.asarray(problem.observation.root_weight)
    varied = np.where(root > 0, variance, 0.0).max(axis=0)
    row, column = np.nonzero(varied > 0.1 * np.max(varied))
    # A lossy file leaves nothing of a grid. If the film mixes pixels, a few of them tell nothing.
    if problem.storage is not None or not len(column) or problem.response_reach(y) > 0:
        return None
    order = np.random.default_rng(0).permutation(len(row))
    derivative = on_host(linearization.pixel_jacobian)[:, :, row, column]
    off_aware = problem.observation.residual(on_host(linearization.image))[:, row, column]

    def distance(off: Float[np.ndarray, "3 some"], chosen: Int[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
        """Squared residual of each pixel, but for what a step of the unknowns explains."""
        slopes = derivative[:, :, chosen].reshape(len(derivative), -1).T
        left = off - (slopes @ np.linalg.lstsq(slopes, off.reshape(-1))[0]).reshape(off.shape)
        return np.sum(left**2, axis=0)

    def of_samples(offsets: Float[np.ndarray, "samples 2"], chosen: Int[np.ndarray, " some"]) -> np.ndarray:
        light, (where, at) = np.zeros(target.shape), (row[chosen], column[chosen])
        light[:, where, at] = pixel_moments(problem, y, at, where, offsets)[0]
        return distance((problem.apply_response(light, y) - target)[:, where, at] * root[:, where, at], chosen)

    def evidence(better: np.ndarray, other: np.ndarray) -> float:
        """Standard errors by which one picture is nearer (Vuong 1989), by the log likelihood of Cauchy's noise.

        It tells a grid where nearly all of its pixels are exact, and where noise hides each of them.
        """
        gain = np.log((other + noise) / (better + noise))
        return float(np.sum(gain) / max(np.linalg.norm(gain), TINY))

    # A few pixels tell a grid without noise, and leave some to be told by many. The mean over a pixel is told by more
    # samples than any grid has. Of other targets no grid had more than 0.7 standard errors in 40 draws of noise of 1, 2
    # or 4 of 255; of 8 x 8 samples the right one had 5.9 at least, 3.3 and .8.
    tried: list[Samples] = ["aware", *GRIDS]
    for count in (96, 512):
        chosen = order[:count]
        finer = [of_samples(offsets, chosen) for offsets in (lattice_offsets(610), sample_offsets(24))]
        distances: dict[Samples, np.ndarray] = {
            n: distance(off_aware[:, chosen], chosen) if n == "aware" else of_samples(sample_offsets(n), chosen)
            for n in tried
        }
        noise = float(np.median(np.min([*finer, *distances.values()], axis=0))) + TINY
        for n, distance_of_n in distances.items():
            others = [*finer, *(distances[other] for other in tried if other != n)]
            if all(evidence(distance_of_n, other) > 3.0 for other in others):
                return n
        tried = [n for n in tried if all(evidence(distances[n], other) > 1.0 for other in finer)]
        if not tried:
            return None
    return None


def detect_sampling(problem: Problem, y: Vector) -> Literal["box", "point"]:
    """The target's sampling: that of the kind of picture which is nearer to it on average, near the answer.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples, light = problem.base.samples, np.zeros(problem.observation.target.shape)
    column, row = problem.places()
    # Some of a large picture's pixels tell as well, unless the film mixes them.
    if problem.response_reach(y) == 0:
        chosen = np.random.default_rng(0).permutation(len(row))[:40_000]
        column, row = column[chosen], row[chosen]

    def distance(samples: int) -> float:
        light[:, row, column] = pixel_moments(problem, y, column, row, sample_offsets(samples))[0]
        residual = problem.observation.residual(problem.apply_response(light, y))
        return float(np.mean(np.abs(residual[:, row, column])))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"
