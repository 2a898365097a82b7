"""The medium on either side of each surface of a scene, which the tracer's own rule says."""

import itertools
from collections import Counter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.linalg import norm

from ..scene.scene import Scene, least_distance
from ..tracer.geometry.intersection import SurfaceInteraction
from ..tracer.geometry.rays import NO_SHAPE, Integers, Vectors
from ..tracer.geometry.shape_types import all_faces
from ..tracer.geometry.shapes import Faces, Shapes, surface_normal
from ..tracer.geometry.solid import chord, is_inside, middles
from ..tracer.settings import ResolvedSettings
from ..tracer.shading.physical import innermost, media_at
from ..tracer.world import World, prepare_world

DIRECTIONS = np.random.default_rng(0).normal(size=(3, 60))
DIRECTIONS /= norm(DIRECTIONS, axis=0)
"""Directions all around, none of them along an axis."""
PLACES = np.random.default_rng(1).uniform(-1, 1, size=(2, 60))
PLACES[:, :4] = [-1, -1, 1, 1], [-1, 1, -1, 1]
"""Places on a rectangle in halves of its sides; the first are its corners."""


class Surface(NamedTuple):
    """The faces of a shape in double precision, which is inside of all of them, and points of it."""

    faces: Faces
    points: np.ndarray

    def holds(self, other: "Surface") -> np.ndarray:
        """Which points of another one are inside."""
        return np.asarray(is_inside(*jax.tree.map(jnp.asarray, (other.points, self.faces))))


class SurfaceMedia(NamedTuple):
    """Shapes whose glass is there, by their places in the file; None is vacuum."""

    sides: tuple[tuple[int | None, int | None], ...]  # Of each surface what is outside and inside of it.
    around: tuple[frozenset[int | None], ...]  # All that a surface is in, of which parts may lie in several media.
    hidden: tuple[bool, ...]  # Whether a surface is that of an earlier shape, with which it is crossed.
    eye: int | None  # What the camera is in.
    far: frozenset[int | None]  # What is far away, where a background is.
    surfaces: tuple[Surface, ...]


def surface_media(scene: Scene, settings: ResolvedSettings) -> SurfaceMedia:
    """The media of a physical scene, of which slabs are planes; where a surface is cut, those of most of it."""
    world, points, sides, there = jax.device_get(_asked(scene.alone(), settings))
    place_of = {start: place for place, start in enumerate(world.shapes.starts)}

    def places(shapes: np.ndarray) -> list[int | None]:
        return [place_of.get(k) for k in shapes.tolist()]

    pairs = [list(zip(*(places(side[:, k]) for side in sides), strict=True)) for k in range(len(place_of))]
    most = tuple(Counter(pair).most_common(1)[0][0] for pair in pairs)
    around = tuple(frozenset(itertools.chain.from_iterable(pair)) for pair in pairs)
    eye, *far = places(there)
    shapes, points = jax.tree.map(lambda x: np.asarray(x, float), (world.shapes, points))
    surfaces = tuple(Surface(faces, points[:, :, k]) for k, faces in enumerate(all_faces(shapes)))
    return SurfaceMedia(most, around, _hidden(world), eye, frozenset(far), surfaces)


