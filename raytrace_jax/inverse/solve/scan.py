"""Where a search starts: many small pictures, compared with the target as quickly as can be."""

import functools
import itertools
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.problem.observation import Observation
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import blurred_residual
from raytrace_jax.inverse.problem.unknowns import EXPOSURE, OFFSET, Unknowns
from raytrace_jax.scene.addresses import resolve
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.plan import Plan
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.compilation import jit

INDICES = (1.05, 1.15, 1.3, 1.45, 1.6, 1.85, 2.2, 2.6)
"""Indices of refraction that are tried; from what is barely denser than air to diamond."""

BUBBLE_INDICES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)
"""Those of a material that starts below 1."""

NEAR = ((-0.5, -0.2, 0.0, 0.2, 0.5), (-0.5, -0.2, 0.0, 0.2, 0.5), (-0.35, 0.0, 0.35))
"""Shifts of a sphere's center along x, y and z, in radii; a picture shows depth least."""

FAR = 7
"""Shifts over the whole image plane, in each direction, for a sphere that may be anywhere."""

FAR_INDICES = (1.1, 1.5, 2.0)

CHUNK = 50
"""Pictures in one run of the program: between two runs the user can interrupt."""

SCAN_SLACK = 2.5
"""Room for the rays of all these scenes: small pictures cost little, compiling anew costs seconds."""

SCAN_BLUR = 1.0
"""Standard deviation of the blur in coarse pixels: the pictures are sampled at points."""

Grid = list[tuple[int, tuple[float, ...]]]
"""Places of parameters, and the values to try for each."""


@functools.partial(jit, static_argnames=("unknowns", "settings", "plan"))
def scan_costs(
    values: Float[Array, "pictures parameters"],
    scene: Scene,
    observation: Observation,
    sigma: Float[Array, ""],
    unknowns: Unknowns,
    settings: RenderSettings,
    plan: Plan,
) -> tuple[Float[Array, " pictures"], Int[Array, " levels"]]:
    """Root mean square of the blurred, weighted difference of picture and target, for each row of values."""

    def cost(values):
        residual, (_, wanted) = blurred_residual(values, scene, observation, sigma, unknowns, settings, plan)
        return jnp.sqrt(jnp.mean(residual**2)), wanted

    costs, wanted = jax.lax.map(cost, values)
    return costs, jnp.max(wanted, axis=0)


def evaluate(
    problem: Problem, values: Float[np.ndarray, "pictures parameters"], binning: int, tell: Callable[[int], None]
) -> np.ndarray:
    """`scan_costs` of any number of rows."""
    settings, costs = problem.settings("point", binning), []
    sigma = jnp.asarray(SCAN_BLUR, problem.observation.target.dtype)
    for chunk in np.array_split(values, -(-len(values) // CHUNK)):
        rows = problem.array(np.resize(chunk, (CHUNK, chunk.shape[1])))

        def program(plan, rows=rows):
            return scan_costs(rows, problem.scene, problem.binned(binning), sigma, problem.unknowns, settings, plan)

        found = problem.run_planned(program, settings, problem.start(), SCAN_SLACK)
        costs.append(np.asarray(found)[: len(chunk)])
        tell(len(chunk))
    return np.concatenate(costs)


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
    best = initial
    seeds = [(float(evaluate(problem, initial[None], binning, tell)[0]), initial)]
    for grids in groups(problem):
        for grid in grids:
            rows = list(table(best, grid))
            costs = evaluate(problem, np.array(rows), binning, tell)
            shape = tuple(len(values) for _, values in grid)
            lowest = ndimage.minimum_filter(costs.reshape(shape), size=3, mode="nearest").reshape(-1)
            seeds += [(float(c), row) for c, low, row in zip(costs, lowest, rows, strict=True) if c <= low]
        seeds.sort(key=lambda seed: seed[0])
        best = seeds[0][1]
    # Like any other place, the start is not the best of its neighbours if a place nearby is better.
    return [seed for seed in seeds if seed[1] is not initial or seed is seeds[0]]


def table(base: Float[np.ndarray, " parameters"], grid: Grid) -> Iterator[Float[np.ndarray, " parameters"]]:
    """All combinations of a grid's values, the rest as in `base`."""
    for values in itertools.product(*(values for _, values in grid)):
        row = base.copy()
        row[[place for place, _ in grid]] = values
        yield row


def groups(problem: Problem) -> list[list[Grid]]:
    """For each sphere with a free center, and each index without one, the grids to try.

    A parameter that is neither index nor center, or that has a prior, stays where it starts: the solver finds it.
    """
    scene, unknowns = problem.scene, problem.unknowns
    centers: dict[int, dict[int, int]] = {}
    indices: dict[int, int] = {}
    for place, name in enumerate(unknowns.names):
        if name in (EXPOSURE, OFFSET) or problem.prior.precision[place] > 0:
            continue
        _, field, column, component = resolve(scene, name).address
        if field == "center" and column is not None and component is not None:
            centers.setdefault(column, {})[component] = place
        elif field == "ior" and column is not None:
            indices[column] = place

    found = []
    for sphere, places in centers.items():
        material = scene.spheres.material[sphere]
        index = [(indices.pop(material), tried_indices(scene, material))] if material in indices else []
        radius, center = float(scene.spheres.radius[sphere]), np.asarray(scene.spheres.center[:, sphere])
        near: Grid = [(p, tuple(center[axis] + radius * s for s in NEAR[axis])) for axis, p in places.items()]
        grids = [[*index, *near]]
        if 0 in places and 1 in places:
            grids.append([*((place, FAR_INDICES) for place, _ in index), *across_picture(problem, center, places)])
        found.append(grids)
    return found + [[[(place, tried_indices(scene, material))]] for material, place in indices.items()]


def tried_indices(scene: Scene, material: int) -> tuple[float, ...]:
    """The indices to try for a material."""
    return INDICES if scene.materials.ior[material] >= 1 else BUBBLE_INDICES


def across_picture(problem: Problem, center: np.ndarray, places: dict[int, int]) -> Grid:
    """Centers at the depth of the present one that are seen all over the picture."""
    camera = problem.scene.camera
    viewpoint, (width, height) = np.asarray(camera.viewpoint), np.asarray(camera.worlddim)
    # A point in the plane z = 0, seen from the viewpoint, carried on to the center's depth.
    reach = (center[2] - viewpoint[2]) / -viewpoint[2]
    spread = (np.arange(FAR) + 0.5) / FAR
    return [
        (places[axis], tuple(viewpoint[axis] + reach * (size * spread - viewpoint[axis])))
        for axis, size in ((0, width), (1, height))
    ]
