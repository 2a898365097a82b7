"""The nearest surface along each ray, and everything known there."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.clusters import Clusters, search_clusters
from raytrace_jax.tracer.geometry.dispatch import fold_shapes
from raytrace_jax.tracer.geometry.gather import take
from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays
from raytrace_jax.tracer.geometry.shapes import Shapes, hit_distance, surface_normal
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.numerics import materialize


class Hits(eqx.Module):
    """What lies where each ray ends. Where `valid` is False the other fields are finite and have no meaning.

    Args:
        valid: the ray hits something, and its path is not longer than `ResolvedSettings.longest_path`.
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


class Nodes(eqx.Module):
    """Points of each footprint on its surface, whose mean stands for the footprint's; or hits, where rays are points.

    Hits have no axis of nodes. An axis of length one would make derivatives in reverse mode take half as long again on
    the CPU.

    Args:
        p: the points, world units.
        n: unit normals there, as in `Hits`.
        d: directions of the rays to them, of length one.
        spread: how far the squared cosine of incidence ranges over the footprint: the width of what is uniform and
            varies as much. It is a constant to the derivative, and None of hits.
    """

    p: Float[Array, "3 *nodes rays"]
    n: Float[Array, "3 *nodes rays"]
    d: Float[Array, "3 *nodes rays"]
    spread: Float[Array, " rays"] | None = None

    @property
    def single(self) -> bool:
        """Whether they are hits."""
        return self.p.ndim == 2


def least_distance(unit: Float[Array, ""]) -> Float[Array, ""]:
    """The least distance at which a shape is hit: the course's 1e-5, or 1e-4 in float32, which resolves no more.

    It only matters where two shapes meet. Whether a ray can meet its own shape again is decided by identity and side.

    Args:
        unit: the length that counts as one, as `World.unit`.
    """
    return (1e-5 if unit.dtype == jnp.float64 else 1e-4) * unit


def ends_in_time(path_length: Float[Array, " *rays"], settings: ResolvedSettings) -> Bool[Array, " *rays"]:
    """Whether paths of these lengths still count; a path of infinite length never does."""
    return path_length <= settings.longest_path if settings.has_longest_path else jnp.isfinite(path_length)


def find_nearest(
    shapes: Shapes,
    rays: Rays,
    live: Bool[Array, " *rays"],
    unit: Float[Array, ""],
    settings: ResolvedSettings,
    clusters: Sequence[Clusters] = (),
) -> tuple[Float[Array, " *rays"], Int[Array, " *rays"]]:
    """Distance and index of the nearest shape along each ray; infinity and `NO_SHAPE` where there is none.

    Nothing here is differentiable: `hit_distance` adds the derivative for the one shape that was found.

    Args:
        shapes: the scene's shapes.
        rays: the rays; where there are clusters they have one axis.
        unit: the length that counts as one.
        settings: gives the switch of the second root.
        clusters: all shapes of the kinds of which there are many, `make_clusters`; or none, and each ray asks all.
    """
    least = least_distance(unit)

    def hit(kind: ShapeKind, rays: Rays, index):
        shape = jax.tree.map(lambda values: values[..., index], shapes)
        return kind.hit(rays, shape, rays.origin_shape == index, least, settings)

    def ask(kind: ShapeKind, index):
        return (*hit(kind, rays, index), index)

    def settle(found):
        if not isinstance(found, list):
            return found
        stored = materialize([jnp.where(hits, t, jnp.inf) for t, hits, _ in found], live)
        return [(t, t < jnp.inf, index) for t, (_, _, index) in zip(stored, found, strict=True)]

    def nearer(best, found):
        (best_t, best_index), (t, hits, index) = best, found
        # On a tie the first shape of the file wins; in a loop one kind comes after the other.
        closer = hits & ((t < best_t) | ((t == best_t) & (index < best_index)))
        return jnp.where(closer, t, best_t), jnp.where(closer, index, best_index)

    nothing = jnp.full(rays.path_length.shape, jnp.inf, rays.o.dtype), jnp.full_like(rays.origin_shape, NO_SHAPE)
    best = fold_shapes(shapes.kinds, ask, nearer, nothing, settle, leave_out=[some.kind for some in clusters])
    for some in clusters:
        best = search_clusters(some, rays, best, functools.partial(hit, SHAPE_KINDS[some.kind]), nearer)
    return best


def intersect(
    shapes: Shapes,
    rays: Rays,
    live: Bool[Array, " *rays"],
    unit: Float[Array, ""],
    settings: ResolvedSettings,
    clusters: Sequence[Clusters] = (),
) -> Hits:
    """The nearest hit of each ray, differentiable with respect to rays and shapes.

    Args:
        shapes: the scene's shapes.
        rays: the rays; those that are not live may hold anything finite.
        live: which rays count.
        unit: the length that counts as one.
        settings: gives the switch of the second root, and the length of the longest path.
        clusters: as for `find_nearest`.
    """
    if not shapes.kinds:
        nothing = jnp.zeros_like(rays.path_length)
        return Hits(nothing > 0, nothing, rays.o, rays.d, rays.origin_shape * 0, nothing)

    # Search without derivatives, then differentiate the winner alone.
    fixed_shapes, fixed_rays, clusters = jax.lax.stop_gradient((shapes, rays, clusters))
    t, index = materialize(find_nearest(fixed_shapes, fixed_rays, live, unit, settings, clusters), live)
    valid = live & ends_in_time(fixed_rays.path_length + t, settings)
    index = jnp.maximum(index, 0)
    hit_shape = take(shapes, index)
    # What is not a hit is one at distance 1 with a short normal, which no power of it can blow up.
    hit_shape = eqx.tree_at(lambda s: s.curvature, hit_shape, jnp.where(valid, hit_shape.curvature, 0))
    t = hit_distance(jnp.where(valid, t, 1), rays.o, rays.d, hit_shape)
    p = rays.o + t * rays.d
    return materialize(Hits(valid, t, p, surface_normal(p, hit_shape), index, rays.path_length + t), live)