@eqx.filter_jit
def _asked(scene: Scene, settings: ResolvedSettings) -> tuple[World, Vectors, list[Integers], Integers]:
    """The world; points of each shape; what is outside and inside of it there; and what is at the eye and far away."""
    world = prepare_world(scene, settings, pyramids=())
    shapes, unit, directions = world.shapes, world.unit, jnp.asarray(DIRECTIONS, world.shapes.position.dtype)
    starts, eye = np.array(shapes.starts, int), jnp.asarray(scene.camera.viewpoint, directions.dtype)[:, None]
    # Far beyond all that the camera shows.
    around = jnp.concatenate([eye, eye + 1e6 * unit * directions], axis=1)
    nowhere = jnp.full(around.shape[1], NO_SHAPE)
    if not len(starts):
        return world, around, [], nowhere
    directions = directions[..., None]
    points, n = _exits(shapes, directions)
    # Points of a plane near the one that the file has, of a rectangle all over it.
    place, normal = shapes.position[:, None, starts], shapes.normal[:, None, starts]
    is_flat, is_plane = (np.isin(shapes.types, names) for names in (("planes", "rectangles"), "planes"))
    along = directions - normal * jnp.sum(normal * directions, axis=0)
    flat = place + jnp.where(is_plane, unit, 0.0) * along
    if shapes.axes is not None:
        flat += jnp.einsum("ak,ais->iks", jnp.asarray(PLACES, flat.dtype), shapes.axes[..., starts])
    points, n = jnp.where(is_flat, flat, points), jnp.where(is_flat, normal, n)
    owners = jnp.broadcast_to(starts, points.shape[1:])
    si = _hits(points, n, owners)
    fronts = []
    for from_outside in (True, False):
        front = media_at(world, si, jnp.full(si.shape.shape, from_outside)).front
        assert front is not None, "this model has media"
        fronts.append(front.reshape(owners.shape))
    return world, points, fronts, innermost(world, _hits(around, jnp.zeros_like(around), nowhere))[0][0]


def _exits(shapes: Shapes, d: Vectors) -> tuple[Vectors, Vectors]:
    """Where rays from within each shape leave it, and its normals there, one column a shape; of flat ones anything."""
    count, faces = len(shapes.types), len(shapes.radius)
    owners, middle = shapes.owners, middles(shapes)
    each = jax.tree.map(lambda column: column[..., None, :], shapes)
    o, lines = jnp.broadcast_arrays(middle[:, None, owners], d)
    far = chord(o, lines, each, "any").far
    t = jax.ops.segment_min(far.T, owners, count).T
    points = middle[:, None] + t * d
    last = jax.ops.segment_max(jnp.where(far == t[:, owners], np.arange(faces), -1).T, owners, count).T
    return points, surface_normal(points[..., owners], each)[:, np.arange(len(t))[:, None], last]


def _hits(p: Vectors, n: Vectors, shape: Integers) -> SurfaceInteraction:
    points, normals = p.reshape(3, -1), n.reshape(3, -1)
    nothing = jnp.zeros_like(points[0])
    return SurfaceInteraction(nothing == 0, nothing, points, normals, shape.ravel().astype(jnp.int32), nothing)


def _hidden(world: World) -> tuple[bool, ...]:
    """Whether each surface is an earlier one's: any that the tracer hides, and of glass what is too near to part.

    Planes that look away from one another are among them, as of oil on water.
    """
    shapes, close = world.shapes, float(least_distance(jnp.asarray(world.unit))) / 2
    starts = np.array(shapes.starts, int)
    types, is_glass = np.array(shapes.types, str), np.asarray(world.materials.transmission)[starts] > 0
    columns = (shapes.position, shapes.normal, shapes.radius)
    place, normal, radius = (np.asarray(x.T, np.float64)[starts] for x in columns)
    # Of each pair of shapes, by rows and columns.
    apart = place[:, None] - place
    is_one_ball = norm(apart, axis=-1) + np.abs(radius[:, None] - radius) < close
    is_parallel = norm(np.cross(normal[:, None], normal), axis=-1) < PARALLEL
    is_one_plane = is_parallel & (np.abs(np.einsum("abi,ai->ab", apart, normal)) < close)
    is_same = np.where(types == "spheres", is_one_ball, is_one_plane & (types == "planes"))
    is_same &= (types[:, None] == types) & is_glass[:, None] & is_glass
    hidden = np.triu(is_same, 1).any(axis=0)
    return tuple((hidden if shapes.hidden is None else hidden | shapes.hidden[starts]).tolist())


PARALLEL = 1e-6
"""Two planes are parallel where the sine of the angle between them is less: float32 has no finer ones."""
