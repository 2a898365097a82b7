"""Places where a fit may begin, and minima that a fit has not seen."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.structure import EVIDENCE, vuong_evidence
from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.observe.sampling import samples_of, supersampled
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.problem.unknowns import Image, Values, natural_scale
from raytrace_jax.scene.parameters import Address, Block, material_of, resolve
from raytrace_jax.scene.scene import Camera, Scene
from raytrace_jax.tracer.geometry.camera import ray

INDICES = (1.05, 1.15, 1.3, 1.45, 1.6, 1.85, 2.2, 2.6)
"""Indices that are tried for a material that starts at 1 or above: from what is barely denser than air to diamond."""

BUBBLE_INDICES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)
"""Indices that are tried for a material that starts below 1."""

NEAR, NEAR_DEPTH = (-0.5, -0.2, 0.0, 0.2, 0.5), (-0.35, 0.0, 0.35)
"""Shifts of a sphere's center along the picture's axes and into its depth, in radii; half and double do as well."""

FAR, FAR_INDICES = 7, (1.1, 1.5, 2.0)
"""Places in each direction of the picture for a sphere that may be anywhere, and the indices that are tried there."""

MOST_TRIED = 800
"""Pictures in all, about the 747 of one ball with its index; of a larger grid every other value is left out."""


class Choice(NamedTuple):
    """The places of parameters that vary together, and their values on a grid, "*grid places"."""

    places: tuple[int, ...]
    values: np.ndarray

    @property
    def longest(self) -> int:
        """The size of its longest axis."""
        return max(self.values.shape[:-1])

    def thinned(self) -> "Choice":
        """A choice that lacks every other value along its longest axis; the first value stays."""
        axis = int(np.argmax(self.values.shape[:-1]))
        kept = np.arange(0, self.longest, 2)
        return Choice(self.places, np.take(self.values, kept, axis))


ScanGrid = list[Choice]
"""Choices that vary independently: a grid tries all combinations of their values."""


def table(base: Values, grid: ScanGrid) -> Iterator[Values]:
    """All combinations of a grid's values; the other parameters have those of `base`."""
    places = [place for choice in grid for place in choice.places]
    for values in itertools.product(*(choice.values.reshape(-1, len(choice.places)) for choice in grid)):
        row = base.copy()
        row[places] = np.concatenate(values)
        yield row


def size(grid: ScanGrid) -> int:
    """The number of a grid's combinations."""
    return math.prod(choice.values[..., 0].size for choice in grid)


def few_enough(found: list[list[ScanGrid]]) -> list[list[ScanGrid]]:
    """The grids, the largest thinned out first, until they are at most `MOST_TRIED` pictures in all."""
    found = [[list(grid) for grid in grids] for grids in found]
    while sum(size(grid) for grids in found for grid in grids) > MOST_TRIED:
        largest = max((grid for grids in found for grid in grids), key=size)
        place = max(range(len(largest)), key=lambda place: largest[place].longest)
        if largest[place].longest == 1:
            break
        largest[place] = largest[place].thinned()
    return found


def groups(problem: Problem) -> list[list[ScanGrid]]:
    """For each shape with a free position that is searched, and each index without one, the grids to try.

    A parameter that is neither, or that has a prior, stays where it starts: the solver finds it. The parameter's
    `Nature` tells whether it is an index, or a position that is searched. Indices of one material, one a channel, take
    the same value in each trial.
    """
    scene, unknowns = problem.scene, problem.unknowns
    positions: dict[Address, dict[int, int]] = {}
    blocks: dict[Address, Block] = {}
    indices: dict[Address, Choice] = {}
    # Sort the free parameters: coordinates by shape, indices by material.
    for place, name in enumerate(unknowns.names):
        if problem.prior.precision[place] > 0:
            continue
        address, block, attribute, _ = resolve(scene, name)
        if attribute.quantity.role == "position" and address.component is not None:
            positions.setdefault(address.entry, {})[address.component] = place
            blocks[address.entry] = block
        elif attribute.quantity.role == "index":
            tried = INDICES if float(address.read(scene)) >= 1 else BUBBLE_INDICES
            places = (*(indices[address.entry].places if address.entry in indices else ()), place)
            indices[address.entry] = Choice(places, np.tile(np.array(tried)[:, None], len(places)))

    # Give each shape its grids: near the start with all indices, all over the picture with a few.
    normal, found = film_normal(scene.camera), []
    for entry, places in positions.items():
        # An index that a shape takes is not tried a second time without a shape.
        own = [address for address in indices if is_material_of(scene, blocks[entry], address)]
        index = [indices.pop(address) for address in own]
        center = np.asarray(entry.read(scene), np.float64)
        near = []
        for axis, place in places.items():
            scale = natural_scale(scene, unknowns.names[place], problem.base.model)
            shifts = np.array(NEAR_DEPTH if axis == np.argmax(np.abs(normal)) else NEAR)
            near.append(Choice((place,), (center[axis] + scale * shifts)[:, None]))
        grids = [[*index, *near]]
        far = across_picture(scene.camera, center, places)
        if far:
            tried = np.array(FAR_INDICES)[:, None]
            grids.append([*(Choice(one.places, np.tile(tried, len(one.places))) for one in index), far])
        found.append(grids)
    return few_enough(found + [[[choice]] for choice in indices.values()])


