"""Where a footprint is cut: the edges that several shapes, or none, have a part in, and the one that counts."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.geometry.shape_type import Approach, Edge, fraction_of_radius
from raytrace_jax.tracer.geometry.shapes import Shapes, surface_normal, surface_value
from raytrace_jax.util.numerics import TINY_32, dot, select


class SurfaceAhead(eqx.Module):
    """A surface that each ray meets.

    Args:
        shape: the shape that it belongs to.
        curved: whether that shape has an outline where rays graze it.
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
    # For a ball by definition: where the ray only just touches it the cosine is 0, and rounding would choose its sign.
    flat = jnp.where(dot(shape.normal, rays.d) < 0, -1, 1)
    return jnp.where(curved, jnp.where(outside, -1, 1), flat).astype(rays.o.dtype)


def path_limit(rays: Rays, t: Float[Array, " *rays"], approach: Approach, longest_path: float) -> Edge:
    """The edge where a path becomes too long and ends in black."""
    # The event function is what is left of the path. It shrinks as fast as the distance grows.
    return Edge(jnp.ones_like(t, bool), longest_path - rays.path_length - t, -approach.slope, approach.share)


def occlusion_edge(rays: Rays, near: SurfaceAhead, behind: SurfaceAhead, exists: Bool[Array, " *rays"]) -> Edge:
    """The edge where two surfaces are equally far and change places; `near` is the nearer one.

    The plain event function is the difference of the distances. But where a ray grazes a sphere, the sphere's distance
    changes without bound. For a sphere that is seen from outside the event function is therefore the sphere's own
    function F at the point where the ray meets the other surface: it has the same zero, and stays smooth at the rim.
    """
    fixed_rays, fixed_near, fixed_behind = jax.lax.stop_gradient((rays, near, behind))
    along = -dot(fixed_rays.o - fixed_near.shape.position, fixed_rays.d)
    # The nearer sphere's F tells which surface comes first only before the sphere's middle, at `along`: beyond it F
    # grows again towards the far side of the sphere.
    by_near = (near.side < 0) & near.curved & (fixed_behind.t < along)
    by_behind = (behind.side < 0) & behind.curved & ~by_near

    # The sphere whose function is taken, and the other surface, whose point it is taken at.
    sphere = select(by_near, near.shape, behind.shape)
    fixed_sphere = jax.lax.stop_gradient(sphere)
    t = jnp.where(by_near, behind.t, near.t)
    fixed_t = jax.lax.stop_gradient(t)
    other = select(by_near, behind.approach, near.approach)
    # Positive where `near` is first: the other point is inside of the nearer sphere, or outside of the one behind.
    sign = jnp.where(by_near, -1, 1)
    # Chain rule over the footprint: F changes with the point, which moves across the ray and along it.
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
        jnp.minimum(fraction_of_radius(slope, fixed_sphere.radius), other.share),
        jnp.minimum(near.approach.share, behind.approach.share),
    )
    slope = jnp.where(by_function, slope, behind.approach.slope - near.approach.slope)
    return Edge(exists, value, slope, share)


def edge_distance(edge: Edge):
    """Signed distance of the edge from the footprint's centre, its unit normal, and the share of the footprint used.

    Only the share s of the footprint in which the event function is linear is split. Without damping, a share s of the
    rays would meet the edge, each with a derivative 1 / s times as large: right in the mean, but few rays would carry
    all of it. So the derivative is damped by a factor c. An estimate that is c D / s with probability s, else 0, has
    the mean square error `D^2 (c^2 / s - 2 c + 1)` for a mean D, which is least at c = s.
    """
    # To first order a point at x has the value g + slope.x: the edge is a line at the distance g / |slope|. TINY_32
    # guards the root's derivative where the slope is 0.
    steepness = jnp.sqrt(edge.slope[0] ** 2 + edge.slope[1] ** 2 + TINY_32)
    direction = edge.slope / steepness
    direction, share = jax.lax.stop_gradient((direction, edge.share))
    unit = steepness * share
    distance = edge.value / unit
    # The value stays as it is; only its derivative is damped.
    fixed = jax.lax.stop_gradient(distance)
    return fixed + share * (distance - fixed), direction, share, unit


def most_central(edges: tuple[Edge, ...]):
    """The edge with the smallest signed distance, and `edge_distance` of it; edges that do not exist come last.

    The distance is negative where the footprint's centre lies beyond the edge.
    """
    candidates = []
    for edge in edges:
        distance, *rest = edge_distance(edge)
        # An edge that does not exist is far away: edges cut footprints at distances below 1.
        candidates.append((jnp.where(edge.exists, distance, 1e6), *rest))

    def nearer(best, other):
        return tuple(jnp.where(other[0] < best[0], new, old) for new, old in zip(other, best, strict=True))

    # Signed, not absolute: an edge beyond which the centre lies hides the surface there, whatever the others do.
    return functools.reduce(nearer, candidates)
