"""Rectangles, seen from both sides: a flat surface whose border is an edge."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...scene.scene import Rectangles
from ...util.numerics import direction, dot, normalize
from . import shapes
from .plane import distance, flat_clearance, flat_hit, flat_section, see_flat
from .rays import Axes, Flags, Index, Number, Pairs, Rays, Scalars, Vectors
from .shapes import Approach, CuttingPlane, Edge, Faces, Hit, Section, Shapes, ShapeType


def coefficients(rectangles: Rectangles) -> dict[str, Array]:
    """The normal is that of a right-handed frame: right, up, towards the beholder."""
    axes = jnp.stack([rectangles.right, rectangles.up])
    right, up = unit_sides(axes)
    normal, zeros = normalize(jnp.cross(right, up, axis=0)), jnp.zeros_like(right[0])
    numbers = {"curvature": zeros, "radius": zeros, "size": zeros + jnp.inf}
    return {"position": rectangles.center, "normal": normal, "axes": axes, **numbers}


def unit_sides(axes: Float[Array, "2 3 *shapes"]) -> list[Float[Array, "3 *shapes"]]:
    """The directions of both sides; any direction for what has no sides."""
    return [direction(jnp.where(jnp.any(axes[k] != 0, axis=0), axes[k], 1)) for k in range(2)]


def within_borders(p: Vectors, shape: Shapes) -> list[Scalars]:
    """The distance of points to the nearer of the two borders along each axis, in world units; negative outside."""
    assert shape.axes is not None
    ray_axes = p.ndim - shape.position.ndim
    position, axes = (x.reshape(x.shape + (1,) * ray_axes) for x in (shape.position, shape.axes))
    from_center = p - position
    return [
        dot(side, axis) - jnp.abs(dot(from_center, jnp.broadcast_to(side, from_center.shape)))
        for side, axis in zip(unit_sides(axes), axes, strict=True)
    ]


def hit(rays: Rays, faces: Faces, index: Index, least: Number) -> Hit:
    (shape,) = faces
    t, hits = flat_hit(rays, shape, index, least)
    return t, hits & (outside_borders(rays.o + jnp.where(hits, t, 0) * rays.d, shape) <= 0), index


def edges(rays: Rays, shape: Shapes, outside: Flags, t: Scalars, near: Approach) -> tuple[Edge, ...]:
    p = rays.o + t * rays.d
    fixed_p, fixed_t, d, fixed = jax.lax.stop_gradient((p, t, rays.d, shape))
    assert fixed.axes is not None
    found = []
    for value, side, axis in zip(within_borders(p, shape), unit_sides(fixed.axes), fixed.axes, strict=True):
        outward = jnp.where(dot(fixed_p - fixed.position, side) < 0, -1, 1)
        moves = rays.footprint.o + fixed_t * rays.footprint.d + near.slope[:, None] * d
        slope = -outward * jnp.sum(moves * side, 1)
        # A rectangle narrower than the footprint has both borders of a pair in it: they fade, as a small sphere's do.
        fraction = jnp.minimum(near.fraction, shapes.fraction_of_radius(slope, dot(side, axis)))
        found.append(Edge(value, slope, fraction))
    return tuple(found)


def outside_borders(p: Vectors, shape: Shapes) -> Scalars:
    """How far points are outside of one rectangle, negative inside."""
    along_right, along_up = within_borders(p, shape)
    return jnp.maximum(-along_right, -along_up)


def section(faces: Faces, drawing: CuttingPlane, reach: float) -> Section:
    (shape,) = faces
    center, (right, up) = np.asarray(shape.position, np.float64), np.asarray(shape.axes, np.float64)
    corners = [center + u * right + v * up for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))]
    normal = np.cross(right, up)
    normal /= np.linalg.norm(normal)
    bounds = [(s * axis, s * axis @ center + axis @ axis) for axis in (right, up) for s in (-1, 1)]
    return Section(flat_section(center, normal, drawing, np.inf, bounds), False, drawing.project(np.array(corners)))


def frame(shape: Shapes) -> tuple[Axes, Pairs]:
    assert shape.axes is not None
    directions = unit_sides(shape.axes)
    lengths = [dot(side, axis) for side, axis in zip(directions, shape.axes, strict=True)]
    return jnp.stack(directions), jnp.stack(lengths)


see, clearance = functools.partial(see_flat, edges), functools.partial(flat_clearance, outside_borders)
RECTANGLE = ShapeType(False, 1, coefficients, hit, distance, see, edges, clearance, section, frame=frame)