def is_material_of(scene: Scene, shape: Block, address: Address) -> bool:
    """Whether a parameter is one of a shape's material."""
    material = material_of(scene, shape)
    return (address.group, address.column) == (material.type.group, material.column)


def looks(camera: Camera, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions, "3 *rays" in float64, of the rays through points of the picture."""
    origin, direction = ray(camera, *(jnp.asarray(x, camera.viewpoint.dtype) for x in (u, v)))
    return np.asarray(origin, np.float64), np.asarray(direction, np.float64)


def film_normal(camera: Camera) -> Float[np.ndarray, "3"]:
    """A vector, of any length, across the plane of the picture: the direction of its depth."""
    _, direction = looks(camera, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    corner, right, up = direction.T
    return np.cross(right - corner, up - corner)


def across_picture(camera: Camera, center: Float[np.ndarray, "3"], places: dict[int, int]) -> Choice | None:
    """Centers all over the picture at the depth of the present one; None if the center may not move that way.

    They lie in the plane across the picture's depth. If the depth is not free, or runs along an axis, that plane is the
    one across the nearest axis.
    """
    normal = film_normal(camera)
    depth = int(np.argmax(np.abs(normal)))
    if len(places) < 3 or np.count_nonzero(normal) == 1:
        places = {axis: place for axis, place in places.items() if axis != depth}
        normal = np.eye(3)[depth]
    if len(places) < 2:
        return None
    # Intersect the rays through a grid of places in the picture with that plane.
    spread = (np.arange(FAR) + 0.5) / FAR
    origin, direction = looks(camera, *np.meshgrid(spread, spread, indexing="ij"))
    away, ahead = np.tensordot(normal, center[:, None, None] - origin, 1), np.tensordot(normal, direction, 1)
    seen = away * ahead > 0
    if not seen.any():
        return None
    reach = away / np.where(seen, ahead, 1)
    # A ray that never comes to this plane, or meets it behind the camera, leaves the center where it is.
    points = np.where(seen, origin + reach * direction, center[:, None, None])
    return Choice(tuple(places.values()), np.moveaxis(points[list(places)], 0, -1))


def unseen_balls(solution: FitState) -> dict[str, tuple[str, ...]]:
    """The balls without which the picture explains the target as well: their free index and positions, by name.

    Each ball whose index is near 1 is moved out of sight, and the residuals with it and without it are compared.
    """
    problem = solution.problem
    values, found = problem.values(solution.y), dict[str, tuple[str, ...]]()
    samples, unbiased = (
        samples_of(problem) or 4,
        problem.observation.with_bias(np.zeros(problem.observation.target.shape)),
    )

    def residual(values: Values) -> Image:
        y = problem.y_of(values)
        return unbiased.residual(supersampled(problem, y, samples))

    for ball, names in faint_balls(problem, values).items():
        places = [problem.unknowns.names.index(name) for name in names[1:]]
        without = values.copy()
        without[places] += 1e4 * problem.scale[places]  # Out of sight.
        if vuong_evidence(residual(values), residual(without)) < EVIDENCE:
            found[ball] = names
    return found


def faint_balls(problem: Problem, values: Values) -> dict[str, tuple[str, ...]]:
    """The balls with a free index near 1 and a free position: the names of these parameters, by the ball's name."""
    scene, faint, positions, balls = problem.scene, dict[Address, str](), dict[str, list[str]](), dict[str, Block]()
    for name, value in zip(problem.unknowns.names, values, strict=True):
        address, block, attribute, _ = resolve(scene, name)
        if attribute.quantity.role == "position" and address.component is not None:
            positions.setdefault(block.name, []).append(name)
            balls[block.name] = block
        # Such a ball deflects light by less than a tenth of a radian; a search that finds nothing ends still nearer.
        elif attribute.quantity.role == "index" and abs(value - 1) < 0.05:
            faint[address] = name
    return {
        ball: (name, *names)
        for ball, names in positions.items()
        for address, name in faint.items()
        if is_material_of(scene, balls[ball], address)
    }


def with_open(uncertainty: Uncertainty, names: tuple[str, ...], opened: tuple[str, ...]) -> Uncertainty:
    """The uncertainty with some parameters open: their errors are infinite, and they are undetermined."""
    is_open = np.isin(names, opened)
    open_ = tuple(name for name in names if name in opened or name in uncertainty.undetermined)
    error = np.where(is_open, np.inf, uncertainty.standard_error)
    return dataclasses.replace(uncertainty, standard_error=error, undetermined=open_)
