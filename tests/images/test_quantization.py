"""How far storing may have moved colours: no further than it did, and nothing said of other pictures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.images.transfer import decode_course, decode_srgb, encode_course, encode_srgb, rounding_of

WAYS = {
    "course": lambda colors, bits: decode_course(encode_course(colors, bits=bits)),
    "srgb": lambda colors, bits: decode_srgb(encode_srgb(colors, bits=bits)),
    "rounded": lambda colors, bits: np.round(np.clip(colors, 0, 1) * (2**bits - 1)) / (2**bits - 1),
}


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("way", WAYS)
@given(seed=st.integers(0, 2**31), single=st.booleans())
def test_the_rounding_bounds_storage_errors(way, bits, seed, single):
    colors = np.random.default_rng(seed).uniform(-0.1, 1.1, (3, 8, 9))
    stored = WAYS[way](colors, bits)
    stored = stored.astype(np.float32).astype(np.float64) if single else stored
    rounding = rounding_of(stored)
    assert np.all(np.abs(stored - colors) <= rounding + 1e-12)
    assert np.all(np.isinf(rounding[(colors < 0) | (colors > 1)])), "what was clamped may have been anything"
    # The steps of sRGB are 2.3 times as wide for bright colours; single precision moves a number to one side.
    widest = (1.16 if way == "srgb" else 0.5001) / (2**bits - 1) + 5e-7 * single
    assert np.all(rounding[np.isfinite(rounding)] < widest)


@given(seed=st.integers(0, 2**31))
def test_an_unstored_picture_has_no_rounding(seed):
    assert not rounding_of(np.random.default_rng(seed).uniform(0, 1, (3, 8, 9))).any()


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_float_rounding_bounds_the_error(dtype):
    colors = np.random.default_rng(0).uniform(size=(3, 20, 30))
    stored = colors.astype(dtype).astype(np.float64)
    rounding = rounding_of(stored)
    assert np.all(np.abs(stored - colors) <= rounding) and np.all(rounding < 2 * np.finfo(dtype).eps)
