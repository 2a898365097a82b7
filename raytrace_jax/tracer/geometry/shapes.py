"""All faces of all shapes as one type of surface, and all that a type of shape says of itself.

Every face lies on the zero of `F(p) = n.q + k/2 (|q|^2 - (a.q)^2 - r^2)` with `q = p - position`, the normal n, the
curvature k, the axis a and the radius r. A plane has k = 0, a sphere n = 0, a = 0 and k = 1/r, a cylinder n = 0,
k = 1/r and an axis of length one; of a cap, as a lens has it, a = 0, r = 0, and the position is its vertex. On the
surface the gradient of F, `n + k (q - (a.q) a)`, is the outward unit normal, which gives one formula for the normal
and, by the implicit function theorem, one for the derivative of the hit. F is negative inside.

Planes, rectangles and spheres have one face. A body, such as a box, has several of one material: it is inside of all of
them.

Rays, footprints, shadows and figures meet a shape through its `ShapeType`: a new type is a file beside this one with
one of these, and a row in the table of `shape_types`. Among it are the edges that a ray's footprint may straddle, as
event functions and their derivatives over the footprint; `visibility.look` tells what they are for. All derivatives
over the footprint are constants to the parameter derivative, but for those of a silhouette: a ball that grows as it
recedes keeps its outline to the last digit.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...util.numerics import TINY_32, away_from_zero, dot, is_zero, with_lower_ranks
from ..settings import ResolvedSettings
from .rays import Axes, Flags, Index, Integers, Pairs, Rays, Scalars, Vectors

LEAST_COS = 1e-6
"""A flat shape is not hit by a ray whose direction is closer than this to parallel (course model, 1.2)."""


OneOrAll = Float[Array, " *#rays"]
"""A number for each ray, or one for all."""


class Shapes(eqx.Module):
    """Faces as the coefficients of F, `normal` and `axis` of length one or 0; those of a scene, or one for each ray.

    The faces of a scene are those of one shape after the other, in the order of the file. A face stands for its shape
    wherever that is asked for: it has the shape's material, size and so on.
    """

    types: tuple[str, ...] = eqx.field(static=True)  # Of all shapes of the scene, in the order of the file.
    starts: tuple[int, ...] = eqx.field(static=True)  # The place of each shape's first face.
    settings: ResolvedSettings = eqx.field(static=True)  # How the picture is traced.
    type: Int[Array, " *shapes"]  # The number of its type, as `shape_types.present_types` has them.
    position: Float[Array, "3 *shapes"]
    normal: Float[Array, "3 *shapes"]
    curvature: Float[Array, " *shapes"]
    radius: Float[Array, " *shapes"]
    size: Float[Array, " *shapes"]  # The radius of a ball of the shape's volume, infinite of what has no end.
    axis: Float[Array, "3 *shapes"] | None = None  # None where no shape of the scene is a body.
    # Two half-side vectors of shapes with sides, from their positions; 0 for others, None where all are others.
    axes: Float[Array, "2 3 *shapes"] | None = None
    hidden: Bool[Array, " *shapes"] | None = None  # An earlier shape has the same surface, and is all that is met.

    @property
    def ends(self) -> tuple[int, ...]:
        """The place behind each shape's last face."""
        return (*self.starts, len(self.radius))[1:]

    @property
    def owners(self) -> Int[np.ndarray, " faces"]:
        """The place of each face's shape among all shapes."""
        return np.repeat(np.arange(len(self.types)), np.subtract(self.ends, self.starts))

    @property
    def is_met(self) -> Flags | bool:
        return True if self.hidden is None else ~self.hidden


def across(way: Vectors, shape: Shapes) -> Vectors:
    """The part of vectors across the axes of shapes, one shape a ray; all of it where there are none."""
    return way if shape.axis is None else way - dot(shape.axis, way) * shape.axis


def surface_value(p: Vectors, shape: Shapes) -> Scalars:
    """F at points `p`, one face a ray: negative inside of a sphere, behind a plane."""
    from_position = p - shape.position
    from_axis = across(from_position, shape)
    return dot(shape.normal, from_position) + shape.curvature / 2 * (
        dot(from_axis, from_axis) - shape.radius * shape.radius
    )


def surface_normal(p: Vectors, shape: Shapes) -> Vectors:
    """The gradient of F: on the surface the outward unit normal; one face a ray."""
    return shape.normal + shape.curvature * across(p - shape.position, shape)


