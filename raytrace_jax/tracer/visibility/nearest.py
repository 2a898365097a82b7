"""Which two surfaces each footprint meets first: `intersection` for footprints, which may meet a surface in part."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.intersection import least_distance
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays
from raytrace_jax.tracer.geometry.shape_type import ShapeType, Sighting
from raytrace_jax.tracer.geometry.shape_types import Index, fold_shapes
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.numerics import materialize, select


class Nearest(eqx.Module):
    """A candidate surface of each ray.

    Args:
        t: distance.
        code: the rest in one number, so that a comparison moves two numbers and not four.
    """

    t: Float[Array, " *rays"]
    code: Int[Array, " *rays"]

    @classmethod
    def of(cls, t, index: Index, found: Sighting) -> "Nearest":
        """A candidate on the shape of that index."""
        # From the highest bit: the index, then two flags. The properties below read them.
        return cls(t, 4 * index + 2 * found.outside.astype(jnp.int32) + found.centered.astype(jnp.int32))

    @property
    def shape(self) -> Int[Array, " *rays"]:
        """Index of the shape, or `NO_SHAPE`."""
        return self.code >> 2

    @property
    def outside(self) -> Bool[Array, " *rays"]:
        """It is a curved shape that is seen from outside of it."""
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
    unit: Float[Array, ""],
    settings: ResolvedSettings,
) -> tuple[Nearest, Nearest]:
    """The nearest surface that any part of each footprint sees, and the next one behind it that its centre sees.

    A ball whose silhouette the centre just misses counts at the first distance at which the footprint may meet it.

    Args:
        shapes, rays, live, may_pass, unit, settings: as for `look.look`.
    """
    least = least_distance(unit)

    # What one shape says: how far away a footprint meets it; infinity where it does not, or has gone past its edge.
    def ask(kind: ShapeType, index: Index) -> Nearest:
        shape = one_shape(shapes, index, rays.path_length.shape)
        found = kind.see(rays, shape, rays.origin_shape == index, may_pass, least, settings)
        seen = found.seen & (index != rays.beam.passed[0]) & (index != rays.beam.passed[1])
        return Nearest.of(jnp.where(seen, found.t, jnp.inf), index, found)

    def nearer(found: Nearest, other: Nearest) -> Bool[Array, " *rays"]:
        # On a tie the first shape of the file wins; in a loop one kind comes after the other.
        return (found.t < other.t) | ((found.t == other.t) & (found.shape < other.shape))

    # The two nearest of all shapes so far. Only the first may be seen in part: what is behind an edge is looked at
    # again by the ray that goes past the edge.
    def put_in_order(two: tuple[Nearest, Nearest], found: Nearest) -> tuple[Nearest, Nearest]:
        nearest, second = two
        first = nearer(found, nearest)
        nearest, lost = select(first, (found, nearest), (nearest, found))
        return nearest, select(lost.centered & nearer(lost, second), lost, second)

    # At first both are at infinity. 4 times `NO_SHAPE` is the code of no shape without flags.
    far = jnp.full_like(rays.path_length, jnp.inf)
    nothing = Nearest(far, jnp.full_like(rays.origin_shape, 4 * NO_SHAPE))
    return fold_shapes(shapes.types, ask, put_in_order, (nothing, nothing), lambda all_: materialize(all_, live))


def one_shape(shapes: Shapes, index: Index, rays: tuple[int, ...]) -> Shapes:
    """One shape, repeated for every ray."""

    def spread(table):
        return jnp.broadcast_to(table[..., index].reshape(table.shape[:-1] + (1,) * len(rays)), table.shape[:-1] + rays)

    return jax.tree.map(spread, shapes)
