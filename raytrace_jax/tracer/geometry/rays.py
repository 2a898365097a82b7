"""A batch of rays: where they are, what they stand for, how they travel packed; and look-ups of one entry a ray."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

Number = Float[Array, ""]
Count = Int[Array, ""]
Vector = Float[Array, "3"]

Scalars = Float[Array, " *rays"]
Vectors = Float[Array, "3 *rays"]
Flags = Bool[Array, " *rays"]
Integers = Int[Array, " *rays"]
"""A number, a vector, a truth or a whole number for each ray, whatever axes the rays have."""

Pairs = Float[Array, "2 *rays"]
Axes = Float[Array, "2 3 *rays"]
PairAxes = Float[Array, "2 2 *rays"]
"""Two numbers for each ray, and the derivatives of a vector, or of two numbers, along a footprint's two axes."""

NodeScalars = Float[Array, "*nodes rays"]
NodeVectors = Float[Array, "3 *nodes rays"]
"""A number and a vector for each node of each footprint (`intersection.Nodes`)."""

Step = Float[np.ndarray, "2"]
"""How far it is from one pixel of a picture to the next: to the right in `u`, and down in `v`."""

Index = int | Int[Array, ""]
"""The index of one shape, by its first face, or of one face."""

NO_SHAPE = -1
"""The shape index of a ray that starts in free space, and of one that hits nothing."""


class Footprint(eqx.Module):
    """The change of a ray across the part of a pixel that it stands for: a parallelogram, the image of a unit square.

    `o` and `d` are derivatives of origin and direction by the square's two coordinates, which run from -1/2 to 1/2: the
    ray's differential (Igehy 1999). The other fields say how the ray came here.
    """

    o: Axes
    d: Axes
    passed: Int[Array, "2 *rays"]  # The last two shapes that it passed since its origin, or `NO_SHAPE`; ignored.
    depth: Integers  # How often the path has bounced.
    subdivisions: Integers  # How often its footprint has been cut into smaller ones.


class Rays(eqx.Module):
    """Rays `o + t d`, with what decides exactly, without an epsilon, whether they can meet their own origin again."""

    o: Vectors  # Origins, world units.
    d: Vectors  # Directions of length one.
    path_length: Scalars  # Length of the path from the viewpoint to the origin, world units.
    origin_shape: Integers  # Index of the shape on which the ray starts, or `NO_SHAPE`.
    inside: Flags  # Whether the ray leaves that shape's surface towards the side that its normal points away from.
    footprint: Any = None  # A `Footprint` for tracing that is aware of edges, else None.
    throughput: Any = None  # How much each ray's colour counts in its camera ray's, constant; None where nothing asks.


class PackedRays(NamedTuple):
    """Rays as they wait: few arrays, as each of them takes as long to move as many numbers do."""

    moving: Float[Array, "7 *rays"]  # What has a derivative: origins, directions and lengths of paths.
    fixed: Float[Array, "_ *rays"]  # Footprints and throughputs; without rows where nothing asks for them.
    counts: Int[Array, "_ *rays"]  # All that is discrete; last, how many rays are before each in its path.

    @property
    def number(self) -> Integers:
        return self.counts[-1]


def packed(rays: Rays, number: Integers) -> PackedRays:
    moving = jnp.concatenate([rays.o, rays.d, rays.path_length[None]])
    fixed, counts = moving[:0], [rays.origin_shape, rays.inside.astype(jnp.int32)]
    if rays.throughput is not None:
        fixed = rays.throughput[None]
    if rays.footprint is not None:
        fixed = jnp.concatenate([*rays.footprint.o, *rays.footprint.d, fixed])
        counts += [*rays.footprint.passed, rays.footprint.depth, rays.footprint.subdivisions]
    return PackedRays(moving, jax.lax.stop_gradient(fixed), jnp.stack([*counts, number]))


def unpacked(rays: PackedRays) -> Rays:
    moving, fixed, counts = rays
    o, d, path_length = moving[:3], moving[3:6], moving[6]
    footprint = None
    if len(counts) > 3:
        axes = fixed[:12].reshape(2, 2, 3, *path_length.shape)
        footprint = Footprint(axes[0], axes[1], counts[2:4], counts[4], counts[5])
    return Rays(o, d, path_length, counts[0], counts[1] == 1, footprint, fixed[-1] if len(fixed) else None)


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
    spread = column_dot.reshape(column.shape + (1,) * index.ndim)
    return chosen, jnp.sum(spread * one_hot, column.ndim - 1)


select_column.defjvp(_select_column_jvp, symbolic_zeros=True)
