"""What rays run through: of all glass shapes around a point the smallest decides, so that a bubble lies in its ball.

Priorities by size (Schmidt and Budge 2002, "Simple nested dielectrics in ray traced images") need no list of what a
path has entered: they say what is on either side of any surface, for any ray alike.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.dispatch import fold_shapes
from raytrace_jax.tracer.geometry.gather import take_column
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.rays import NO_SHAPE
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import dot, dot_fixed, vectors_to


class Sides(NamedTuple):
    """The media on both sides of a surface, as indices of glass shapes or `NO_SHAPE`.

    Args:
        front: on the side that a ray comes from.
        back: on the other side.
    """

    front: Int[Array, " *rays"]
    back: Int[Array, " *rays"]


def media_at(world: World, hits: Hits, entering: Bool[Array, " *rays"]) -> Sides:
    """The media on both sides of each hit; a surface that is not glass parts nothing.

    Args:
        world: the scene.
        hits: where surfaces are hit.
        entering: which rays come from the side that the normal points to.
    """
    around, size = innermost(world, hits)
    transmission, radius = (take_column(column, hits.shape) for column in (world.materials.transmission, sizes(world)))
    first = (radius < size) | ((radius == size) & (hits.shape < around))
    within = jnp.where(jax.lax.stop_gradient(transmission > 0) & (first | (around == NO_SHAPE)), hits.shape, around)
    return Sides(jnp.where(entering, around, within), jnp.where(entering, within, around))


def innermost(world: World, hits: Hits) -> tuple[Int[Array, " *rays"], Float[Array, " *rays"]]:
    """The smallest glass shape around each hit, and its size; the shape that is hit does not count."""
    shapes, transmission, all_sizes, p = jax.lax.stop_gradient(
        (world.shapes, world.materials.transmission, sizes(world), hits.p)
    )

    def ask(kind: ShapeKind, index):
        shape = jax.tree.map(lambda values: values[..., index], shapes)
        holds = is_inside(p, shape) & (transmission[index] > 0) & (hits.shape != index)
        return holds, all_sizes[index], index

    def smaller(best, found):
        (best_size, best_index), (holds, size, index) = best, found
        closer = holds & ((size < best_size) | ((size == best_size) & ((index < best_index) | (best_index < 0))))
        return jnp.where(closer, size, best_size), jnp.where(closer, index, best_index)

    nothing = jnp.full(hits.t.shape, jnp.inf, hits.t.dtype), jnp.full_like(hits.shape, NO_SHAPE)
    hollow = [name for name, kind in SHAPE_KINDS.items() if not kind.has_inside]
    size, index = fold_shapes(shapes.kinds, ask, smaller, nothing, leave_out=hollow)
    return index, size


def is_inside(p: Float[Array, "3 *rays"], shape: Shapes) -> Bool[Array, " *rays"]:
    """Which points lie within one shape, where its function F is negative."""
    toward = vectors_to(shape.position, p)
    height = -dot_fixed(shape.normal, toward)
    return height + shape.curvature / 2 * (dot(toward, toward) - shape.radius * shape.radius) < 0


def sizes(world: World) -> Float[Array, " shapes"]:
    """How large each shape is: its radius, and infinite for what has no end or no inside."""
    curved = world.shapes.curvature > 0
    return jax.lax.stop_gradient(jnp.where(curved, world.shapes.radius, jnp.inf))


def index_of(world: World, medium: Int[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The index of refraction of each medium; 1 where there is no glass."""
    return jnp.where(medium == NO_SHAPE, 1.0, take_column(world.materials.ior, jnp.maximum(medium, 0)))


def ratio(world: World, media: Sides) -> Float[Array, " *rays"]:
    """`eta_t / eta_i` between two media."""
    return index_of(world, media.back) / index_of(world, media.front)


def transmittance(world: World, medium: Int[Array, " *rays"], hits: Hits) -> Float[Array, "3 *rays"]:
    """The share of light that is left after the way through each medium to a hit (Beer-Lambert): `exp(-absorption t)`.

    Where nothing is hit it is 1.
    """
    t = jnp.where(hits.valid, hits.t, 0)
    absorption = take_column(world.materials.absorption, jnp.maximum(medium, 0))
    left = jnp.exp(-jnp.where(medium == NO_SHAPE, 0, absorption) * t)
    return jnp.where(hits.valid, left, 1)
