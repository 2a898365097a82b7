"""Shares of a footprint where a function is positive, from its values at the four nodes, against counting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.tracer.shading.quadrature import mean, positive_fractions
from raytrace_jax.tracer.visibility.footprints import NODE

CORNERS = [(u * NODE, v * NODE) for u in (-1, 1) for v in (-1, 1)]
GRID = (np.arange(200) + 0.5) / 200 - 0.5


@jax.jit
def share(middle, along_u, along_v):
    values = jnp.stack([middle + u * along_u + v * along_v for u, v in CORNERS])
    return mean(positive_fractions(values[:, None]))[0]


slope_of_share = jax.jit(jax.vmap(jax.grad(share), (0, None, None)))


@given(st.floats(-1, 1), st.floats(0.1, 2), st.booleans())
def test_an_edge_along_a_side_is_exact(middle, slope, second):
    slopes = (0.0, slope) if second else (slope, 0.0)
    expected = np.clip(0.5 + middle / slope, 0, 1)
    assert float(share(middle, *slopes)) == pytest.approx(expected, abs=1e-9)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.05, 1))
def test_any_edge_is_near_the_counted_area(middle, along_u, along_v):
    expected = np.mean(middle + along_u * GRID[:, None] + along_v * GRID > 0)
    assert float(share(middle, along_u, along_v)) == pytest.approx(expected, abs=0.08)


@given(st.floats(-1, 1), st.floats(0.2, 1))
def test_an_edge_that_crosses_the_footprint_counts_once(along_u, along_v):
    middles = np.linspace(-1.5, 1.5, 6001)
    slopes = np.asarray(slope_of_share(jnp.asarray(middles), along_u, along_v))
    assert slopes.sum() * (middles[1] - middles[0]) == pytest.approx(1, abs=2e-2)
