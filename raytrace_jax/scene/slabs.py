"""Slabs as rays meet them: planes of one normal, each with all that is behind it."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from ..util.numerics import direction
from .scene import Scene
from .schema import NO_BLOCK
from .structs import Planes
from .table import BLOCK_TYPES

PARTS = ("air", "back", "inside", "front")
"""What is behind each plane of a slab. Of media that overlap the first in the file decides: the last plane is the first
that a ray from the front meets."""


def surface_owners(scene: Scene) -> dict[str, int]:
    """The surfaces that rays meet, each with the place of its shape in the file: in that of `tank` is `tank inside`.

    No name in a file has a space.
    """
    ends = {name: [f"{name} {part}" for part in PARTS] for name in scene.slabs.names}
    return {surface: k for k, name in enumerate(scene.shape_order) for surface in ends.get(name, [name])}


def with_planes(scene: Scene) -> Scene:
    """The scene with four planes in place of each slab, and their materials; a function of arrays that may be traced.

    Where there are no walls two planes coincide, and the first of them is all that is there. The picture does not
    change then by a wall's thickness, for planes that coincide are one.
    """
    slabs, old = scene.slabs, scene.materials
    if not slabs.names:
        return scene
    count, first = len(slabs.names), len(old.names)
    black = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], count + 1), x.dtype), old)
    walls_and_air = dataclasses.replace(
        black,
        names=(*(f"{name} wall" for name in slabs.names), "air behind"),
        texture=(NO_BLOCK,) * (count + 1),
        ior=jnp.append(slabs.wall_ior, jnp.ones_like(black.ior[:1])),
        transmission=jnp.ones_like(black.transmission),
    )
    walls, air = tuple(range(first, first + count)), (first + count,) * count

    def moved(group: Any) -> Any:
        # Materials of other types come after the new ones.
        columns = tuple(column + (count + 1) * (column >= first) for column in group.material)
        return dataclasses.replace(group, material=columns)

    wall = jnp.where(slabs.wall > 0, slabs.wall, jax.lax.stop_gradient(slabs.wall))
    depth = jnp.stack([slabs.thickness, slabs.thickness - wall, wall, jnp.zeros_like(wall)])
    point = slabs.point[:, None] - depth * direction(slabs.normal)[:, None]
    faces = Planes(
        names=tuple(f"{name} {part}" for part in PARTS for name in slabs.names),
        material=(*air, *walls, *moved(slabs).material, *walls),
        normal=jnp.broadcast_to(slabs.normal[:, None], point.shape).reshape(3, -1),
        point=point.reshape(3, -1),
    )
    types = (row for rows in BLOCK_TYPES.values() for row in rows if row.is_shape)
    shapes = {row.group: moved(getattr(scene, row.group)) for row in types}
    shapes["planes"] = _joined(shapes["planes"], faces)
    shapes["slabs"] = jax.tree.map(lambda x: x[..., :0], dataclasses.replace(slabs, names=(), material=()))
    materials = _joined(old, walls_and_air)
    return dataclasses.replace(scene, materials=materials, **shapes, shape_order=tuple(surface_owners(scene)))


def _joined(first: Any, second: Any) -> Any:
    """The blocks of two structs of one type as one struct."""

    def both(old: Any, new: Any) -> Any:
        return old + new if isinstance(old, tuple) else jnp.append(old, new, axis=-1)

    return type(first)(**{name: both(values, getattr(second, name)) for name, values in vars(first).items()})
