"""What stored numbers say of colours: intervals that hold the original, and nothing said of other pictures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.images.png import decode_course, decode_srgb, encode_course, encode_srgb
from raytrace_jax.images.quantization import rounding_of, stored_intervals

WAYS = {
    "course": lambda colors, bits: decode_course(encode_course(colors, bits=bits)),
    "srgb": lambda colors, bits: decode_srgb(encode_srgb(colors, bits=bits)),
    "rounded": lambda colors, bits: np.round(np.clip(colors, 0, 1) * (2**bits - 1)) / (2**bits - 1),
}


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("way", WAYS)
@given(seed=st.integers(0, 2**31), single=st.booleans())
def test_the_intervals_hold_the_original_and_are_as_wide_as_a_step(way, bits, seed, single):
    colors = np.random.default_rng(seed).uniform(-0.1, 1.1, (3, 8, 9))
    stored = WAYS[way](colors, bits)
    lower, upper = stored_intervals(stored.astype(np.float32) if single else stored)
    assert np.all(lower <= colors + 1e-12) and np.all(colors <= upper + 1e-12)
    assert np.all(np.isfinite(lower) | np.isfinite(upper))
    widths = (upper - lower)[np.isfinite(upper - lower)]
    # The steps of sRGB are 2.3 times as wide for bright colours.
    assert np.all(widths < (2.3 if way == "srgb" else 1.0001) / (2**bits - 1))


@given(seed=st.integers(0, 2**31))
def test_a_picture_that_was_not_stored_has_none(seed):
    assert stored_intervals(np.random.default_rng(seed).uniform(0, 1, (3, 8, 9))) is None


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_the_rounding_of_floats_bounds_what_storing_did(dtype):
    colors = np.random.default_rng(0).uniform(size=(3, 20, 30))
    stored = colors.astype(dtype).astype(np.float64)
    rounding = rounding_of(stored)
    assert np.all(np.abs(stored - colors) <= rounding) and np.all(rounding < 2 * np.finfo(dtype).eps)


def test_the_rounding_of_8_bits_bounds_what_storing_did():
    colors = np.random.default_rng(0).uniform(0.01, 0.99, size=(3, 20, 30))
    stored = np.round(255 * colors) / 255
    assert np.all(np.abs(stored - colors) <= rounding_of(stored)) and np.max(rounding_of(stored)) < 0.6 / 255
    assert np.all(rounding_of(np.array([0.0, 1.0, 0.2])) > [1e9, 1e9, 0]), "what was clamped may have been anything"


def test_what_was_not_stored_has_no_rounding():
    assert not rounding_of(np.random.default_rng(0).uniform(size=(3, 4, 5))).any()
