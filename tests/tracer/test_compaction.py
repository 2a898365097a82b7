"""Packing rays into fixed arrays."""

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.tracer.levels import compaction

running_count = jax.jit(compaction.running_count)
pack = jax.jit(compaction.pack, static_argnums=1)


# A few shapes only: each is compiled once.
MASKS = st.sampled_from([(2, 3), (2, compaction.BLOCK), (1, 100), (2, 150)]).flatmap(
    lambda shape: hnp.arrays(bool, shape)
)
CAPACITIES = st.sampled_from([1, 3 * compaction.BLOCK])


def test_running_count_is_exact_for_a_large_batch():
    wanted = np.random.default_rng(0).random(1 << 18) < 0.9
    np.testing.assert_array_equal(running_count(jnp.asarray(wanted)), np.cumsum(wanted))


@given(wanted=MASKS, capacity=CAPACITIES)
def test_pack_keeps_the_order_and_drops_only_the_last(wanted, capacity):
    packing = pack(jnp.asarray(wanted), capacity)
    numbers = np.flatnonzero(wanted)
    kept = numbers[:capacity]
    assert packing.count == len(numbers)  # all of them, also those that found no room
    assert packing.candidate.shape == (capacity,)
    np.testing.assert_array_equal(packing.candidate[: len(kept)], kept)
    slots = np.full(wanted.size, capacity)
    slots[kept] = np.arange(len(kept))
    np.testing.assert_array_equal(np.ravel(packing.slot), slots)
