"""Pixels that stand for a picture: all of a small one, of a large one such that sums are right on average."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.inverse.changes import SIDE, chances, look_at


def test_of_a_small_picture_all_pixels_that_count_are_looked_at():
    counts = np.arange(7 * 9).reshape(7, 9) % 3 > 0
    looked = look_at(counts, np.ones((7, 9)), 1000)
    seen = np.zeros((7, 9), int)
    np.add.at(seen, (looked.row, looked.column), 1)
    np.testing.assert_array_equal(seen, counts)
    assert np.all(looked.chance == 1)
    np.testing.assert_array_equal(looked.square, looked.row // SIDE * 3 + looked.column // SIDE)
    np.testing.assert_array_equal(looked.of(np.arange(63).reshape(7, 9)), np.flatnonzero(counts))


@given(st.integers(0, 10**6), st.integers(200, 3000))
def test_about_as_many_are_chosen_as_are_wanted_and_sums_are_about_right(seed, most):
    random = np.random.default_rng(seed)
    weight = random.uniform(0.2, 1, size=(80, 100))
    weight[30:34] *= 30
    looked = look_at(np.ones((80, 100), bool), weight, most)
    assert abs(len(looked.row) - most) <= 2 * SIDE**2 + 0.05 * most
    assert np.all((looked.chance > 0) & (looked.chance <= 1))
    assert abs(np.sum(looked.of(weight) / looked.chance) / weight.sum() - 1) < 0.35


def test_what_decides_is_looked_at_for_certain():
    weight = np.full((40, 40), 1e-6)
    weight[8:12, 8:12] = 1
    looked = look_at(np.ones((40, 40), bool), weight, 300)
    inside = (looked.row // SIDE == 2) & (looked.column // SIDE == 2)
    assert inside.sum() == SIDE**2 and np.all(looked.chance[inside] == 1)


def test_nothing_counts():
    assert len(look_at(np.zeros((8, 8), bool), np.ones((8, 8)), 10).row) == 0


@given(st.lists(st.floats(1e-9, 1), min_size=2, max_size=50), st.integers(1, 200))
def test_chances_are_chances_and_give_what_is_wanted(sizes, most):
    size, pixels = np.array(sizes), np.full(len(sizes), 4.0)
    share = chances(size, pixels, most)
    assert np.all((share >= 0) & (share <= 1))
    assert share @ pixels <= most * (1 + 1e-9) or np.all(share[share > 0] == 1)
