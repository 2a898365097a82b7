"""Where a search starts: many small pictures, compared with the target as quickly as can be."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import ndimage

from raytrace_jax.inverse.problem.observation import Observation
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import blurred_residual
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.inverse.solve.candidates import groups, table
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.plan import Plan
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.compilation import jit

CHUNK = 50
"""Pictures in one run of the program: between two runs the user can interrupt."""

SCAN_SLACK = 2.5
"""Room for the rays of all these scenes: small pictures cost little, compiling anew costs seconds."""

SCAN_BLUR = 1.0
"""Standard deviation of the blur in coarse pixels: the pictures are sampled at points. Half and double
lead three of three starts to the truth too (experiments/tuning)."""


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
            shape = [size for choice in grid for size in choice.values.shape[:-1]]
            lowest = ndimage.minimum_filter(costs.reshape(shape), size=3, mode="nearest").reshape(-1)
            seeds += [(float(c), row) for c, low, row in zip(costs, lowest, rows, strict=True) if c <= low]
        seeds.sort(key=lambda seed: seed[0])
        best = seeds[0][1]
    # Like any other place, the start is not the best of its neighbours if a place nearby is better.
    return [seed for seed in seeds if seed[1] is not initial or seed is seeds[0]]
