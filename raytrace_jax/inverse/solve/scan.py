"""Where a search starts: many small pictures, compared with the target as quickly as can be."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from raytrace_jax.images.filters import blurred
from raytrace_jax.inverse.problem.development import develop_best
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.solve.candidates import groups, table
from raytrace_jax.scene.stacked import map_scenes
from raytrace_jax.util.numerics import finite_or_last

CHUNK = 50
"""Pictures at a time: between two times the user can interrupt."""

SCAN_BLUR = 1.0
"""Standard deviation of the blur in coarse pixels: the pictures are sampled at points. Half and double
lead three of three starts to the truth too (experiments/tuning)."""


def evaluate(
    problem: Problem, values: Float[np.ndarray, "pictures parameters"], binning: int, tell: Callable[[int], None]
) -> tuple[Float[np.ndarray, " pictures"], Float[np.ndarray, "pictures parameters"]]:
    """How far the pictures of some rows of values are from the target, and the rows with the best film of each.

    The measure is the root mean square of the blurred, weighted difference; infinite where a picture is not finite.
    Those of the film's numbers in which the picture is linear, such as its gain, take their best values.
    """
    observation = problem.binned(binning)
    target, root = np.asarray(observation.target), np.asarray(observation.root_weight)
    _, height, width = target.shape
    row, column = np.divmod(np.arange(height * width), width)
    points, costs, found = problem.places(column, row, binning), [], np.array(values, np.float64)
    for some in np.array_split(np.arange(len(values)), -(-len(values) // CHUNK)):
        # As many scenes each time: another number of them is another program.
        scenes = problem.scenes_with(np.resize(found[some], (CHUNK, found.shape[1])))
        wanted = map_scenes(lambda x, some=some: np.asarray(x)[: len(some)], scenes)
        images = problem.model.points(wanted, points, problem.base).reshape(-1, *target.shape)
        if problem.development.is_needed:
            found[some], images = best_films(problem, found[some], images, binning)
        each = np.sqrt(np.mean(blurred((images - target) * root, SCAN_BLUR) ** 2, axis=(1, 2, 3)))
        costs += [finite_or_last(float(cost)) for cost in each]
        tell(len(some))
    return np.array(costs), found


def best_films(
    problem: Problem,
    rows: Float[np.ndarray, "pictures parameters"],
    light: Float[np.ndarray, "pictures 3 height width"],
    binning: int,
) -> tuple[Float[np.ndarray, "pictures parameters"], Float[np.ndarray, "pictures 3 height width"]]:
    """Values with those of the film's linear numbers that bring pictures nearest to the target; what they make.

    Args:
        problem: what is fitted.
        rows: values of the free parameters, for each picture, `CHUNK` at most.
        light: the pictures before the film.
        binning: size of their pixels in those of the target.
    """
    # As many each time: another number of them is another program.
    found = develop_best(
        problem.array(np.resize(rows, (CHUNK, *rows.shape[1:]))),
        problem.array(np.resize(light, (CHUNK, *light.shape[1:]))),
        problem.development.of_scene,
        problem.binned(binning),
        problem.array(SCAN_BLUR),
        problem.unknowns,
        problem.frame(binning),
        problem.linear_places,
    )
    best, images = (np.asarray(x, np.float64)[: len(rows)] for x in found)
    return best, images


def scan(
    problem: Problem, binning: int, tell: Callable[[int], None]
) -> list[tuple[float, Float[np.ndarray, " parameters"]]]:
    """Cost and values of the places from which a solve is worth while, best first.

    Spheres are searched one after the other, each at the best that was found of those before: its index by its
    position near the start, then its position anywhere in the picture for a few indices. A place is worth while if it
    is the best of its neighbours on such a grid.

    Args:
        problem: what is fitted; its start counts if no other place is better, or if there is nothing to search.
        binning: size of the pictures' pixels in those of the target.
        tell: called with the number of pictures done since it was called last.
    """
    initial = problem.unknowns.initial(problem.scene)
    (cost,), (initial,) = evaluate(problem, initial[None], binning, tell)
    best = initial
    seeds = [(float(cost), initial)]
    for grids in groups(problem):
        for grid in grids:
            costs, rows = evaluate(problem, np.array(list(table(best, grid))), binning, tell)
            shape = [size for choice in grid for size in choice.values.shape[:-1]]
            lowest = ndimage.minimum_filter(costs.reshape(shape), size=3, mode="nearest").reshape(-1)
            seeds += [(float(c), row) for c, low, row in zip(costs, lowest, rows, strict=True) if c <= low < np.inf]
        seeds.sort(key=lambda seed: seed[0])
        best = seeds[0][1]
    # Like any other place, the start is not the best of its neighbours if a place nearby is better.
    return [seed for seed in seeds if seed[1] is not initial or seed is seeds[0]]
