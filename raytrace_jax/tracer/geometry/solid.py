"""Solids: convex shapes that are inside of all of their faces, of which a sphere is the simplest.

A ray is inside of a face between `near` and `far`. So it is inside of the solid from the largest near to the smallest
far, if that comes later: one pass over the faces tells where a ray enters and leaves, and by which faces. Seen from
outside is the face of the largest near, seen from inside that of the smallest far. A ray that starts on a solid knows
it: within it ends at the smallest far, outside it never meets the solid again.

A face ends where it meets another one. There F of either face is 0 at the point where a ray meets the other one: an
event function of that edge. The edge is a *crease* to the face of the second largest near, past which the ray goes on
to that face; or the *outline* of the solid, to the face of the smallest far. From inside there are creases to the faces
of the second and of the third smallest far. A footprint that both cut is at a corner, and is subdivided.
A curved face has an outline of its own, where rays graze it: F of the ray's point that is deepest inside of it is 0.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...util.compilation import jit
from ...util.numerics import TINY_32, away_from_zero, dot, safe_normalize, safe_sqrt, select, vectors_to
from . import shapes
from .rays import Flags, Index, Integers, Number, Rays, Scalars, Vector, Vectors
from .shapes import Approach, CuttingPlane, Edge, Faces, Hit, Section, Shapes, ShapeType, across, surface_normal

T = TypeVar("T")

Kind = Literal["flat", "ball", "cylinder", "cap", "any"]
"""What a face is: which of the coefficients of F are not 0 (`shapes`)."""


class Chord(NamedTuple):
    """The part of a ray inside of a face, between two distances along it; of a face that it misses both are `along`."""

    near: Scalars
    far: Scalars
    along: Scalars  # Where the ray is deepest inside; infinite of a flat face.
    depth: Scalars  # Minus F there: positive where the ray meets a curved face.


def chord(o: Vectors, d: Vectors, face: Shapes, kind: Kind | None = None) -> Chord:
    """The chords of rays, with directions of length one, in one face or in one a ray; of any kind where none is told.

    The distances are counted from the ray's point nearest to the face's position, so that no digits are lost when that
    is far away (Haines et al., Precision improvements for ray/sphere intersection, Ray Tracing Gems, 2019).
    """
    kind = kind or ("ball" if face.axis is None else "any")
    face = lifted(face, o.ndim - 1)
    from_position = o - face.position
    if kind == "flat":
        cos = dot(face.normal, d)
        t, enters = -dot(face.normal, from_position) / away_from_zero(cos, TINY_32), cos < 0
        nowhere = jnp.full_like(t, jnp.inf)
        return Chord(jnp.where(enters, t, -jnp.inf), jnp.where(enters, jnp.inf, t), nowhere, nowhere)
    # The ray's point nearest to the position or, of a cylinder, to its axis.
    stretch, run, from_axis = 1.0, d, from_position
    if kind in ("cylinder", "any"):
        run, from_axis = across(d, face), across(from_position, face)
        stretch = jnp.maximum(dot(run, run), TINY_32)
    along = -dot(from_axis, run) / stretch
    off = from_axis + along * run
    discriminant = face.radius * face.radius - dot(off, off)
    if kind in ("ball", "cylinder"):
        half = safe_sqrt(discriminant / stretch)
        return Chord(along - half, along + half, along, face.curvature / 2 * discriminant)
    # From that point on 2 F = bend s^2 + 2 slope s + value. No difference of large numbers is taken, so that the bend
    # may become 0.
    slope = dot(face.normal, d)
    value = 2 * dot(face.normal, from_position + along * d) - face.curvature * discriminant
    bend = jnp.maximum(face.curvature * stretch, TINY_32)
    discriminant = slope * slope - bend * value
    larger = jnp.maximum(jnp.abs(slope) + safe_sqrt(discriminant), TINY_32)
    close, wide, enters = value / larger, larger / bend, slope < 0
    middle, meets = along - slope / bend, discriminant > 0
    near = jnp.where(meets, along + jnp.where(enters, close, -wide), middle)
    far = jnp.where(meets, along + jnp.where(enters, wide, -close), middle)
    return Chord(near, far, middle, discriminant / (2 * bend))


def lifted(face: Shapes, ray_axes: int) -> Shapes:
    """One face, shaped to broadcast over rays; faces that are one a ray stay."""
    if face.position.ndim > 1:
        return face
    return jax.tree.map(lambda x: x.reshape(x.shape + (1,) * ray_axes), face)


class Passage(NamedTuple):
    """The way of each ray through one solid."""

    chords: list[Chord]
    t_in: Scalars
    t_out: Scalars
    first: Integers | int  # The faces by which it enters and leaves, counted within the solid.
    last: Integers | int
    own: Flags  # It starts on this solid.
    within: Flags  # It meets the solid from inside, if at all.


def passage(kinds: Sequence[Kind], rays: Rays, faces: Faces, index: Index, least: Number) -> Passage:
    """The ways of rays through one solid, whose first face has that index."""
    chords = [chord(rays.o, rays.d, face, kind) for face, kind in zip(faces, kinds, strict=True)]
    own = belongs(rays.origin_shape, index, len(faces))
    within = own | (largest([each.near for each in chords])[0] < least)
    for k in range(len(faces)):
        near, far, along, depth = chords[k]
        # Within a solid a ray leaves the face that it starts on at the other end of its chord.
        far = jnp.where(rays.origin_shape == index + k, 2 * along, far)
        if len(faces) > 1 and rays.footprint is not None:
            gone = jnp.any(rays.footprint.passed == passed_face(index + k), axis=0)
            near, far = jnp.where(gone & ~within, -jnp.inf, near), jnp.where(gone & within, jnp.inf, far)
        chords[k] = Chord(near, far, along, depth)
    t_in, first = largest([each.near for each in chords])
    t_out, last = largest([-each.far for each in chords])
    # Beside a crease rounding may put the end before the start.
    t_out = jnp.where(own, jnp.maximum(-t_out, 0), -t_out)
    return Passage(chords, t_in, t_out, first, last, own, within)


def passed_face(face: Any) -> Any:
    """What stands in `Footprint.passed` for a face alone, past whose crease a ray still may meet the solid."""
    return -2 - face


def belongs(face: Integers, index: Index, count: int) -> Flags:
    """Whether faces are among those of a shape: of so many from an index on."""
    return face == index if count == 1 else (face >= index) & (face < index + count)


def largest(values: list[Scalars], *without: Integers | int) -> tuple[Scalars, Integers | int]:
    """The largest of values and its place, ray by ray; the values of some places do not count."""
    if len(values) == 1:
        return values[0], 0
    best, place = jnp.full_like(values[0], -jnp.inf), jnp.full(values[0].shape, -1, jnp.int32)
    for k, value in enumerate(values):
        more = functools.reduce(operator.and_, (place != k for place in without), value > best)
        best, place = jnp.where(more, value, best), jnp.where(more, k, place)
    return best, place


def hit(kinds: Sequence[Kind], rays: Rays, faces: Faces, index: Index, least: Number) -> Hit:
    way = passage(kinds, rays, faces, index, least)
    t, hits = meeting(way, rays, faces, least)
    return t, hits, index + face_met(way)


def meeting(way: Passage, rays: Rays, faces: Faces, least: Number) -> tuple[Scalars, Flags]:
    """Distance at which rays meet one solid, and whether they do."""
    hits = jnp.where(way.own, rays.inside, way.t_in < way.t_out)
    if not faces[0].settings.second_root:
        return way.t_in, hits & ~way.own & (way.t_in > least)
    t = jnp.where(way.within, way.t_out, way.t_in)
    # A ray within a solid always leaves it, however near to a crease it started.
    return t, hits & (way.own | (t > least))


def face_met(way: Passage) -> Integers | int:
    return 0 if len(way.chords) == 1 else jnp.where(way.within, way.last, way.first)


def distance(rays: Rays, shape: Shapes, outside: Flags) -> Scalars:
    passing = chord(rays.o, rays.d, shape)
    return jnp.where(outside, passing.near, passing.far)


def see(
    kinds: Sequence[Kind], rays: Rays, faces: Faces, index: Index, may_pass: Flags, least: Number
) -> shapes.Sighting:
    """The meeting of each footprint with one solid. Where its centre just misses the rim, a part of it still may."""
    way = passage(kinds, rays, faces, index, least)
    (t, seen), outside = meeting(way, rays, faces, least), ~way.within
    crease = far_edge = -1
    nears, fars = [each.near for each in way.chords], [-each.far for each in way.chords]
    (other_in, before), (other_out, behind) = largest(nears, way.first), largest(fars, way.last)
    if len(faces) > 1:
        crease = jnp.where(outside, before, behind)
        far_edge = jnp.where(outside, largest(fars, way.first)[1], largest(fars, way.last, behind)[1])

    # What the centre misses is beyond an edge of the face that comes last.
    face = chosen(faces, way.first)
    misses = may_pass & ~way.own & (way.t_in >= way.t_out) & (way.t_in > least)
    first, rim = way.t_in, silhouette(rays, face, chosen(way.chords, way.first), True)
    misses = misses & (shapes.is_within(rim) | (face.curvature == 0))
    if len(faces) == 1:
        # Of a ball the first distance at which any part may meet it counts: half the longest chord before its middle.
        longest = safe_sqrt(2 * face.radius * (rim.value + shapes.extent(rim)))
        first = jnp.maximum(first - longest, least)
    else:
        # It is beyond no more than one: without the face by which it would enter it meets the solid, or without that by
        # which it would leave.
        misses = misses & ((other_in < way.t_out) | (way.t_in < -other_out))
        misses = misses & shapes.is_within(border(rays, face, way.t_in, True, chosen(faces, far_edge), True))
    t, outside = jnp.where(misses, first, t), outside | misses
    return shapes.Sighting(t, seen | misses, outside, seen, face_met(way), crease, far_edge)


def chosen(values: Sequence[T], place: Integers | int) -> T:
    """Of pytrees the one at each ray's place; the last one where that is -1."""
    found = values[-1]
    for k, value in enumerate(values[:-1]):
        found = select(jnp.asarray(place == k), value, found)
    return found


