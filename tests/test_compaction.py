"""Packing rays into fixed arrays and unpacking what they bring back."""

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.tracer.levels import compaction

running_count = jax.jit(compaction.running_count)
pack = jax.jit(compaction.pack, static_argnums=1)


@jax.jit
def stacked(values, packing):
    return jnp.stack(list(compaction.unpack(values, packing)))


@jax.jit
def packed_and_unpacked(values, packing):
    return stacked(values[:, packing.candidate], packing)


# A few shapes only: each is compiled once.
MASKS = st.sampled_from([(2, 3), (2, compaction.BLOCK), (1, 100), (2, 150)]).flatmap(
    lambda shape: hnp.arrays(bool, shape)
)
CAPACITIES = st.sampled_from([1, compaction.BLOCK, 3 * compaction.BLOCK, 5 * compaction.BLOCK])


@given(wanted=MASKS)
def test_running_count_is_the_prefix_sum(wanted):
    np.testing.assert_array_equal(running_count(jnp.asarray(wanted.ravel())), np.cumsum(wanted.ravel()))


def test_running_count_is_exact_for_a_large_tile():
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
    np.testing.assert_array_equal(packing.live, np.arange(capacity) < len(kept))
    slots = np.full(wanted.size, capacity)
    slots[kept] = np.arange(len(kept))
    np.testing.assert_array_equal(np.ravel(packing.slot), slots)


@given(wanted=MASKS, capacity=CAPACITIES)
def test_unpack_brings_back_what_was_packed_and_zero_for_the_rest(wanted, capacity):
    values = 1.0 + np.arange(3 * wanted.size).reshape(3, wanted.size)
    packing = pack(jnp.asarray(wanted), capacity)
    back = np.moveaxis(packed_and_unpacked(jnp.asarray(values), packing), 1, 0).reshape(3, -1)
    has_slot = np.isin(np.arange(wanted.size), np.flatnonzero(wanted)[:capacity])
    np.testing.assert_array_equal(back, np.where(has_slot, values, 0))


def test_unpack_is_linear_and_its_transpose_packs():
    wanted = jnp.asarray(np.random.default_rng(1).random((2, 40)) < 0.5)
    packing = pack(wanted, compaction.BLOCK)
    random = np.random.default_rng(2)
    values, weights = (
        jnp.asarray(random.normal(size=(3, compaction.BLOCK))),
        jnp.asarray(random.normal(size=(2, 3, 40))),
    )

    gradient = jax.jit(lambda *x: jax.vjp(lambda values: stacked(values, packing), x[0])[1](x[1])[0])(values, weights)
    np.testing.assert_allclose(np.vdot(weights, stacked(values, packing)), np.vdot(gradient, values), rtol=1e-12)
    np.testing.assert_array_equal(
        np.asarray(gradient)[:, ~np.asarray(packing.live)], 0
    )  # an unused slot has no influence
