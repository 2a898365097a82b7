"""Entries of small tables, one for each ray."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Num

UNROLL = 12
"""Up to this many entries a look-up is a chain of selections, and a loop over shapes is written out: both run faster.

A gather and a loop compile in constant time, and serve where there are more."""


def take(table, index: Int[Array, " *rays"]):
    """The entries of a struct of arrays, one for each ray; the entries lie on the last axis, indices are in bounds."""
    return jax.tree.map(lambda column: take_column(column, index), table)


def take_column(column: Num[Array, "*components entries"], index: Int[Array, " *rays"]) -> Num[Array, "..."]:
    """`column[..., index]`; for a few entries a chain of selections, which is faster than a gather."""
    if column.shape[-1] > UNROLL:
        return column.at[..., index].get(mode="promise_in_bounds")
    return select_column(column, index) if jnp.issubdtype(column.dtype, jnp.floating) else selections(column, index)


def selections(column: Num[Array, "*components entries"], index: Int[Array, " *rays"]) -> Num[Array, "..."]:
    """The chain of selections."""
    entries = [column[..., k].reshape(column.shape[:-1] + (1,) * index.ndim) for k in range(column.shape[-1])]
    chosen = jnp.broadcast_to(entries[0], column.shape[:-1] + index.shape)
    for k, entry in enumerate(entries[1:], start=1):
        chosen = jnp.where(index == k, entry, chosen)
    return chosen


@jax.custom_jvp
def select_column(column: Float[Array, "*components entries"], index: Int[Array, " *rays"]) -> Float[Array, "..."]:
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
