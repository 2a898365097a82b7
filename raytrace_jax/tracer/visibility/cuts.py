"""Where a footprint is cut: the edges that several shapes, or none, have a part in, and the one that counts."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.tracer.geometry.edges import Approach, Edge, share_of_radius
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.geometry.shapes import Shapes, surface_normal, surface_value
from raytrace_jax.util.numerics import TINY_32, dot, select

FAR_AWAY = 1e6
"""The distance, in footprints, of an edge that does not exist; edges cut at distances below 1."""


class SurfaceAhead(eqx.Module):
    """A surface that each ray meets.

    Args:
        shape: whose it is.
        curved: whether that has an outline where rays graze it.
        t: the distance.
        side: sign of the cosine of incidence, as in `shapes.divisor`.
        approach: how the distance changes over the footprint.
    """

    shape: Shapes
    curved: Bool[Array, " *rays"]
    t: Float[Array, " *rays"]
    side: Float[Array, " *rays"]
    approach: Approach


def facing_side(
    rays: Rays, shape: Shapes, curved: Bool[Array, " *rays"], outside: Bool[Array, " *rays"]
) -> Float[Array, " *rays"]:
    """The sign of the cosine of incidence: -1 for what faces the ray, as a ball does that is seen from `outside`."""
    flat = jnp.where(dot(shape.normal, rays.d) < 0, -1, 1)
    return jnp.where(curved, jnp.where(outside, -1, 1), flat).astype(rays.o.dtype)


def path_limit(rays: Rays, t: Float[Array, " *rays"], approach: Approach, longest_path: float) -> Edge:
    """A path ends in black when it is too long."""
    return Edge(jnp.ones_like(t, bool), longest_path - rays.path_length - t, -approach.slope, approach.share)


def occlusion_edge(rays: Rays, near: SurfaceAhead, behind: SurfaceAhead, exists: Bool[Array, " *rays"]) -> Edge:
    """Two surfaces at the same distance change places; `near` is the nearer one.

    Where a ray grazes a sphere its distance changes without bound, and all of the sphere's rim changes places with what
    it meets there. So a sphere that is seen from outside takes its own function F at the point of the other surface.
    """
    fixed_rays, fixed_near, fixed_behind = jax.lax.stop_gradient((rays, near, behind))
    along = -dot(fixed_rays.o - fixed_near.shape.position, fixed_rays.d)
    # A point beyond the middle of the nearer sphere does not tell how deep the ray goes into it.
    by_near = (near.side < 0) & near.curved & (fixed_behind.t < along)
    by_behind = (behind.side < 0) & behind.curved & ~by_near

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
    steepness = jnp.sqrt(edge.slope[0] ** 2 + edge.slope[1] ** 2 + TINY_32)
    direction = edge.slope / steepness
    direction, share = jax.lax.stop_gradient((direction, edge.share))
    unit = steepness * share
    distance = edge.value / unit
    fixed = jax.lax.stop_gradient(distance)
    return fixed + share * (distance - fixed), direction, share, unit


def most_central(edges: tuple[Edge, ...]):
    """Of several edges the one nearest to the footprint's centre."""
    candidates = []
    for edge in edges:
        distance, *rest = edge_distance(edge)
        candidates.append((jnp.where(edge.exists, distance, FAR_AWAY), *rest))

    def nearer(best, other):
        return tuple(jnp.where(other[0] < best[0], new, old) for new, old in zip(other, best, strict=True))

    # An edge on whose far side the centre lies hides the surface there, whatever the others do.
    return functools.reduce(nearer, candidates)
