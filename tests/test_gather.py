"""Looking up what belongs to the surface that each ray hits."""

import jax
import numpy as np
import pytest

from raytrace_jax.tracer.geometry.rays import take


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("entries", [1, 5, 12, 13])
def test_taking_entries_and_its_derivatives_are_those_of_an_index(entries):
    column = jax.random.normal(jax.random.key(0), (3, entries))
    index = jax.random.randint(jax.random.key(1), (4, 6), 0, entries)

    def taken(column):
        return take(column, index)

    def indexed(column):
        return column[..., index]

    np.testing.assert_array_equal(taken(column), indexed(column))
    np.testing.assert_allclose(jax.jacfwd(taken)(column), jax.jacfwd(indexed)(column), atol=1e-15)
    np.testing.assert_allclose(jax.jacrev(taken)(column), jax.jacrev(indexed)(column), atol=1e-15)
