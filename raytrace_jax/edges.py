"""The edges that a ray's footprint may straddle, as event functions and their derivatives over the footprint.

`visibility` tells what they are for. All derivatives over the footprint are constants to the parameter derivative.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._numerics import dot
from .geometry import Shapes, divisor, surface_normal, surface_value
from .intersection import MAX_DISTANCE
from .rays import Rays

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


def distance_slope(
    rays: Rays, shape: Shapes, t: Float[Array, " *rays"], side: Float[Array, " *rays"] | None = None
) -> Float[Array, "2 *rays"]:
    """Derivatives of the distance to a shape along the footprint's axes; `side` as in `geometry.divisor`."""
    n = surface_normal(rays.o + t * rays.d, shape)
    cos = divisor(dot(n, rays.d), GRAZING, side)
    footprint = rays.beam.footprint
    return jnp.stack([-dot(n, footprint.o[k] + t * footprint.d[k]) / cos for k in range(2)])


def linear_share(rays: Rays, shape: Shapes, t: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The share of the footprint in which distances to a shape are about linear: its cosine changes little there."""
    n = surface_normal(rays.o + t * rays.d, shape)
    footprint = rays.beam.footprint
    change = 1e-30
    for k in range(2):
        across = footprint.o[k] + t * footprint.d[k]
        change += (jnp.abs(dot(n, footprint.d[k])) + shape.curvature * jnp.sqrt(dot(across, across) + 1e-30)) / 2
    return jnp.clip(FADE_COS * jnp.abs(dot(n, rays.d)) / change, LEAST_SHARE, 1)


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
    slope = jax.lax.stop_gradient(slope)
    return Edge(jnp.ones_like(value, bool), value, slope, jax.lax.stop_gradient(share_of_radius(slope, radius)))


def share_of_radius(slope: Float[Array, "2 *rays"], radius: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The share of the footprint over which an event function changes by no more than a part of the sphere's radius."""
    return jnp.clip(FADE_RADIUS * radius / (jnp.abs(slope[0]) + jnp.abs(slope[1]) + 1e-30), LEAST_SHARE, 1)


def image_plane_cut(rays: Rays, shape: Shapes, t: Float[Array, " *rays"]) -> Edge:
    """Planes are not seen in front of the image plane, z > 0."""
    footprint = rays.beam.footprint
    fixed = jax.lax.stop_gradient(t)
    fixed_rays, fixed_shape = jax.lax.stop_gradient((rays, shape))
    t_slope = distance_slope(fixed_rays, fixed_shape, fixed)
    slope = jnp.stack([-(footprint.o[k, 2] + fixed * footprint.d[k, 2] + t_slope[k] * rays.d[2]) for k in range(2)])
    exists = shape.curvature == 0
    share = linear_share(fixed_rays, fixed_shape, fixed)
    return Edge(exists, -(rays.o[2] + t * rays.d[2]), jax.lax.stop_gradient(slope), share)


def end_of_world(rays: Rays, shape: Shapes, t: Float[Array, " *rays"], side) -> Edge:
    """A path ends in black when it is too long."""
    fixed = jax.lax.stop_gradient(t)
    fixed_rays, fixed_shape = jax.lax.stop_gradient((rays, shape))
    slope = -distance_slope(fixed_rays, fixed_shape, fixed, side)
    exists = jnp.ones_like(t, bool)
    return Edge(exists, MAX_DISTANCE - rays.path_length - t, slope, linear_share(fixed_rays, fixed_shape, fixed))


def crease(rays: Rays, shape: Shapes, behind: Shapes, t, t_behind, exists, side, side_behind) -> Edge:
    """Two surfaces at the same distance change places; `shape` is the nearer one, `side` as in `geometry.divisor`.

    Where a ray grazes a sphere its distance changes without bound, and all of the sphere's rim changes places with what
    it meets there. So a sphere that is seen from outside takes its own function F at the point of the other surface.
    """
    fixed_rays, fixed_shape, fixed_behind, fixed, fixed_behind_t = jax.lax.stop_gradient(
        (rays, shape, behind, t, t_behind)
    )
    slope = distance_slope(fixed_rays, fixed_shape, fixed, side)
    slope_behind = distance_slope(fixed_rays, fixed_behind, fixed_behind_t, side_behind)
    along = -dot(fixed_rays.o - fixed_shape.position, fixed_rays.d)
    # A point beyond the middle of the nearer sphere does not tell how deep the ray goes into it.
    by_nearer = (side < 0) & (fixed_shape.curvature > 0) & (fixed_behind_t < along)
    by_behind = (side_behind < 0) & (fixed_behind.curvature > 0) & ~by_nearer

    def pick(nearer, farther, distance):
        return jnp.where(by_nearer, nearer, jnp.where(by_behind, farther, distance))

    def along_axes(shape, t, t_slope):
        n = surface_normal(fixed_rays.o + t * fixed_rays.d, shape)
        footprint = rays.beam.footprint
        return jnp.stack(
            [dot(n, footprint.o[k] + t * footprint.d[k]) + dot(n, fixed_rays.d) * t_slope[k] for k in range(2)]
        )

    value = pick(
        -surface_value(rays.o + t_behind * rays.d, shape), surface_value(rays.o + t * rays.d, behind), t_behind - t
    )
    slopes = pick(
        -along_axes(fixed_shape, fixed_behind_t, slope_behind),
        along_axes(fixed_behind, fixed, slope),
        slope_behind - slope,
    )
    nearer_share = linear_share(fixed_rays, fixed_shape, fixed)
    behind_share = linear_share(fixed_rays, fixed_behind, fixed_behind_t)
    share = pick(
        jnp.minimum(share_of_radius(slopes, fixed_shape.radius), behind_share),
        jnp.minimum(share_of_radius(slopes, fixed_behind.radius), nearer_share),
        jnp.minimum(nearer_share, behind_share),
    )
    return Edge(exists, value, slopes, share)


def edge_distance(edge: Edge):
    """Signed distance of the edge from the footprint's centre, its unit normal, and the share of the footprint used.

    Only the share in which the event function is linear is split. An edge in it then stands for edges in all of the
    footprint, and would have their derivative together: right in the mean, but seen by few rays. The mean square error
    of a value that is c D / s with probability s, for a mean D, is smallest at c = s.
    """
    steepness = jnp.sqrt(edge.slope[0] ** 2 + edge.slope[1] ** 2 + 1e-30)
    direction = edge.slope / steepness
    direction, share, unit = jax.lax.stop_gradient((direction, edge.share, steepness * edge.share))
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
