"""The nearest surface along each ray, and everything known there."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays
from raytrace_jax.tracer.geometry.shapes import Shapes, hit_distance, plane_distance, sphere_distances, surface_normal
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.numerics import materialize

UNROLL = 12
"""Up to this many shapes the search is straight-line code, beyond it is a loop (which compiles in constant time)."""


class Hits(eqx.Module):
    """What lies where each ray ends. Where `valid` is False the other fields are finite and have no meaning.

    Args:
        valid: the ray hits something, and its path is not longer than `RenderSettings.max_distance`.
        t: distance from the ray's origin, world units.
        p: the point hit.
        n: unit normal there; outward for a sphere, as the file has it for a plane.
        shape: index of the shape.
        path_length: length of the whole path from the viewpoint.
    """

    valid: Bool[Array, " *rays"]
    t: Float[Array, " *rays"]
    p: Float[Array, "3 *rays"]
    n: Float[Array, "3 *rays"]
    shape: Int[Array, " *rays"]
    path_length: Float[Array, " *rays"]


def least_distance(dtype) -> float:
    """How far away a shape that the ray does not start on must be: the course's 1e-5, what float32 resolves if more.

    It only matters where two shapes meet. That a ray leaves its own shape is decided by identity and side.
    """
    return 1e-5 if dtype == jnp.float64 else 1e-4


def find_nearest(
    shapes: Shapes, rays: Rays, second_root: bool = True
) -> tuple[Float[Array, " *rays"], Int[Array, " *rays"]]:
    """Distance and index of the nearest shape along each ray; infinity and `NO_SHAPE` where there is none.

    Nothing here is differentiable: `hit_distance` adds the derivative for the one shape that was found.
    """
    least = least_distance(rays.o.dtype)

    def consider_plane(index, position, normal, best):
        t, hits = plane_distance(rays.o, rays.d, position, normal)
        return nearer(best, t, hits & (t > least) & (rays.origin_shape != index), index)

    def consider_sphere(index, position, radius, best):
        along, half_chord, hits = sphere_distances(rays.o, rays.d, position, radius)
        near, far = along - half_chord, along + half_chord
        # A ray that starts on this sphere meets it again only if it runs inside, at the end of its chord.
        own = rays.origin_shape == index
        hits = jnp.where(own, rays.inside, hits)
        t = jnp.where(own, 2 * along, jnp.where(near < least, far, near) if second_root else near)
        return nearer(best, t, hits & (t > least) & (True if second_root else ~own), index)

    def nearer(best, t, hits, index):
        best_t, best_index = best
        # On a tie the first shape of the file wins; in a loop the planes come before the spheres.
        closer = hits & ((t < best_t) | ((t == best_t) & (index < best_index)))
        return jnp.where(closer, t, best_t), jnp.where(closer, index, best_index)

    best = jnp.full(rays.path_length.shape, jnp.inf, rays.o.dtype), jnp.full_like(rays.origin_shape, NO_SHAPE)
    if len(shapes.is_sphere) <= UNROLL:
        for index, is_sphere in enumerate(shapes.is_sphere):
            if is_sphere:
                best = consider_sphere(index, shapes.position[:, index], shapes.radius[index], best)
            else:
                best = consider_plane(index, shapes.position[:, index], shapes.normal[:, index], best)
        return best

    planes = jnp.asarray([i for i, is_sphere in enumerate(shapes.is_sphere) if not is_sphere], jnp.int32)
    spheres = jnp.asarray([i for i, is_sphere in enumerate(shapes.is_sphere) if is_sphere], jnp.int32)

    def plane_step(k, best):
        i = planes[k]
        return consider_plane(i, shapes.position[:, i], shapes.normal[:, i], best)

    def sphere_step(k, best):
        i = spheres[k]
        return consider_sphere(i, shapes.position[:, i], shapes.radius[i], best)

    best = jax.lax.fori_loop(0, len(planes), plane_step, best) if len(planes) else best
    return jax.lax.fori_loop(0, len(spheres), sphere_step, best) if len(spheres) else best


def intersect(shapes: Shapes, rays: Rays, live: Bool[Array, " *rays"], settings: RenderSettings) -> Hits:
    """The nearest hit of each ray, differentiable with respect to rays and shapes.

    Args:
        shapes: the scene's shapes.
        rays: the rays; those that are not live may hold anything finite.
        live: which rays count.
        settings: gives the switch of the second root, and the length of the longest path.
    """
    if not shapes.is_sphere:
        nothing = jnp.zeros_like(rays.path_length)
        return Hits(nothing > 0, nothing, rays.o, rays.d, rays.origin_shape * 0, nothing)

    # Search without derivatives, then differentiate the winner alone.
    fixed_shapes, fixed_rays = jax.lax.stop_gradient((shapes, rays))
    t, index = materialize(find_nearest(fixed_shapes, fixed_rays, settings.second_root), live)
    valid = live & (fixed_rays.path_length + t <= settings.max_distance)
    index = jnp.maximum(index, 0)
    hit_shape = take(shapes, index)
    # What is not a hit is one at distance 1 with a short normal, which no power of it can blow up.
    hit_shape = eqx.tree_at(lambda s: s.curvature, hit_shape, jnp.where(valid, hit_shape.curvature, 0))
    t = hit_distance(jnp.where(valid, t, 1), rays.o, rays.d, hit_shape)
    p = rays.o + t * rays.d
    return materialize(Hits(valid, t, p, surface_normal(p, hit_shape), index, rays.path_length + t), live)


def take(table, index: Int[Array, " *rays"]):
    """The entries of a struct of arrays, one for each ray; the entries lie on the last axis, indices are in bounds."""
    return jax.tree.map(lambda column: take_column(column, index), table)


def take_column(column: Float[Array, "*components entries"], index: Int[Array, " *rays"]) -> Float[Array, "..."]:
    """`column[..., index]`: of a few entries by a chain of selections, which is faster than a gather."""
    if column.shape[-1] > UNROLL:
        return column.at[..., index].get(mode="promise_in_bounds")
    return select_column(column, index)


@jax.custom_jvp
def select_column(column: Float[Array, "*components entries"], index: Int[Array, " *rays"]) -> Float[Array, "..."]:
    """The chain of selections. Its derivative is a product with one-hot vectors: in reverse mode one matrix product."""
    entries = [column[..., k].reshape(column.shape[:-1] + (1,) * index.ndim) for k in range(column.shape[-1])]
    chosen = jnp.broadcast_to(entries[0], column.shape[:-1] + index.shape)
    for k, entry in enumerate(entries[1:], start=1):
        chosen = jnp.where(index == k, entry, chosen)
    return chosen


def _select_column_jvp(primals, tangents) -> Any:
    column, index = primals
    column_dot, _ = tangents
    chosen = select_column(column, index)
    if isinstance(column_dot, jax.custom_derivatives.SymbolicZero):
        return chosen, jax.custom_derivatives.SymbolicZero(jax.typeof(chosen).to_tangent_aval())
    one_hot = jax.nn.one_hot(index, column.shape[-1], dtype=column.dtype, axis=0)
    return chosen, jnp.tensordot(column_dot, one_hot, 1, precision=jax.lax.Precision.HIGHEST)


select_column.defjvp(_select_column_jvp, symbolic_zeros=True)
