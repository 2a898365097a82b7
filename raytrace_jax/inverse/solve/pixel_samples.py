"""Point samples within the target's pixels: their means and variances, for all pixels or some."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

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
