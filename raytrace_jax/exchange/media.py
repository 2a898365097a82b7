"""The medium on either side of each surface of a scene, which the tracer's own rule says."""

from collections import Counter
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from raytrace_jax.scene.scene import Scene, least_distance
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import NO_SHAPE
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.physical import innermost, media_at
from raytrace_jax.tracer.world import World, prepare_world

DIRECTIONS = np.random.default_rng(0).normal(size=(3, 15))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=0)
"""Directions all around, none of them along an axis."""


class SurfaceMedia(NamedTuple):
    """Shapes whose glass is there, by their places in the file; None is vacuum."""

    sides: tuple[tuple[int | None, int | None], ...]  # Of each surface what is outside and inside of it.
    hidden: tuple[bool, ...]  # Whether a surface is that of an earlier shape, with which it is crossed.
    eye: int | None  # What the camera is in.
    far: frozenset[int | None]  # What is far away, where a background is.


def surface_media(scene: Scene, settings: ResolvedSettings) -> SurfaceMedia:
    """The media of a physical scene, of which slabs are planes; where a surface is cut, those of most of it."""
    world = prepare_world(scene, settings)
    shapes, unit = world.shapes, float(world.unit)
    count, (position, normal) = len(shapes.types), np.asarray([shapes.position, shapes.normal], np.float64)
    # Points of a sphere all around, of a plane near the point that the file has, of a rectangle its middle.
    n = np.repeat(normal[:, None], DIRECTIONS.shape[1], axis=1)
    n[..., is_sphere := np.array(shapes.types) == "sphere"] = DIRECTIONS[..., None]
    along = DIRECTIONS[..., None] - normal[:, None] * np.einsum("is,ik->ks", normal, DIRECTIONS)
    reach = np.where(np.array(shapes.types) == "plane", unit, 0.0)
    offsets = np.where(is_sphere, np.asarray(shapes.radius) * n, reach * along)
    owners = np.broadcast_to(np.arange(count), n.shape[1:])
    found = []
    if count:
        hits = _hits(world, position[:, None] + offsets, n, owners)
        for from_outside in (True, False):
            front = media_at(world, hits, jnp.full(hits.shape.shape, from_outside), settings).front
            found.append(np.asarray(front).reshape(owners.shape))
    sides = tuple(
        Counter(zip(*(_places(side[:, k]) for side in found), strict=True)).most_common(1)[0][0] for k in range(count)
    )
    eye = np.asarray(scene.camera.viewpoint, np.float64)[:, None]
    # Far beyond all that the camera shows.
    around = np.concatenate([eye, eye + 1e6 * unit * DIRECTIONS], axis=1)
    here = np.full(around.shape[1], NO_SHAPE)
    there = here
    if count:
        there = np.asarray(innermost(world, _hits(world, around, np.zeros_like(around), here))[0][0])
    at_eye, *far = _places(there)
    return SurfaceMedia(sides, _hidden(world), at_eye, frozenset(far))


def _places(shapes: np.ndarray) -> list[int | None]:
    return [None if k == NO_SHAPE else k for k in shapes.tolist()]


def _hits(world: World, p: np.ndarray, n: np.ndarray, shape: np.ndarray) -> Hits:
    dtype = world.shapes.position.dtype
    points, normals = (jnp.asarray(vectors.reshape(3, -1), dtype) for vectors in (p, n))
    nothing = jnp.zeros_like(points[0])
    return Hits(nothing == 0, nothing, points, normals, jnp.asarray(shape.ravel(), jnp.int32), nothing)


def _hidden(world: World) -> tuple[bool, ...]:
    """Whether each surface is an earlier one's: any that the tracer hides, and of glass what is too near to part.

    Planes that look away from one another are among them, as of oil on water.
    """
    shapes, types, close = world.shapes, world.shapes.types, float(least_distance(world.unit)) / 2
    place, normal = (np.asarray(values, np.float64).T for values in (shapes.position, shapes.normal))
    radius, glass = np.asarray(shapes.radius, np.float64), np.asarray(world.materials.transmission) > 0
    hidden = [bool(one) for one in np.asarray(shapes.hidden)] if shapes.hidden is not None else [False] * len(types)

    def is_same(a: int, b: int) -> bool:
        apart = place[a] - place[b]
        if types[a] == "sphere":
            return bool(np.linalg.norm(apart) + abs(radius[a] - radius[b]) < close)
        parallel = np.linalg.norm(np.cross(normal[a], normal[b])) < PARALLEL
        return types[a] == "plane" and bool(parallel and abs(apart @ normal[a]) < close)

    for b in range(len(types)):
        earlier = [a for a in range(b) if types[a] == types[b] and glass[a] and glass[b]]
        hidden[b] = hidden[b] or any(is_same(a, b) for a in earlier)
    return tuple(hidden)


PARALLEL = 1e-6
"""Two planes are parallel where the sine of the angle between them is less: float32 has no finer ones."""
