"""What residuals that decide hide."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.inverse.noise import hidden_scatter, leverages
from raytrace_jax.inverse.suspects import fitted

ROWS = 60


def columns_with_a_decisive_row(seed, largest):
    columns = np.random.default_rng(seed).normal(size=(3, ROWS))
    columns[1, 7] = largest
    return columns


@given(st.integers(0, 1000), st.floats(1, 100))
def test_the_scatter_is_that_of_estimates_without_one_residual_each(seed, largest):
    columns = columns_with_a_decisive_row(seed, largest)
    random = np.random.default_rng(seed)
    weight, data = random.uniform(0.2, 1, ROWS), random.normal(size=ROWS)

    def estimate(keep):
        return fitted(columns[:, keep], data[None, keep], weight[keep])[:, 0]

    everything = np.arange(ROWS)
    whole = estimate(everything)
    score = weight * (data - whole @ columns)
    moved = np.array([estimate(everything != row) - whole for row in range(ROWS)])
    inverse = np.linalg.inv((columns * weight) @ columns.T)
    seen = (columns * score**2) @ columns.T
    jackknife = inverse @ (seen + hidden_scatter(columns, weight, score)) @ inverse
    # Leverages of less than a hundredth are passed over.
    np.testing.assert_allclose(jackknife, moved.T @ moved, rtol=0.03, atol=0.03 * np.max(moved.T @ moved))
    assert leverages(columns, weight).sum() == pytest.approx(3)


def test_a_row_that_decides_alone_leaves_no_error_infinite_or_nan():
    columns = np.zeros((2, ROWS))
    columns[0], columns[1, 3] = 1.0, 1.0
    assert leverages(columns, np.ones(ROWS))[3] == pytest.approx(1)
    score = np.full(ROWS, 0.1)
    score[3] = 1e-17
    assert np.all(np.isfinite(hidden_scatter(columns, np.ones(ROWS), score)))
