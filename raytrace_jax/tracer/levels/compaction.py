"""Packing the wanted ones of many candidate rays tightly into arrays of a fixed capacity."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from raytrace_jax.tracer.geometry.rays import PackedRays, Rays, packed

T = TypeVar("T")

BLOCK = 64
"""Prefix sums are taken in blocks of this many, by a matrix product; capacities are multiples of it."""


class Packing(eqx.Module):
    """The slots of candidates. These are numbered kind by kind, then ray by ray.

    Args:
        slot: for each candidate its slot, or the capacity (one past the last slot) if it has none.
        candidate: for each slot the candidate in it; 0 in the unused slots at the end.
        count: how many candidates were wanted; more than the capacity is an overflow.
    """

    slot: Int[Array, "kinds rays"]
    candidate: Int[Array, " slots"]
    count: Int[Array, ""]


def pack(wanted: Bool[Array, "kinds rays"], capacity: int) -> Packing:
    """Give the wanted candidates the slots 0, 1, 2, ... in order, as far as the capacity goes."""
    total = wanted.size
    rank = running_count(wanted.reshape(-1))
    placed = wanted.reshape(-1) & (rank <= capacity)
    slot = jnp.where(placed, rank - 1, capacity)
    numbers = jnp.arange(total, dtype=jnp.int32)
    candidate = jnp.zeros(capacity, jnp.int32).at[slot].set(numbers, mode="drop", unique_indices=True)
    return Packing(slot.reshape(wanted.shape), candidate, rank[-1])


def pack_rays(
    kinds: list[tuple[Bool[Array, " rays"], Rays]], number: Int[Array, " rays"]
) -> tuple[PackedRays, Packing]:
    """The wanted rays of all kinds, kind after kind; `number` counts those before each of them."""
    packing = pack(jnp.stack([wanted for wanted, _ in kinds]), sum(wanted.size for wanted, _ in kinds))
    candidates = jax.tree.map(lambda *x: jnp.concatenate(x, -1), *(packed(rays, number) for _, rays in kinds))
    return gather(candidates, packing.candidate), packing


def running_count(wanted: Bool[Array, " candidates"]) -> Int[Array, " candidates"]:
    """Inclusive prefix sum of a mask.

    Two triangular matrix products take a fraction of the time of `jnp.cumsum` on the CPU. float32 counts exactly
    up to 2^24, the largest batch by far.
    """
    padding = -wanted.size % BLOCK
    blocks = jnp.pad(wanted, (0, padding)).astype(jnp.float32).reshape(-1, BLOCK)
    within = blocks @ jnp.triu(jnp.ones((BLOCK, BLOCK), jnp.float32))
    totals = within[:, -1]
    before = totals @ jnp.triu(jnp.ones((len(totals), len(totals)), jnp.float32), 1)
    return (within + before[:, None]).astype(jnp.int32).reshape(-1)[: wanted.size]


def gather(values: T, index: Int[Array, " slots"]) -> T:
    """`values[..., index]` of each leaf, for indices that are in bounds."""
    return jax.tree.map(lambda x: x.at[..., index].get(mode="promise_in_bounds"), values)


def in_blocks(rays: float) -> int:
    """A capacity that holds so many rays."""
    return int(BLOCK * -(-rays // BLOCK))