def silhouette(rays: Rays, face: Shapes, passing: Chord, exists: Flags | bool) -> Edge:
    """The outline of a curved face, one a ray, where rays graze it; of a flat one it has no meaning."""
    along = jnp.where(jnp.isfinite(passing.along), passing.along, 0)
    n = surface_normal(rays.o + along * rays.d, face)
    slope = -jnp.sum(n * (rays.footprint.o + along * rays.footprint.d), 1)
    radius = 1 / jnp.where(face.curvature > 0, face.curvature, 1)
    return Edge(passing.depth, slope, jax.lax.stop_gradient(shapes.fraction_of_radius(slope, radius)), exists)


def edges(rays: Rays, shape: Shapes, outside: Flags, t: Scalars, near: Approach) -> tuple[Edge, ...]:
    curved = shape.curvature > 0
    shape = dataclasses.replace(shape, curvature=jnp.where(curved, shape.curvature, 1))
    passing = chord(rays.o, rays.d, shape)
    return (silhouette(rays, shape, passing, outside & curved),)


def border(rays: Rays, own: Shapes, t: Scalars, outside: Flags | bool, other: Shapes, is_outline: Flags | bool) -> Edge:
    """The edge in which the faces that rays meet at t end on other faces of the same solids, one of each a ray.

    Of the two faces the one that rays graze more is taken as a function, at the point where they meet the other one:
    there it is linear.
    """
    fixed_rays, fixed_own, fixed_other, fixed_t = jax.lax.stop_gradient((rays, own, other, t))
    o, d, enters = fixed_rays.o, fixed_rays.d, jnp.asarray(outside) & ~jnp.asarray(is_outline)
    passing = chord(o, d, fixed_other)
    t_other = jnp.where(enters, passing.near, passing.far)

    def slope_at(at: Scalars, face: Shapes) -> Scalars:
        return dot(surface_normal(o + at * d, face), d)

    # Of a curved face only the side counts on which rays meet it.
    by_own = jnp.abs(slope_at(fixed_t, fixed_own)) >= jnp.abs(slope_at(t_other, fixed_other))
    by_own |= (jnp.abs(t_other) > 1e3 * fixed_t) | ((slope_at(t_other, fixed_own) < 0) != outside)
    exists = ~by_own | ((slope_at(fixed_t, fixed_other) < 0) == enters)
    (steep, at), grazed = select(by_own, ((own, fixed_t), other), ((other, t_other), own))
    side = jnp.where(by_own, jnp.where(outside, -1, 1), jnp.where(enters, -1, 1)).astype(t.dtype)
    at = shapes.hit_distance(at, rays.o, rays.d, steep, shapes.GRAZING, side)
    near = shapes.approach(rays, steep, at, side)
    # Behind a crease the other face's point is outside of the own one.
    sign = jnp.where(by_own | is_outline, -1, 1)
    fixed_grazed, fixed_at = jax.lax.stop_gradient((grazed, at))
    n = surface_normal(o + fixed_at * d, fixed_grazed)
    slope = sign * (jnp.sum(n * (rays.footprint.o + fixed_at * rays.footprint.d), 1) + dot(n, d) * near.slope)
    # What is narrower than the footprint has several edges in it: they fade, as a small ball's do.
    width = jnp.minimum(fixed_other.size, 1 / jnp.maximum(fixed_grazed.curvature, TINY_32))
    fraction = jnp.minimum(near.fraction, shapes.fraction_of_radius(slope, width))
    return Edge(sign * shapes.surface_value(rays.o + at * rays.d, grazed), slope, fraction, exists)


