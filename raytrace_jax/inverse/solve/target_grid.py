"""The number of samples whose mean each pixel of a box-filtered target is, if they lie on a regular grid."""

import threading
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.unknowns import AnyArray
from raytrace_jax.inverse.solve.sampling import Moments, developed, pixel_moments, supersampled
from raytrace_jax.scene.setting_words import MAX_SAMPLES
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY


class GridTest(NamedTuple):
    """Which grids of samples are tried, and when one stands out.

    Args:
        grids: samples a pixel and side that are tried: those that renderers are asked for, and, where none of them
            stands out, the others up to 16, and 32, of an 8 x 8 target that was binned by 4. The finest so far stands
            for the mean over the pixel: a target that is nearer to it has more samples, or others, than a grid's.
        most_pixels: how many pixels are looked at, 1,400 rays each, or 5,100: a second or some of two cores. With 128
            the grid of a board of 80 x 60 was not told under noise of .05, and the check of the model, which looks at
            every pixel, saw that the samples were others: five right scenes of five were doubted. With 1,024 it is
            told in all five, and under noise of .1 neither sees it.
        varied: share of the largest variance within a pixel from which on a pixel shows how it was sampled.
        nearer: how much nearer a grid's picture must be to the target than another one's, where 1 is all of the squares
            between the two, as of the right grid at the truth, and 0 is as near. Values 1e-4 off leave the right one
            0.4; the best of the wrong ones, of a target that no grid has made, has less than 0 beside the finest.
        clear: standard errors by which it must be nearer. The error is that of a ratio of sums over pixels, from the
            scatter of each pixel's gain around what the ratio and its own square let expect.
    """

    grids: tuple[tuple[int, ...], ...] = ((*range(1, 11), 12, 16, 24), (11, 13, 14, 15, 20, 32, 40))
    most_pixels: int = 1024
    varied: float = 0.1
    nearer: float = 0.3
    clear: float = 5.0


GRID_TEST = GridTest()


def tell_grid(
    problem: Problem,
    y: Float[Array, " parameters"],
    coarse: Moments,
    columns: Float[AnyArray, "parameters 3 height width"],
) -> int | None:
    """The samples a pixel and side of the regular grid whose means the target's pixels are; None if no grid stands out.

    Pictures of several grids are compared with the target in some pixels whose inside varies. If the target `t` is the
    picture `a` and noise, then another picture `b` is farther away: `|b - t|^2 - |a - t|^2` is `|a - b|^2` on average.
    So the difference of the two sums of squares is measured in units of the squares between the two pictures. What a
    step of the unknowns explains of a residual is taken off first: these unknowns are those of an edge-aware picture,
    and what they are off by would hide which grid is right. Of a painted board, 512 x 384, it was 2.4 times as much as
    what told 8 samples from 7.

    Args:
        problem: what is fitted.
        y: unknowns near the answer.
        coarse: mean and variance of some samples in each of the target's pixels.
        columns: derivative of the weighted picture with respect to the unknowns (`Linearization.columns`).
    """
    column, row = varied_pixels(problem, coarse)
    # If the film mixes pixels, a few of them tell nothing.
    if not len(column) or problem.film_reach(y) > 0:
        return None
    scene = problem.scene_at(y)
    target, root = np.asarray(problem.observation.target), np.asarray(problem.observation.root_weight)
    derivative = np.asarray(columns, np.float64)[:, :, row, column].reshape(len(columns), -1).T

    def residual(samples: int) -> Float[np.ndarray, "3 pixels"]:
        light = np.zeros(target.shape)
        light[:, row, column] = pixel_moments(problem, scene, column, row, sample_offsets(samples)).mean
        off = (developed(problem, y, light) - target)[:, row, column] * root[row, column]
        step = np.linalg.lstsq(derivative, off.reshape(-1))[0]
        return off - (derivative @ step).reshape(off.shape)

    residuals: dict[int, np.ndarray] = {}
    for grids in GRID_TEST.grids:
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
    # The ratio of sums that `tell_grid` explains, for each other picture, and its standard error over pixels.
    between = np.delete(np.sum((each - each[best]) ** 2, axis=1), best, axis=0)
    gain = np.delete(squares - squares[best], best, axis=0)
    length = np.maximum(between.sum(axis=1), TINY)
    nearer = gain.sum(axis=1) / length
    error = np.linalg.norm(gain - nearer[:, None] * between, axis=1) / length
    return tried[best] if np.all(nearer > np.maximum(GRID_TEST.nearer, GRID_TEST.clear * error)) else None


def varied_pixels(problem: Problem, coarse: Moments) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"]]:
    """Columns and rows of some pixels at random, out of those that count and whose inside varies."""
    counts = np.asarray(problem.observation.root_weight) > 0
    variance = np.where(counts, coarse.variance.max(axis=0), 0.0)
    row, column = np.nonzero(variance > GRID_TEST.varied * np.max(variance))
    some = np.random.default_rng(0).permutation(len(row))[: GRID_TEST.most_pixels]
    return column[some], row[some]


Sampling = Literal["box", "point"]


def told_once(problem: Problem) -> Callable[[Float[Array, " parameters"]], Sampling]:
    """`likelier_sampling` of a problem, computed once for each place: a thread that asks meanwhile waits."""
    lock, told = threading.Lock(), dict[bytes, Sampling]()

    def tell(y: Float[Array, " parameters"]) -> Sampling:
        with lock:
            place = np.asarray(y).tobytes()
            if place not in told:
                told[place] = likelier_sampling(problem, y)
            return told[place]

    return tell


def likelier_sampling(problem: Problem, y: Float[Array, " parameters"]) -> Sampling:
    """How a target was sampled, judged near the answer: like the kind of picture that is nearer to it on average.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples = problem.base.samples

    def distance(samples: int) -> float:
        return float(np.mean(np.abs(problem.residual(supersampled(problem, y, samples)))))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"
