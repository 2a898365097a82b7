"""What a scan tries: indices of refraction, and positions near the start and all over the picture."""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.transforms import natural_scale
from raytrace_jax.scene.addresses import Address, resolve
from raytrace_jax.scene.blocks import Block, material_of
from raytrace_jax.scene.scene import Camera, Scene
from raytrace_jax.tracer.geometry.camera import ray

INDICES = (1.05, 1.15, 1.3, 1.45, 1.6, 1.85, 2.2, 2.6)
"""Indices of refraction that are tried; from what is barely denser than air to diamond. Every other
one leads three of three starts to the truth too (experiments/tuning)."""

BUBBLE_INDICES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)
"""Those of a material that starts below 1."""

NEAR, NEAR_DEPTH = (-0.5, -0.2, 0.0, 0.2, 0.5), (-0.35, 0.0, 0.35)
"""Shifts of a sphere's center, in radii, along the picture's axes and into its depth, which it shows least. Half and
double lead three of three starts to the truth too (experiments/tuning)."""

FAR = 7
"""Places over the whole picture, in each direction, for a sphere that may be anywhere. 3 to 14 lead three of three
starts to the truth too, 3 in up to twice the steps (experiments/tuning)."""

FAR_INDICES = (1.1, 1.5, 2.0)
"""Indices of refraction that are tried at these places; 1.5 alone leads three of three starts to the truth too
(experiments/tuning)."""


MOST_TRIED = 800
"""Pictures that are tried in all: the 747 of one ball with its index, whose scan takes as long as a solve. Of more,
every other value of the longest axis is left out until they are as few; every other index leads three of three starts
to the truth too."""


class Choice(NamedTuple):
    """The places of parameters that vary together, and their values on a grid, "*grid places"."""

    places: tuple[int, ...]
    values: np.ndarray

    @property
    def longest(self) -> int:
        """The size of its longest axis."""
        return max(self.values.shape[:-1])

    def thinned(self) -> "Choice":
        """The same without every other value along its longest axis; the first stays."""
        axis = int(np.argmax(self.values.shape[:-1]))
        kept = np.arange(0, self.longest, 2)
        return Choice(self.places, np.take(self.values, kept, axis))


Grid = list[Choice]
"""What varies independently."""


def table(base: Float[np.ndarray, " parameters"], grid: Grid) -> Iterator[Float[np.ndarray, " parameters"]]:
    """All combinations of a grid's values, the rest as in `base`."""
    places = [place for choice in grid for place in choice.places]
    for values in itertools.product(*(choice.values.reshape(-1, len(choice.places)) for choice in grid)):
        row = base.copy()
        row[places] = np.concatenate(values)
        yield row


def size(grid: Grid) -> int:
    """How many combinations a grid has."""
    return math.prod(choice.values[..., 0].size for choice in grid)


def few_enough(found: list[list[Grid]]) -> list[list[Grid]]:
    """The same grids, thinned out until they are at most `MOST_TRIED` pictures in all: the largest one first."""
    found = [[list(grid) for grid in grids] for grids in found]
    while sum(size(grid) for grids in found for grid in grids) > MOST_TRIED:
        largest = max((grid for grids in found for grid in grids), key=size)
        place = max(range(len(largest)), key=lambda place: largest[place].longest)
        if largest[place].longest == 1:
            break
        largest[place] = largest[place].thinned()
    return found


def groups(problem: Problem) -> list[list[Grid]]:
    """For each shape with a free position that is searched, and each index without one, the grids to try.

    A parameter that is neither, or that has a prior, stays where it starts: the solver finds it. What is an index or a
    position that is searched is told by the parameter's `Nature`. Indices of one material, one a channel, are tried as
    one.
    """
    scene, unknowns = problem.scene, problem.unknowns
    positions: dict[Address, dict[int, int]] = {}
    blocks: dict[Address, Block] = {}
    indices: dict[Address, Choice] = {}
    for place, name in enumerate(unknowns.names):
        if problem.prior.precision[place] > 0:
            continue
        address, block, attribute, _ = resolve(scene, name)
        if attribute.nature.role == "position" and address.component is not None:
            positions.setdefault(address.entry, {})[address.component] = place
            blocks[address.entry] = block
        elif attribute.nature.role == "index":
            tried = INDICES if float(address.read(scene)) >= 1 else BUBBLE_INDICES
            places = (*(indices[address.entry].places if address.entry in indices else ()), place)
            indices[address.entry] = Choice(places, np.tile(np.array(tried)[:, None], len(places)))

    normal, found = film_normal(scene.camera), []
    for entry, places in positions.items():
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
    return (address.group, address.column) == (material.kind.group, material.column)


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
    """Centers at the depth of the present one that are seen all over the picture, if it may move that way.

    Where the depth is not free, or runs along an axis, they lie in the plane across that axis.
    """
    normal = film_normal(camera)
    depth = int(np.argmax(np.abs(normal)))
    if len(places) < 3 or np.count_nonzero(normal) == 1:
        places = {axis: place for axis, place in places.items() if axis != depth}
        normal = np.eye(3)[depth]
    if len(places) < 2:
        return None
    spread = (np.arange(FAR) + 0.5) / FAR
    origin, direction = looks(camera, *np.meshgrid(spread, spread, indexing="ij"))
    away, ahead = np.tensordot(normal, center[:, None, None] - origin, 1), np.tensordot(normal, direction, 1)
    seen = away * ahead > 0
    if not seen.any():
        return None
    reach = away / np.where(seen, ahead, 1)
    # What never comes to this depth, or lies behind the camera, stays where it is.
    points = np.where(seen, origin + reach * direction, center[:, None, None])
    return Choice(tuple(places.values()), np.moveaxis(points[list(places)], 0, -1))
