"""Infinite planes, seen from both sides. In the course's models they end at the image plane (course model, 1.2)."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...scene.scene import Planes
from ...util.numerics import away_from_zero, direction, dot, dot_fixed, normalize, vectors_to
from . import shapes
from .rays import Axes, Flags, Index, Number, Pairs, Rays, Scalars, Vector, Vectors
from .shapes import Approach, CuttingPlane, Edge, Faces, Hit, Section, Shapes, ShapeType

LEVEL = 1e-6  # A plane whose normal leans less than this from the y axis is level: its texture lies along x.


def coefficients(planes: Planes) -> dict[str, Array]:
    zeros = jnp.zeros_like(planes.normal[0])
    normal = direction(planes.normal)
    return {"position": planes.point, "normal": normal, "curvature": zeros, "radius": zeros, "size": zeros + jnp.inf}


def flat_hit(rays: Rays, shape: Shapes, index: Index, least: Number) -> tuple[Scalars, Flags]:
    cos = dot_fixed(shape.normal, rays.d)
    height = dot_fixed(shape.normal, shape.position) - dot_fixed(shape.normal, rays.o)
    t = height / away_from_zero(cos, shapes.LEAST_COS)
    return t, (jnp.abs(cos) >= shapes.LEAST_COS) & (t > 0) & (t > least) & (rays.origin_shape != index)


def hit(rays: Rays, faces: Faces, index: Index, least: Number) -> Hit:
    t, hits = flat_hit(rays, faces[0], index, least)
    if faces[0].settings.rules.planes_end_at_image_plane:
        hits = hits & (rays.o[2] + t * rays.d[2] <= 0)
    return t, hits, index


def distance(rays: Rays, shape: Shapes, outside: Flags) -> Scalars:
    return -dot(shape.normal, rays.o - shape.position) / away_from_zero(dot(shape.normal, rays.d), shapes.LEAST_COS)


def edges(rays: Rays, shape: Shapes, outside: Flags, t: Scalars, near: Approach) -> tuple[Edge, ...]:
    """The edge where the course's planes end: they are not seen in front of the image plane, z > 0."""
    if not shape.settings.rules.planes_end_at_image_plane:
        return ()
    fixed, d_z = jax.lax.stop_gradient((t, rays.d[2]))
    slope = -(rays.footprint.o[:, 2] + fixed * rays.footprint.d[:, 2] + near.slope * d_z)
    return (Edge(-(rays.o[2] + t * rays.d[2]), slope, near.fraction),)


def see_flat(
    edges: Callable, rays: Rays, faces: Faces, index: Index, may_pass: Flags, least: Number
) -> shapes.Sighting:
    """The meeting of each footprint with one flat shape that has these edges.

    Where its centre just misses, a part of it still may meet the shape.
    """
    (shape,), own = faces, rays.origin_shape == index
    t = distance(rays, shape, own)
    ahead = (jnp.abs(dot(shape.normal, rays.d)) >= shapes.LEAST_COS) & (t > least) & ~own
    t_ahead = jnp.where(ahead, t, 0)
    centered, within = jnp.ones_like(own), may_pass
    for edge in edges(rays, shape, own, t_ahead, shapes.approach(rays, shape, t_ahead)):
        centered, within = centered & (edge.value >= 0), within & shapes.is_within(edge)
    return shapes.Sighting(t, (centered | within) & ahead, jnp.zeros_like(own), centered)


def flat_clearance(beyond: Callable, o: Vectors, light: Vector, faces: Faces, unit: Number) -> Scalars:
    """The height of `o` on the light's side of a flat surface; from behind, how far outside of it the way crosses it.

    Args:
        beyond: how far outside of a shape points of its surface are; None if it has no border. On the light's side
            nobody asks, where the way may cross the surface nowhere.
    """
    (shape,) = faces
    light_height = dot_fixed(shape.normal, light - shape.position)
    height = -dot_fixed(shape.normal, vectors_to(shape.position, o))
    same_side = height * jnp.where(light_height < 0, -1, 1)
    # A way to a light that nears a surface by less than 1e-9 units of length crosses it nowhere worth knowing.
    fraction = height / away_from_zero(height - light_height, 1e-9 * unit)
    outside = beyond(o + jnp.clip(fraction, 0, 1) * vectors_to(light, o), shape)
    return same_side if outside is None else jnp.where(same_side > 0, same_side, jnp.maximum(same_side, outside))


def before_image_plane(p: Vectors, shape: Shapes) -> Scalars | None:
    """The z of points, as the course's planes end at z = 0: a way to a light that crosses in front of it is free."""
    return p[2] if shape.settings.rules.planes_end_at_image_plane else None


def flat_section(
    point: np.ndarray, normal: np.ndarray, drawing: CuttingPlane, reach: float, bounds: list[tuple[np.ndarray, float]]
) -> Float[np.ndarray, "points 2"]:
    """The line in which a drawing cuts a flat surface, as far as each bound (a, limit) holds: a.p <= limit."""
    across = np.array([normal @ drawing.right, normal @ drawing.up])
    steep = np.linalg.norm(across)
    # A plane whose normal has no part in the drawing is the drawing's own plane or parallel to it.
    if steep < 1e-6:
        return shapes.NO_POINTS
    # The line's point nearest to the drawing's middle, and its direction, in the drawing and in space.
    foot, along = across / steep**2 * ((point - drawing.center) @ normal), np.array([-across[1], across[0]]) / steep
    start = drawing.center + foot[0] * drawing.right + foot[1] * drawing.up
    step = along[0] * drawing.right + along[1] * drawing.up
    high = reach + float(np.linalg.norm(foot))
    low = -high
    for outwards, limit in bounds:
        room, speed = limit - outwards @ start, outwards @ step
        # A line that goes along a border to twelve digits never crosses it.
        if abs(speed) < 1e-12 * np.linalg.norm(outwards):
            low, high = (low, high) if room >= 0 else (1.0, 0.0)
        else:
            low, high = (low, min(high, room / speed)) if speed > 0 else (max(low, room / speed), high)
    # So many points that a line cut at the border of the drawing is right to a thousandth.
    return foot + np.linspace(low, high, 2001)[:, None] * along if low < high else shapes.NO_POINTS


def section(faces: Faces, drawing: CuttingPlane, reach: float) -> Section:
    (shape,) = faces
    ends = [(np.array([0.0, 0.0, 1.0]), 0.0)] if shape.settings.rules.planes_end_at_image_plane else []
    line = flat_section(np.asarray(shape.position), np.asarray(shape.normal), drawing, reach, ends)
    return Section(line, False, shapes.NO_POINTS)


def frame(shape: Shapes) -> tuple[Axes, Pairs]:
    """Directions to the right, across the y axis, and upwards; where the plane is level, right is x. It has no end."""
    n = shape.normal
    zero, one = jnp.zeros_like(n[0]), jnp.ones_like(n[0])
    across = jnp.stack([n[2], zero, -n[0]])  # The y axis times the normal.
    level = dot(across, across) < LEVEL * LEVEL
    right = normalize(jnp.where(level, jnp.stack([one, zero, zero]), across))
    return jnp.stack([right, jnp.cross(n, right, axis=0)]), jnp.full((2, *n.shape[1:]), jnp.inf, n.dtype)


see, clearance = functools.partial(see_flat, edges), functools.partial(flat_clearance, before_image_plane)
PLANE = ShapeType(False, 1, coefficients, hit, distance, see, edges, clearance, section, has_inside=True, frame=frame)
