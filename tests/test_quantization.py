"""What stored numbers say of colours: intervals that hold the original, and nothing said of other pictures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.images.png import decode_course, decode_srgb, encode_course, encode_srgb
from raytrace_jax.images.quantization import stored_intervals

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
