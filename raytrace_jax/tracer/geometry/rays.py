"""A batch of rays: where they are, what they stand for, how they travel packed; and look-ups of one entry a ray."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

Scalars = Float[Array, " *rays"]
Vectors = Float[Array, "3 *rays"]
Flags = Bool[Array, " *rays"]
Integers = Int[Array, " *rays"]
"""A number, a vector, a truth or a whole number for each ray, whatever axes the rays have."""

NO_SHAPE = -1
"""The shape index of a ray that starts in free space, and of one that hits nothing."""


class Footprint(eqx.Module):
    """The change of a ray across the part of a pixel that it stands for: a parallelogram, the image of a unit square.

    Args:
        o: derivatives of the origin with respect to the square's two coordinates, which run from -1/2 to 1/2.
        d: derivatives of the direction with respect to these coordinates.
    """

    o: Float[Array, "2 3 *rays"]
    d: Float[Array, "2 3 *rays"]


class Beam(eqx.Module):
    """The part of a ray that it carries besides when it stands for an area and may pass the edge of a shape.

    Args:
        passed: the last two shapes past whose edges the ray went since its origin, or `NO_SHAPE`; it ignores them.
        depth: how often the path has bounced.
        subdivisions: how often its footprint has been cut into smaller ones.
    """

    footprint: Footprint
    passed: Int[Array, "2 *rays"]
    depth: Integers
    subdivisions: Integers


class Rays(eqx.Module):
    """Rays `o + t d`, with what decides exactly, without an epsilon, whether they can meet their own origin again.

    Args:
        o: origins, world units.
        d: directions of length one.
        path_length: length of the path from the viewpoint to the origin, world units.
        origin_shape: index of the shape on which the ray starts, or `NO_SHAPE`.
        inside: whether the ray leaves that shape's surface towards the side that its normal points away from.
        edge_beam: for tracing that is aware of edges, else None.
        path_throughput: about how much the ray's colour counts in its camera ray's; not differentiable. None where
            nothing asks.
    """

    o: Vectors
    d: Vectors
    path_length: Scalars
    origin_shape: Integers
    inside: Flags
    edge_beam: Beam | None = None
    path_throughput: Scalars | None = None

    @property
    def throughput(self) -> Scalars:
        """How much the ray counts in its pixel, where that is asked."""
        assert self.path_throughput is not None
        return self.path_throughput

    @property
    def beam(self) -> Beam:
        """The ray's beam, where tracing is aware of edges."""
        assert self.edge_beam is not None
        return self.edge_beam


INDEX_BITS = 12
"""An index of a shape takes so many bits of the numbers in which all that is discrete about rays travels."""

MOST_SHAPES = (1 << INDEX_BITS) - 2
"""Edge-aware tracing can tell so many shapes apart; one more number stands for none."""

COUNT_BITS = 3
"""The number of subdivisions takes so many bits."""


def packed(rays: Rays) -> tuple:
    """Rays as a tree of few arrays, continuous and discrete ones: moving rays costs by the number of values."""
    numbers, footprint = [2 * rays.origin_shape + rays.inside.astype(jnp.int32)], None
    if rays.edge_beam is not None:
        footprint = rays.beam.footprint
        numbers[0] = (numbers[0] << COUNT_BITS) + rays.beam.subdivisions
        first, second = rays.beam.passed + 1
        numbers.append(first + (second << INDEX_BITS) + (rays.beam.depth << 2 * INDEX_BITS))
    return (rays.o, rays.d, rays.path_length, footprint, rays.path_throughput), numbers


def unpacked(values: tuple) -> Rays:
    """The rays that `packed` has packed."""
    (o, d, path_length, footprint, throughput), (own, *others) = values
    edge_beam = None
    if footprint is not None:
        (edges,) = others
        mask = (1 << INDEX_BITS) - 1
        passed = jnp.stack([edges & mask, (edges >> INDEX_BITS) & mask]) - 1
        edge_beam = Beam(footprint, passed, edges >> 2 * INDEX_BITS, own & ((1 << COUNT_BITS) - 1))
        own = own >> COUNT_BITS
    return Rays(o, d, path_length, own >> 1, (own & 1) == 1, edge_beam, throughput)


UNROLL = 12
"""Up to this many entries a look-up is a chain of selections, and a loop over shapes is written out: both run faster.

A gather and a loop compile in constant time, and serve where there are more."""


def take(table, index: Integers):
    """The entries of a struct of arrays, one for each ray; the entries lie on the last axis, indices are in bounds."""
    return jax.tree.map(lambda column: take_column(column, index), table)


def take_column(column: Shaped[Array, "*components entries"], index: Integers) -> Shaped[Array, "..."]:
    """`column[..., index]`; for a few entries a chain of selections, which is faster than a gather."""
    if column.shape[-1] > UNROLL:
        return column.at[..., index].get(mode="promise_in_bounds")
    return select_column(column, index) if jnp.issubdtype(column.dtype, jnp.floating) else selections(column, index)


def selections(column: Shaped[Array, "*components entries"], index: Integers) -> Shaped[Array, "..."]:
    """The chain of selections."""
    entries = [column[..., k].reshape(column.shape[:-1] + (1,) * index.ndim) for k in range(column.shape[-1])]
    chosen = jnp.broadcast_to(entries[0], column.shape[:-1] + index.shape)
    for k, entry in enumerate(entries[1:], start=1):
        chosen = jnp.where(index == k, entry, chosen)
    return chosen


@jax.custom_jvp
def select_column(column: Float[Array, "*components entries"], index: Integers) -> Float[Array, "..."]:
    """`selections` whose derivative is a product with one-hot vectors: in reverse mode one matrix product."""
    return selections(column, index)


def _select_column_jvp(primals, tangents) -> Any:
    column, index = primals
    column_dot, _ = tangents
    chosen = select_column(column, index)
    if isinstance(column_dot, jax.custom_derivatives.SymbolicZero):
        return chosen, jax.custom_derivatives.SymbolicZero(jax.typeof(chosen).to_tangent_aval())
    one_hot = jax.nn.one_hot(index, column.shape[-1], dtype=column.dtype, axis=0)
    return chosen, jnp.tensordot(column_dot, one_hot, 1, precision=jax.lax.Precision.HIGHEST)


select_column.defjvp(_select_column_jvp, symbolic_zeros=True)