def is_inside(p: Vectors, faces: Faces) -> Flags:
    return functools.reduce(operator.and_, (shapes.surface_value(p, lifted(face, p.ndim - 1)) < 0 for face in faces))


def clearance(kinds: Sequence[Kind], o: Vectors, light: Vector, faces: Faces, unit: Number) -> Scalars:
    """How far outside of a solid the way from `o` to a light stays; for a light within it, how far `o` is inside.

    Let F of a point be the largest of all faces' F. On the way it is least between where the way enters and where it
    leaves; there the F of the two faces, weighted so that their slopes along the way cancel, is that least one's value
    and has its derivative.
    """
    toward = vectors_to(light, o)
    length, d = safe_sqrt(dot(toward, toward)), safe_normalize(toward)
    chords = [chord(o, d, face, kind) for face, kind in zip(faces, kinds, strict=True)]
    every = [lifted(face, o.ndim - 1) for face in faces]
    light_inside = is_inside(light, faces)
    within = -functools.reduce(jnp.maximum, (shapes.surface_value(o, face) for face in every))
    if len(faces) == 1:
        outside = shapes.surface_value(o + jnp.clip(chords[0].along, 0, length) * d, every[0])
        return jnp.where(light_inside, within, outside)
    (t_in, first), (t_out, last) = largest([each.near for each in chords]), largest([-each.far for each in chords])
    s = jax.lax.stop_gradient(jnp.clip((t_in - t_out) / 2, 0, length))
    p = o + s * d
    entry, exit_ = (chosen([shapes.surface_value(p, face) for face in every], place) for place in (first, last))
    falls, rises = (chosen([dot(surface_normal(p, face), d) for face in every], place) for place in (first, last))
    weight = jnp.clip(rises / jnp.maximum(rises - falls, TINY_32), 0, 1)
    # A way that ends before the solid is clear by the face that it would enter by, one that begins behind it by the
    # other one.
    weight = jax.lax.stop_gradient(jnp.where(s <= 0, 0, jnp.where(s >= length, 1, weight)))
    outside = weight * entry + (1 - weight) * exit_
    # Nowhere is the way deeper in the solid than it is in any curved face.
    for each, kind in zip(chords, kinds, strict=True):
        outside = outside if kind == "flat" else jnp.maximum(outside, -each.depth)
    return jnp.where(light_inside, within, outside)


