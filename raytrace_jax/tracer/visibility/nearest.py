"""Which two surfaces each footprint meets first: what `intersection` is for rays, but a footprint may meet in part."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.intersection import least_distance
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays
from raytrace_jax.tracer.geometry.shapes import LEAST_COS, Shapes
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.visibility.edges import approach, extent, image_plane_cut, is_within, silhouette_edge
from raytrace_jax.util.numerics import away_from_zero, dot, materialize, safe_sqrt, select


class Nearest(eqx.Module):
    """A candidate surface of each ray.

    Args:
        t: distance.
        code: the rest in one number, so that a comparison moves two numbers and not four.
    """

    t: Float[Array, " *rays"]
    code: Int[Array, " *rays"]

    @classmethod
    def of(cls, t, index: int, outside: Bool[Array, " *rays"], centered: Bool[Array, " *rays"]) -> "Nearest":
        """A candidate on the shape of that index."""
        return cls(t, 4 * index + 2 * outside.astype(jnp.int32) + centered.astype(jnp.int32))

    @property
    def shape(self) -> Int[Array, " *rays"]:
        """Index of the shape, or `NO_SHAPE`."""
        return self.code >> 2

    @property
    def outside(self) -> Bool[Array, " *rays"]:
        """It is a sphere that is seen from outside of it."""
        return self.code & 2 != 0

    @property
    def centered(self) -> Bool[Array, " *rays"]:
        """The footprint's centre sees it, not only a part beyond its edge."""
        return self.code & 1 != 0


def find_two_nearest(
    shapes: Shapes,
    rays: Rays,
    live: Bool[Array, " *rays"],
    may_pass: Bool[Array, " *rays"],
    settings: RenderSettings,
) -> tuple[Nearest, Nearest]:
    """The nearest surface that any part of each footprint sees, and the next one behind it that its centre sees.

    A sphere whose silhouette the centre just misses counts at the first distance at which the footprint may meet it.
    """
    candidates = []
    for index, is_sphere in enumerate(shapes.is_sphere):
        shape = one_shape(shapes, index, rays.path_length.shape)
        own = rays.origin_shape == index
        see = see_sphere if is_sphere else see_plane
        t, seen, outside, centered = see(shape, rays, own, may_pass, settings)
        seen = seen & (index != rays.beam.passed[0]) & (index != rays.beam.passed[1])
        candidates.append(Nearest.of(jnp.where(seen, t, jnp.inf), index, outside, centered))
    nearest = second = Nearest(jnp.full_like(rays.path_length, jnp.inf), jnp.full_like(rays.origin_shape, 4 * NO_SHAPE))
    for found in materialize(candidates, live):
        first = found.t < nearest.t
        next_one = ~first & found.centered & (found.t < second.t)
        # What was nearest is now behind: it counts if the centre sees it.
        second = select(first & nearest.centered, nearest, select(next_one, found, second))
        nearest = select(first, found, nearest)
    return nearest, second


def one_shape(shapes: Shapes, index: int, rays: tuple[int, ...]) -> Shapes:
    """The same shape for every ray."""

    def spread(table):
        return jnp.broadcast_to(table[..., index].reshape(table.shape[:-1] + (1,) * len(rays)), table.shape[:-1] + rays)

    return jax.tree.map(spread, shapes)


def see_sphere(
    shape: Shapes, rays: Rays, own, may_pass: Bool[Array, " *rays"], settings: RenderSettings
) -> tuple[Array, Array, Array, Array]:
    """Where each footprint meets one sphere, whether it does, from outside, and with its centre.

    `own` tells the rays that start on the sphere.
    """
    least = least_distance(rays.o.dtype)
    from_center = rays.o - shape.position
    along = -dot(from_center, rays.d)
    across = from_center + along * rays.d
    discriminant = shape.radius * shape.radius - dot(across, across)
    half_chord = safe_sqrt(discriminant)
    near, far = along - half_chord, along + half_chord
    centered = jnp.where(own, rays.inside, discriminant > 0)
    outside = ~own & (near >= least)
    if settings.second_root:
        t = jnp.where(own, 2 * along, jnp.where(outside, near, far))
    else:
        t, centered = near, centered & ~own
    seen = centered & (t > least)
    edge = silhouette_edge(rays, across, along, shape.radius, discriminant / (2 * shape.radius))
    grazes = may_pass & ~own & (discriminant <= 0) & (along > least) & is_within(edge)
    # Of a rim that the centre misses the part that comes first counts: half the longest chord before the middle.
    chord = safe_sqrt(2 * shape.radius * (edge.value + extent(edge)))
    first = jnp.maximum(along - chord, least)
    t, seen, outside = jnp.where(grazes, first, t), seen | grazes, outside | grazes
    return t, seen, outside, centered


def see_plane(
    shape: Shapes, rays: Rays, own, may_pass: Bool[Array, " *rays"], settings: RenderSettings
) -> tuple[Array, Array, Array, Array]:
    """The same as `see_sphere` for one plane."""
    cos = dot(shape.normal, rays.d)
    t = -dot(shape.normal, rays.o - shape.position) / away_from_zero(cos, LEAST_COS)
    edge = image_plane_cut(rays, shape, t, approach(rays, shape, t))
    centered = edge.value >= 0
    seen = centered | (is_within(edge) & may_pass)
    seen = seen & (jnp.abs(cos) >= LEAST_COS) & (t > least_distance(t.dtype)) & ~own
    return t, seen, jnp.zeros_like(own), centered
