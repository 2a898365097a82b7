"""Packing the wanted ones of many candidate rays tightly into arrays of a fixed capacity, and the way back.

Levels of one run have as many slots each as the fullest one, with their live rays at the front. Of edge-aware pictures
in one run half of the slots are empty, and of deep trees most: such a level is traced in chunks, of which those without
a live ray cost nothing.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Shaped

BLOCK = 64
"""Prefix sums are taken in blocks of this many, by a matrix product; capacities are multiples of it."""


class Packing(eqx.Module):
    """Which candidate went into which slot. Candidates are numbered kind by kind, then ray by ray.

    Args:
        slot: for each candidate its slot, or the capacity (one past the last slot) if it has none.
        candidate: for each slot the candidate in it; 0 in the unused slots at the end.
        count: how many candidates were wanted; more than the capacity is an overflow.
    """

    slot: Int[Array, "kinds rays"]
    candidate: Int[Array, " slots"]
    count: Int[Array, ""]

    @property
    def live(self) -> Bool[Array, " slots"]:
        """Which slots are in use."""
        return jnp.arange(self.candidate.shape[0], dtype=jnp.int32) < self.count


def pack(wanted: Bool[Array, "kinds rays"], capacity: int) -> Packing:
    """Give the wanted candidates the slots 0, 1, 2, ... in order, as far as the capacity goes."""
    total = wanted.size
    rank = running_count(wanted.reshape(-1))
    placed = wanted.reshape(-1) & (rank <= capacity)
    slot = jnp.where(placed, rank - 1, capacity)
    numbers = jnp.arange(total, dtype=jnp.int32)
    candidate = jnp.zeros(capacity, jnp.int32).at[slot].set(numbers, mode="drop", unique_indices=True)
    return Packing(slot.reshape(wanted.shape), candidate, rank[-1])


def running_count(wanted: Bool[Array, " candidates"]) -> Int[Array, " candidates"]:
    """Inclusive prefix sum of a mask.

    Two triangular matrix products take a fraction of the time of `jnp.cumsum` on the CPU. float32 counts exactly
    up to 2^24, the largest tile by far.
    """
    padding = -wanted.size % BLOCK
    blocks = jnp.pad(wanted, (0, padding)).astype(jnp.float32).reshape(-1, BLOCK)
    within = blocks @ jnp.triu(jnp.ones((BLOCK, BLOCK), jnp.float32))
    totals = within[:, -1]
    before = totals @ jnp.triu(jnp.ones((len(totals), len(totals)), jnp.float32), 1)
    return (within + before[:, None]).astype(jnp.int32).reshape(-1)[: wanted.size]


def unpack(values: Shaped[Array, "components slots"], packing: Packing) -> Shaped[Array, "kinds components rays"]:
    """The values of each ray's children, kind by kind; zero for a child that has no slot."""
    padded = jnp.concatenate([values, jnp.zeros_like(values[:, :1])], axis=1)
    return jnp.stack([gather(padded, slot) for slot in packing.slot])


def gather(
    values: Shaped[Array, "*components candidates"], index: Int[Array, " slots"]
) -> Shaped[Array, "*components slots"]:
    """`values[..., index]` for indices that are in bounds."""
    return values.at[..., index].get(mode="promise_in_bounds")


T = TypeVar("T")
R = TypeVar("R")

CHUNK = 256
"""Rays in a chunk at most on a CPU, as few as stay in its cache.

512 and 1024 take 1.2 to 1.4 times as long for POV-Ray's checker, 320 x 240, with the pixels that see an edge listed;
128 are slower on the course's scene."""


def chunk_size() -> int:
    """Rays in a chunk at most, on the device that is used."""
    return CHUNK if jax.default_backend() == "cpu" else 1024


def in_chunks(function: Callable[[R, Bool[Array, " rays"]], T], rays: R, live: Bool[Array, " slots"]) -> T:
    """`function(rays, live)`, a chunk at a time; zeros for chunks without live rays.

    In reverse mode a chunk is computed anew from its rays: its values are many, and reading them back takes longer.

    Args:
        function: from rays, a pytree of arrays, to another one, whose arrays have the rays, or 1, as their last axis.
        rays: as many as there are slots.
        live: which of them count.
    """
    slots = live.shape[0]
    count = -(-slots // chunk_size())
    size = BLOCK * -(-slots // (count * BLOCK))

    def split(x: Array) -> Array:
        padded = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, count * size - slots)])
        return jnp.moveaxis(padded.reshape(*x.shape[:-1], count, size), -2, 0)

    def join(x: Array) -> Array:
        moved = jnp.moveaxis(x, 0, -2)
        return moved.reshape(*moved.shape[:-2], count * size)[..., :slots]

    def whole(chunk: tuple[Any, Bool[Array, " rays"]]) -> T:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], size)), function(*chunk))

    def nothing(chunk: tuple[Any, Bool[Array, " rays"]]) -> T:
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(whole, chunk))

    def step(_, chunk: tuple[Any, Bool[Array, " rays"]]):
        return None, jax.lax.cond(jnp.any(chunk[1]), whole, nothing, chunk)

    _, found = jax.lax.scan(jax.checkpoint(step, prevent_cse=False), None, jax.tree.map(split, (rays, live)))
    return jax.tree.map(join, found)