def inwards(face: Shapes) -> Vectors:
    """A point of each face, of a flat one a little behind it: the mean of all faces of a solid is inside of it."""
    return face.position - 0.3 * jnp.where(jnp.isfinite(face.size), face.size, 0) * face.normal


def middles(shapes: Shapes) -> Float[Array, "3 _"]:
    """A point inside of each shape of a scene; of a plane one on it."""
    count = len(shapes.types)
    sums = jax.ops.segment_sum(inwards(shapes).T, shapes.owners, count).T
    return sums / jnp.asarray(np.subtract(shapes.ends, shapes.starts), sums.dtype)


@functools.partial(jit, static_argnames="kinds")
def stretch_inside(kinds: Sequence[Kind], faces: Faces, o: Vectors, d: Vectors) -> tuple[Scalars, Scalars]:
    """Where lines through points along directions enter and leave a solid."""
    chords = [chord(o, d, face, kind) for face, kind in zip(faces, kinds, strict=True)]
    return largest([each.near for each in chords])[0], -largest([-each.far for each in chords])[0]


def section(kinds: Sequence[Kind], faces: Faces, drawing: CuttingPlane, reach: float) -> Section:
    # A tenth of a degree apart.
    angle = np.linspace(0, 2 * np.pi, 3601)
    around = np.multiply.outer(drawing.right, np.cos(angle)) + np.multiply.outer(drawing.up, np.sin(angle))

    def way(*lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        o, d = (jnp.asarray(x, faces[0].radius.dtype) for x in np.broadcast_arrays(*lines))
        t_in, t_out = stretch_inside(kinds, faces, o, d)
        return np.asarray(t_in), np.asarray(t_out)

    size, middle = float(faces[0].size), np.mean([np.asarray(inwards(face), np.float64) for face in faces], axis=0)
    # The outline: how far from there a line across the drawing still meets the solid, found by halving.
    low, step = np.zeros(angle.size), 1e3 * size
    for _ in range(32):
        step /= 2
        t_in, t_out = way(middle[:, None] + (low + step) * around, drawing.normal[:, None])
        low = np.where(t_in < t_out, low + step, low)
    outline = drawing.project((middle[:, None] + low * around).T)

    # The cut, as seen from the mean of its points among many.
    off = drawing.normal * ((middle - drawing.center) @ drawing.normal)
    points = (middle - off)[:, None, None] + np.linspace(0, 1, 50)[:, None] * (low * around)[:, None, ::30]
    t_in, t_out = way(points, drawing.right[:, None, None])
    inside = (t_in < 0) & (t_out > 0)
    if not inside.any():
        return Section(shapes.NO_POINTS, True, outline)
    start = points[:, inside].mean(axis=1)[:, None]
    cut = start + way(start, around)[1] * around
    return Section(drawing.project(cut.T), True, outline)


def solid(coefficients: Callable[[Any], dict[str, Array]], *kinds: Kind) -> ShapeType:
    """The type of a solid that has faces of these kinds."""

    def of(function: Any) -> Any:
        return functools.partial(function, kinds)

    return ShapeType(
        True, len(kinds), coefficients, of(hit), distance, of(see), edges, of(clearance), of(section), has_inside=True
    )
