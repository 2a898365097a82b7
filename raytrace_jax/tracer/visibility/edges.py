"""The edges that a ray's footprint may straddle, as event functions and their derivatives over the footprint.

`visibility` tells what they are for. All derivatives over the footprint are constants to the parameter derivative, but
for those of a silhouette: a ball that grows as it recedes keeps its outline to the last digit.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.geometry.shapes import Shapes, divisor, surface_normal, surface_value
from raytrace_jax.util.numerics import dot, select

FADE_RADIUS = 1.0
"""Silhouettes fade where a footprint is wider than this share of the sphere's radius: they are blurred no further."""

FADE_COS = 0.4
"""Likewise where the cosine of incidence changes by more than this share of itself towards the footprint's sides."""

LEAST_SHARE = 1e-3
"""No edge fades to less than this share of the footprint, which distances are divided by."""

GRAZING = 1e-3
"""Footprints on a surface stop growing at this cosine of incidence."""

WITHIN = 0.9995
"""Edges farther from the centre than this share of the footprint's reach are left alone: almost nothing lies beyond."""


class Edge(eqx.Module):
    """One candidate edge of each ray.

    Args:
        exists: there is such an edge.
        value: the event function, positive where the nearest surface is present.
        slope: its derivatives along the footprint's two axes.
        share: how much of the footprint, side to side, the linear event function is good for.
    """

    exists: Bool[Array, " *rays"]
    value: Float[Array, " *rays"]
    slope: Float[Array, "2 *rays"]
    share: Float[Array, " *rays"]


class Approach(eqx.Module):
    """How the distance to a surface changes over a footprint; constant to the parameter derivative.

    Args:
        slope: derivatives of the distance along the footprint's two axes.
        share: how much of the footprint that is about right for: the cosine of incidence changes little there.
    """

    slope: Float[Array, "2 *rays"]
    share: Float[Array, " *rays"]


def approach(
    rays: Rays, shape: Shapes, t: Float[Array, " *rays"], side: Float[Array, " *rays"] | None = None
) -> Approach:
    """How each footprint approaches one shape that is hit at t; `side` as in `geometry.divisor`, None for planes."""
    rays, shape, t = jax.lax.stop_gradient((rays, shape, t))
    n = shape.normal if side is None else surface_normal(rays.o + t * rays.d, shape)
    cos = dot(n, rays.d)
    footprint = rays.beam.footprint
    across = [footprint.o[k] + t * footprint.d[k] for k in range(2)]
    divide_by = divisor(cos, GRAZING, side)
    slope = jnp.stack([-dot(n, across[k]) / divide_by for k in range(2)])
    change = jnp.abs(dot(n, footprint.d[0])) + jnp.abs(dot(n, footprint.d[1]))
    if side is not None:
        change += shape.curvature * jnp.sqrt(dot(across[0], across[0]) + dot(across[1], across[1]) + 1e-30)
    return Approach(slope, jnp.clip(2 * FADE_COS * jnp.abs(cos) / (change + 1e-30), LEAST_SHARE, 1))


class SurfaceAhead(eqx.Module):
    """A surface that each ray meets.

    Args:
        shape: whose it is.
        t: the distance.
        side: sign of the cosine of incidence, as in `geometry.divisor`.
        approach: how the distance changes over the footprint.
    """

    shape: Shapes
    t: Float[Array, " *rays"]
    side: Float[Array, " *rays"]
    approach: Approach


