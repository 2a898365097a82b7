"""Slabs as rays meet them: planes of one normal, each with all that is behind it."""

import dataclasses

import jax
import jax.numpy as jnp

from ..util.numerics import normalize
from .scene import Scene
from .schema import NO_BLOCK
from .structs import Materials, Planes
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
    count, dtype = len(slabs.names), slabs.thickness.dtype
    new = {one.name: jnp.zeros((*one.shape, count + 1), dtype) for one in BLOCK_TYPES["material"][0].continuous}
    new |= {"ior": jnp.append(slabs.wall_ior, jnp.ones(1, dtype)), "transmission": jnp.ones(count + 1, dtype)}
    numbers = {name: jnp.concatenate([getattr(old, name), values], axis=-1) for name, values in new.items()}
    names = (*old.names, *(f"{name} wall" for name in slabs.names), "air behind")
    materials = Materials(names=names, texture=(*old.texture, *[NO_BLOCK] * (count + 1)), **numbers)

    def columns(group) -> tuple[int, ...]:
        # Materials of other types come after the new ones.
        return tuple(column + (count + 1) * (column >= len(old.names)) for column in group.material)

    walls, air = tuple(range(len(old.names), len(names) - 1)), (len(names) - 1,) * count
    wall = jnp.where(slabs.wall > 0, slabs.wall, jax.lax.stop_gradient(slabs.wall))
    depth = jnp.stack([slabs.thickness, slabs.thickness - wall, wall, jnp.zeros_like(wall)])
    # As a plane's: a normal of any length, whose squares neither overflow nor vanish.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(slabs.normal), axis=0))
    point = slabs.point[:, None] - depth * normalize(slabs.normal / largest)[:, None]
    normal = jnp.broadcast_to(slabs.normal[:, None], point.shape)
    planes = Planes(
        names=(*scene.planes.names, *(f"{name} {part}" for part in PARTS for name in slabs.names)),
        material=(*columns(scene.planes), *air, *walls, *columns(slabs), *walls),
        normal=jnp.concatenate([scene.planes.normal, normal.reshape(3, -1)], axis=-1),
        point=jnp.concatenate([scene.planes.point, point.reshape(3, -1)], axis=-1),
    )
    none = jax.tree.map(lambda x: x[..., :0], dataclasses.replace(slabs, names=(), material=()))
    parts = {"materials": materials, "planes": planes, "slabs": none, "shape_order": tuple(surface_owners(scene))}
    for name in ("spheres", "rectangles"):
        group = getattr(scene, name)
        parts[name] = dataclasses.replace(group, material=columns(group))
    return dataclasses.replace(scene, **parts)