def divisor(cos: Scalars, least: OneOrAll | float, side: OneOrAll | None = None) -> Scalars:
    """A cosine of incidence to divide by: `cos`, or `least` with its sign where it is smaller in magnitude.

    `side` is the sign where it is known, -1 for a surface that faces the ray: where the ray only just touches a sphere,
    rounding must not choose.
    """
    return away_from_zero(cos, least) if side is None else side * jnp.maximum(side * cos, least)


@jax.custom_jvp
def hit_distance(
    t: Scalars,
    o: Vectors,
    d: Vectors,
    shape: Shapes,
    least_cos: OneOrAll | float = LEAST_COS,
    side: OneOrAll | None = None,
) -> Scalars:
    """`t` itself, where it is known to be the distance at which a ray meets its shape, made differentiable.

    `F(o + t d; shape) = 0` gives `dt = -dF / (n.d)`, with dF the change of F at fixed t: one division a ray, whatever
    number of shapes had to be searched. At grazing incidence dt is unbounded in truth; the divisor stops at
    `least_cos`, with its `side` as in `divisor`. The derivative of the given `t` is ignored.

    The formula holds wherever the ray meets the shape, and its t is this function's own result. So derivatives of any
    order are exact. Of a sphere F's change with the curvature is 0 on the surface, and stays 0.
    """
    return t


@with_lower_ranks
def _hit_distance_jvp(primals, tangents):
    _, o, d, shape, least_cos, side = primals
    t = hit_distance(*primals)
    _, o_dot, d_dot, shape_dot, *_ = tangents
    p = o + t * d
    n = surface_normal(p, shape)
    from_position = p - shape.position
    # dF term by term; what is not differentiated costs nothing.
    derivatives = (
        (o_dot, lambda change: dot(n, change)),
        (d_dot, lambda change: t * dot(n, change)),
        (shape_dot.position, lambda change: -dot(n, change)),
        (shape_dot.normal, lambda change: dot(from_position, change)),
        (shape_dot.radius, lambda change: -shape.curvature * shape.radius * change),
    )
    if shape.axis is not None:
        along, from_axis = dot(shape.axis, from_position), across(from_position, shape)
        bulge = (dot(from_axis, from_axis) - shape.radius * shape.radius) / 2
        derivatives += (
            (shape_dot.axis, lambda change: -shape.curvature * along * dot(from_position, change)),
            (shape_dot.curvature, lambda change: bulge * change),
        )
    terms = [derivative(change) for change, derivative in derivatives if not is_zero(change)]
    if not terms:
        return t, jnp.zeros_like(t)
    cos = dot(n, d)
    return t, -functools.reduce(operator.add, terms) / divisor(cos, least_cos, side)


hit_distance.defjvp(_hit_distance_jvp, symbolic_zeros=True)

FADE_COS = 0.4
"""Edges fade where the cosine of incidence changes by more than this fraction of itself towards the footprint's sides.

0.2 makes pictures of two scenes worse; 0.8 is a little worse on one and better on the other (experiments/tuning)."""

GRAZING = 1e-3
"""Footprints on a surface stop growing at this cosine of incidence. 1e-4 to 1e-2 do the same (experiments/tuning)."""


class Edge(eqx.Module):
    value: Scalars  # The event function, positive where the nearest surface is present.
    slope: Pairs  # Its derivatives along the footprint's two axes.
    fraction: Scalars  # How much of the footprint, side to side, the linear event function is good for.
    exists: Flags | bool = True


class Approach(eqx.Module):
    """The change of the distance to a surface over a footprint; constant to the parameter derivative."""

    slope: Pairs  # Derivatives of the distance along the footprint's two axes.
    fraction: Scalars  # How much of the footprint that is about right for: the cosine of incidence changes little.


def approach(rays: Rays, shape: Shapes, t: Scalars, side: Scalars | None = None) -> Approach:
    """The approach of each footprint to a shape that is hit at t; `side` as in `shapes.divisor`, None for flat ones."""
    rays, shape, t = jax.lax.stop_gradient((rays, shape, t))
    n = shape.normal if side is None else surface_normal(rays.o + t * rays.d, shape)
    cos = dot(n, rays.d)
    moves = rays.footprint.o + t * rays.footprint.d
    slope = jnp.sum(n * moves, 1) * (-1 / divisor(cos, GRAZING, side))
    change = jnp.sum(jnp.abs(jnp.sum(n * rays.footprint.d, 1)), 0)
    if side is not None:
        change += shape.curvature * jnp.sqrt(jnp.sum(moves * moves, (0, 1)) + TINY_32)
    # Distances of edges are divided by the fraction, which therefore stays above 0.
    return Approach(slope, jnp.clip(2 * FADE_COS * jnp.abs(cos) / (change + TINY_32), 1e-3, 1))