def facing_side(rays: Rays, shape: Shapes, outside: Bool[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The sign of the cosine of incidence: -1 for what faces the ray, as a sphere does that is seen from `outside`."""
    plane = jnp.where(dot(shape.normal, rays.d) < 0, -1, 1)
    return jnp.where(shape.curvature > 0, jnp.where(outside, -1, 1), plane).astype(rays.o.dtype)


def silhouette(rays: Rays, shape: Shapes, outside: Bool[Array, " *rays"]) -> Edge:
    """The silhouette of a sphere that is seen from outside."""
    from_center = rays.o - shape.position
    along = -dot(from_center, rays.d)
    across = from_center + along * rays.d
    is_sphere = shape.curvature > 0
    radius = jnp.where(is_sphere, shape.radius, 1)
    value = (radius * radius - dot(across, across)) / (2 * radius)
    edge = silhouette_edge(rays, across, along, radius, value)
    return Edge(is_sphere & outside, edge.value, edge.slope, edge.share)


def silhouette_edge(rays: Rays, across, along, radius, value) -> Edge:
    """A silhouette, given the vector from the sphere's centre to the ray's nearest point, and how far that is."""
    footprint = rays.beam.footprint
    slope = jnp.stack([-dot(across, footprint.o[k] + along * footprint.d[k]) / radius for k in range(2)])
    return Edge(jnp.ones_like(value, bool), value, slope, jax.lax.stop_gradient(share_of_radius(slope, radius)))


def share_of_radius(slope: Float[Array, "2 *rays"], radius: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The share of the footprint over which an event function changes by no more than a part of the sphere's radius."""
    return jnp.clip(FADE_RADIUS * radius / (jnp.abs(slope[0]) + jnp.abs(slope[1]) + 1e-30), LEAST_SHARE, 1)


def image_plane_cut(rays: Rays, shape: Shapes, t: Float[Array, " *rays"], approach: Approach) -> Edge:
    """Planes are not seen in front of the image plane, z > 0."""
    footprint = rays.beam.footprint
    fixed, d_z = jax.lax.stop_gradient((t, rays.d[2]))
    slope = jnp.stack([-(footprint.o[k, 2] + fixed * footprint.d[k, 2] + approach.slope[k] * d_z) for k in range(2)])
    return Edge(shape.curvature == 0, -(rays.o[2] + t * rays.d[2]), slope, approach.share)


def end_of_world(rays: Rays, t: Float[Array, " *rays"], approach: Approach, max_distance: float) -> Edge:
    """A path ends in black when it is too long."""
    return Edge(jnp.ones_like(t, bool), max_distance - rays.path_length - t, -approach.slope, approach.share)


def crease(rays: Rays, near: SurfaceAhead, behind: SurfaceAhead, exists: Bool[Array, " *rays"]) -> Edge:
    """Two surfaces at the same distance change places; `near` is the nearer one.

    Where a ray grazes a sphere its distance changes without bound, and all of the sphere's rim changes places with what
    it meets there. So a sphere that is seen from outside takes its own function F at the point of the other surface.
    """
    fixed_rays, fixed_near, fixed_behind = jax.lax.stop_gradient((rays, near, behind))
    along = -dot(fixed_rays.o - fixed_near.shape.position, fixed_rays.d)
    # A point beyond the middle of the nearer sphere does not tell how deep the ray goes into it.
    by_near = (near.side < 0) & (fixed_near.shape.curvature > 0) & (fixed_behind.t < along)
    by_behind = (behind.side < 0) & (fixed_behind.shape.curvature > 0) & ~by_near

    # The sphere whose function is taken, and the other surface, whose point it is taken at.
    sphere = select(by_near, near.shape, behind.shape)
    fixed_sphere = jax.lax.stop_gradient(sphere)
    t = jnp.where(by_near, behind.t, near.t)
    fixed_t = jax.lax.stop_gradient(t)
    other = select(by_near, behind.approach, near.approach)
    sign = jnp.where(by_near, -1, 1)
    n = surface_normal(fixed_rays.o + fixed_t * fixed_rays.d, fixed_sphere)
    cos = dot(n, fixed_rays.d)
    footprint = rays.beam.footprint
    slope = sign * jnp.stack(
        [dot(n, footprint.o[k] + fixed_t * footprint.d[k]) + cos * other.slope[k] for k in range(2)]
    )
    by_function = by_near | by_behind
    value = jnp.where(by_function, sign * surface_value(rays.o + t * rays.d, sphere), behind.t - near.t)
    share = jnp.where(
        by_function,
        jnp.minimum(share_of_radius(slope, fixed_sphere.radius), other.share),
        jnp.minimum(near.approach.share, behind.approach.share),
    )
    slope = jnp.where(by_function, slope, behind.approach.slope - near.approach.slope)
    return Edge(exists, value, slope, share)


def edge_distance(edge: Edge):
    """Signed distance of the edge from the footprint's centre, its unit normal, and the share of the footprint used.

    Only the share in which the event function is linear is split. An edge in it then stands for edges in all of the
    footprint, and would have their derivative together: right in the mean, but seen by few rays. The mean square error
    of a value that is c D / s with probability s, for a mean D, is smallest at c = s.
    """
    steepness = jnp.sqrt(edge.slope[0] ** 2 + edge.slope[1] ** 2 + 1e-30)
    direction = edge.slope / steepness
    direction, share = jax.lax.stop_gradient((direction, edge.share))
    unit = steepness * share
    distance = edge.value / unit
    fixed = jax.lax.stop_gradient(distance)
    return fixed + share * (distance - fixed), direction, share, unit


def extent(edge: Edge) -> Float[Array, " *rays"]:
    """How much the event function changes from the footprint's centre to its farthest corner."""
    return (jnp.abs(edge.slope[0]) + jnp.abs(edge.slope[1])) / 2


def most_central(edges: tuple[Edge, ...]):
    """Of several edges the one nearest to the footprint's centre."""
    candidates = []
    for edge in edges:
        distance, *rest = edge_distance(edge)
        candidates.append((jnp.where(edge.exists, distance, 1e6), *rest))

    def nearer(best, other):
        return tuple(jnp.where(other[0] < best[0], new, old) for new, old in zip(other, best, strict=True))

    # An edge on whose far side the centre lies hides the surface there, whatever the others do.
    return functools.reduce(nearer, candidates)


def is_within(edge: Edge) -> Bool[Array, " *rays"]:
    """Whether any part of the footprint that matters lies on the near side of the edge."""
    return edge.value > -WITHIN * edge.share * extent(edge)
