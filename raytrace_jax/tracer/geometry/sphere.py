"""Spheres: the ray's chord, from which all that is asked of them follows."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...scene.scene import Spheres
from ...util.numerics import dot, per_ray, safe_sqrt, vectors_to
from . import shapes
from .rays import Flags, Number, Rays, Scalars, Vector, Vectors
from .shapes import Approach, CuttingPlane, Edge, Hit, Section, Shapes, ShapeType


class Chord(NamedTuple):
    along: Scalars  # Signed distance along the ray to its point nearest to the centre.
    across: Vectors  # The vector from the centre to that point.
    discriminant: Scalars  # The radius squared less the square of that vector; positive where the ray meets the sphere.
    half: Scalars  # Half the length of the chord; 0 where there is none.


def chord(o: Vectors, d: Vectors, center: Array, radius: Array) -> Chord:
    """The chords of rays in spheres, whose centers and radii are shaped to broadcast over the rays.

    The discriminant is `r^2 - |oc - (oc.d) d|^2`, the form that loses no digits when the sphere is far away or small
    (Haines et al., Precision improvements for ray/sphere intersection, Ray Tracing Gems, 2019).
    """
    from_center = o - center
    along = -dot(from_center, d)
    across = from_center + along * d
    discriminant = radius * radius - dot(across, across)
    return Chord(along, across, discriminant, safe_sqrt(discriminant))


def chord_in(rays: Rays, shape: Shapes) -> Chord:
    center = shape.position if shape.position.ndim > 1 else per_ray(shape.position, rays.o.ndim - 1)
    return chord(rays.o, rays.d, center, shape.radius)


def coefficients(spheres: Spheres) -> dict[str, Array]:
    center, radius = spheres.center, spheres.radius
    return {"position": center, "normal": jnp.zeros_like(center), "curvature": 1 / radius, "radius": radius}


def meeting(rays: Rays, shape: Shapes, passing: Chord, own: Flags, least: Number) -> tuple[Scalars, Flags, Flags]:
    """Distance at which rays meet one sphere, whether they do, and whether the near end of the chord is no hit.

    A ray that starts on this sphere meets it again only if it runs inside, at the end of its chord.
    """
    near, far = passing.along - passing.half, passing.along + passing.half
    hits = jnp.where(own, rays.inside, passing.discriminant > 0)
    behind = near < least
    if not shape.settings.second_root:
        return near, hits & ~own, behind
    return jnp.where(own, 2 * passing.along, jnp.where(behind, far, near)), hits, behind


def hit(rays: Rays, shape: Shapes, own: Flags, least: Number) -> Hit:
    t, hits, _ = meeting(rays, shape, chord_in(rays, shape), own, least)
    return t, hits & (t > least)


def distance(rays: Rays, shape: Shapes, outside: Flags) -> Scalars:
    passing = chord_in(rays, shape)
    return jnp.where(outside, passing.along - passing.half, passing.along + passing.half)


def silhouette(rays: Rays, passing: Chord, radius: Scalars, value: Scalars, exists: Flags) -> Edge:
    """The silhouette of a sphere, given how the ray passes it and how far inside of the outline that is."""
    slope = jnp.sum(passing.across * (rays.footprint.o + passing.along * rays.footprint.d), 1) * (-1 / radius)
    fraction = jax.lax.stop_gradient(shapes.fraction_of_radius(slope, radius))
    return Edge(value, slope, fraction, exists)


def see(rays: Rays, shape: Shapes, own: Flags, may_pass: Flags, least: Number) -> shapes.Sighting:
    """The meeting of each footprint with one sphere. Where its centre just misses the rim, a part of it still may."""
    passing = chord_in(rays, shape)
    t, centered, behind = meeting(rays, shape, passing, own, least)
    seen, outside = centered & (t > least), ~(own | behind)
    edge = silhouette(rays, passing, shape.radius, passing.discriminant / (2 * shape.radius), may_pass)
    grazes = may_pass & ~own & (passing.discriminant <= 0) & (passing.along > least) & shapes.is_within(edge)
    # Where the centre misses the rim, the first distance at which any part may meet it counts: half the longest chord
    # before the sphere's middle.
    longest = safe_sqrt(2 * shape.radius * (edge.value + shapes.extent(edge)))
    first = jnp.maximum(passing.along - longest, least)
    return shapes.Sighting(jnp.where(grazes, first, t), seen | grazes, outside | grazes, centered)


def edges(rays: Rays, shape: Shapes, outside: Flags, t: Scalars, near: Approach) -> tuple[Edge, ...]:
    passing = chord_in(rays, shape)
    radius = jnp.where(shape.curvature > 0, shape.radius, 1)
    value = (radius * radius - dot(passing.across, passing.across)) / (2 * radius)
    return (silhouette(rays, passing, radius, value, outside),)


def clearance(o: Vectors, light: Vector, shape: Shapes, unit: Number) -> Scalars:
    """The distance of the way from `o` to a light from a sphere; for a light within it, how far `o` is inside."""
    toward, toward_center = vectors_to(light, o), vectors_to(shape.position, o)
    length_squared = dot(toward, toward)
    fraction = dot(toward_center, toward) / jnp.where(length_squared > 0, length_squared, 1)
    nearest = toward_center - jnp.clip(fraction, 0, 1) * toward
    from_light = light - shape.position
    light_inside = from_light[0] ** 2 + from_light[1] ** 2 + from_light[2] ** 2 < shape.radius * shape.radius
    within = shape.radius - safe_sqrt(dot(toward_center, toward_center))
    return jnp.where(light_inside, within, safe_sqrt(dot(nearest, nearest)) - shape.radius)


def section(shape: Shapes, drawing: CuttingPlane, reach: float) -> Section:
    center, radius = np.asarray(shape.position, np.float64), float(shape.radius)
    angle = np.linspace(0, 2 * np.pi, 181)  # A corner every second degree.
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    off = float((center - drawing.center) @ drawing.normal)
    middle = drawing.project(center)
    cut = middle + np.sqrt(max(radius**2 - off**2, 0.0)) * circle
    return Section(cut if abs(off) < radius else shapes.NO_POINTS, True, middle + radius * circle)


SPHERE = ShapeType(True, coefficients, hit, distance, see, edges, clearance, section, has_inside=True)