def fraction_of_radius(slope: Pairs, radius: Scalars) -> Scalars:
    """The fraction of the footprint over which an event function changes by no more than a radius (or half a side)."""
    return jnp.clip(radius / (jnp.sum(jnp.abs(slope), 0) + TINY_32), 1e-3, 1)


def extent(edge: Edge) -> Scalars:
    """The change of the event function from the footprint's centre to its farthest corner."""
    return jnp.sum(jnp.abs(edge.slope), 0) / 2


def is_within(edge: Edge) -> Flags:
    """Whether more of the footprint than a corner, in which almost nothing lies, is on the near side of the edge."""
    return edge.value > -0.9995 * edge.fraction * extent(edge)


Faces = Sequence[Shapes]
"""The faces of one shape."""

Hit = tuple[Scalars, Flags, Integers | Index]
"""The distance at which each ray may meet a shape, whether it does, and the index of the face that it meets."""


class Sighting(NamedTuple):
    """The meeting of each footprint with one shape."""

    t: Scalars  # Distance to where it is met first, in world units.
    seen: Flags  # Any part of the footprint that matters meets it.
    outside: Flags  # It is a solid that is seen from outside of it.
    centered: Flags  # The footprint's centre meets it, not only a part beyond its edge.
    # The places in the shape of the face that is met and of those in which it ends, -1 for none: at a crease the shape
    # goes on. The far edge is that with a face by which rays leave: from outside the outline, past which the shape does
    # not go on; from inside a second crease.
    face: Integers | int = 0
    crease: Integers | int = -1
    far_edge: Integers | int = -1


class CuttingPlane(NamedTuple):
    """The plane of a drawing: a point of it, and unit vectors to the right, upwards and towards the beholder."""

    center: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def project(self, p: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 2"]:
        return (p - self.center) @ np.column_stack([self.right, self.up])


class Section(NamedTuple):
    """A shape in a drawing, as points of the drawing's plane in order; without points there is nothing."""

    cut: Float[np.ndarray, "points 2"]  # The corners of an area in which the plane cuts it, or the points of a line.
    is_area: bool
    outline: Float[np.ndarray, "corners 2"]  # As seen from far in front; none for what has no end.


NO_POINTS = np.zeros((0, 2))


class ShapeType(NamedTuple):
    """A type of shape. Of one shape it is told the faces, each a `Shapes` of one entry, and the index of the first."""

    curved: bool  # Closed and convex, with an outline where rays graze it; flat if not.
    face_count: int  # How many faces it has.
    # Of the scene's struct of such shapes the fields of `Shapes`, with the faces on the last axis where there are
    # several; `axes` and `axis` only where the type has them.
    coefficients: Callable[[Any], dict[str, Array]]
    # Distance to one shape, and whether that is a hit: of rays, faces, index, and the least distance that counts.
    # `hit_distance` makes it differentiable, as the next.
    hit: Callable[[Rays, Faces, Any, Array], Hit]
    distance: Callable[[Rays, Shapes, Flags], Scalars]  # To faces that are met, one a ray; which from outside.
    # How footprints meet one shape; as `hit`, and which rays have a level for what is past an edge.
    see: Callable[[Rays, Faces, Any, Array, Array], Sighting]
    # The edges that a face has of itself, one face a ray: of rays, faces, which are seen from outside, distances, and
    # how these change over the footprint.
    edges: Callable[[Rays, Shapes, Array, Array, Approach], tuple[Edge, ...]]
    # How far the ways from points to a light stay clear of one shape, in world units, negative where it cuts them: of
    # points, the light's location, faces, and unit of length.
    clearance: Callable[[Array, Array, Faces, Array], Scalars]
    section: Callable[[Faces, CuttingPlane, float], Section]  # As far as the drawing reaches.
    has_inside: bool = False  # There is glass behind its surface, wherever F is negative.
    # Unit directions of textures on shapes, and half the shapes' sizes along these, or infinity; None without mapping.
    frame: Callable[[Shapes], tuple[Axes, Pairs]] | None = None
