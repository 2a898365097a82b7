"""The nearest surface along each ray, and everything known there."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ...scene.scene import least_distance
from ...util.numerics import materialize
from ..settings import ResolvedSettings
from .rays import NO_SHAPE, Flags, Integers, NodeVectors, Number, Rays, Scalars, Vectors, take
from .shape_types import fold_shapes
from .shapes import Faces, Shapes, ShapeType, hit_distance, surface_normal


class SurfaceInteraction(eqx.Module):
    """The ends of rays on surfaces. Where `valid` is False the other fields are finite and have no meaning."""

    valid: Flags  # The ray hits something, and its path is not longer than `ResolvedSettings.path_limit`.
    t: Scalars  # Distance from the ray's origin, world units.
    p: Vectors
    n: Vectors  # Unit normal there; outward for a sphere, as the file has it for a plane.
    shape: Integers  # The index of the face, as in `Shapes`.
    path_length: Scalars  # Length of the whole path from the viewpoint.


class Nodes(eqx.Module):
    """Points of each footprint on its surface, whose mean stands for the footprint's; or hits, where rays are points.

    Hits have no axis of nodes. An axis of length one would make derivatives in reverse mode take half as long again on
    the CPU.
    """

    p: NodeVectors
    n: NodeVectors
    d: NodeVectors  # Directions of the rays to them, of length one.
    # The width of what is uniform and varies as much as the squared cosine of incidence; constant, and None of hits.
    spread: Scalars | None = None

    @property
    def single(self) -> bool:
        return self.p.ndim == 2


def ends_in_time(path_length: Scalars, settings: ResolvedSettings) -> Flags:
    """Whether paths of these lengths still count; a path of infinite length never does."""
    return path_length <= settings.path_limit if settings.has_path_limit else jnp.isfinite(path_length)


def intersect(shapes: Shapes, rays: Rays, live: Flags, unit: Number) -> SurfaceInteraction:
    """The nearest hit of each ray, differentiable with respect to rays and shapes.

    Rays that are not live may hold anything finite.
    """
    if not shapes.types:
        nothing = jnp.zeros_like(rays.path_length)
        return SurfaceInteraction(nothing > 0, nothing, rays.o, rays.d, rays.origin_shape * 0, nothing)

    # Search without derivatives, then differentiate the winner alone.
    fixed_shapes, fixed_rays = jax.lax.stop_gradient((shapes, rays))
    t, index = materialize(find_nearest(fixed_shapes, fixed_rays, live, unit), live)
    valid = live & ends_in_time(fixed_rays.path_length + t, shapes.settings)
    index = jnp.maximum(index, 0)
    hit_shape = take(shapes, index)
    # What is not a hit is one at distance 1 with a short normal, which no power of it can blow up.
    hit_shape = eqx.tree_at(lambda s: s.curvature, hit_shape, jnp.where(valid, hit_shape.curvature, 0))
    # In a branch: in a loop outside of one JAX's reverse mode loses the rule's own derivative, and the second one is
    # wrong.
    operands = jnp.where(valid, t, 1), rays.o, rays.d, hit_shape
    t = jax.lax.cond(jnp.any(live), hit_distance, lambda t, *_: t, *operands)
    p = rays.o + t * rays.d
    return materialize(SurfaceInteraction(valid, t, p, surface_normal(p, hit_shape), index, rays.path_length + t), live)


def find_nearest(shapes: Shapes, rays: Rays, live: Flags, unit: Number) -> tuple[Scalars, Integers]:
    """Distance and index of the nearest face along each ray; infinity and `NO_SHAPE` where there is none.

    Nothing here is differentiable: `hit_distance` adds the derivative for the one shape that was found.
    """
    least = least_distance(unit)

    def ask(shape_type: ShapeType, faces: Faces, index):
        t, hits, face = shape_type.hit(rays, faces, index, least)
        return jnp.where(hits & faces[0].is_met, t, jnp.inf), jnp.asarray(face, jnp.int32)

    def stored(found):
        return materialize(found, live) if isinstance(found, list) else found

    def nearer(best, found):
        (best_t, best_index), (t, index) = best, found
        # On a tie the first shape of the file wins; in a loop one type comes after the other.
        closer = (t < best_t) | ((t == best_t) & (index < best_index))
        return jnp.where(closer, t, best_t), jnp.where(closer, index, best_index)

    nothing = jnp.full(rays.path_length.shape, jnp.inf, rays.o.dtype), jnp.full_like(rays.origin_shape, NO_SHAPE)
    return fold_shapes(shapes, ask, nearer, nothing, stored)
