"""What residuals that decide hide, and how far large changes move a robust estimate."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize

from raytrace_jax.inverse.judge.change_scores import finite_shifts, fitted
from raytrace_jax.inverse.problem.comparison import LOSSES, Comparison
from raytrace_jax.inverse.statistics.scatter import hidden_scatter, leverages

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


def shifted(change, residual, columns, scale):
    """How far a Cauchy fit of the residual moves with a change, by fitting it anew."""

    def fit(data):
        def score(theta):
            return np.asarray(columns @ LOSSES["cauchy"].score(jnp.asarray(data + theta @ columns), jnp.asarray(scale)))

        return optimize.root(score, np.zeros(len(columns)), tol=1e-12).x

    return (fit(residual + change) - fit(residual - change)) / 2


@pytest.mark.parametrize("size", [0.01, 3.0, 30.0])
def test_large_changes_of_a_few_rows_move_a_robust_estimate_as_fits_of_both_signs_do(size):
    random = np.random.default_rng(3)
    rows, scale = 600, 1.0
    columns = random.normal(size=(2, rows))
    residual = random.normal(size=rows) * 0.3
    change = 0.02 * random.normal(size=rows) + 0.01 * columns[0]
    change[:30] = size
    cauchy = Comparison("point", loss="cauchy", loss_scale=scale)
    (found,) = finite_shifts(cauchy, residual, np.ones(rows), columns, change[None]).T
    linear = -fitted(columns, change[None], np.ones(rows))[:, 0]
    exact = shifted(change, residual, columns, scale)
    np.testing.assert_allclose(found, exact, atol=0.1 * np.max(np.abs(exact)))
    if size > 1:
        assert np.max(np.abs(linear - exact)) > 2 * np.max(np.abs(found - exact))


def test_least_squares_follow_every_change():
    random = np.random.default_rng(4)
    columns, changes = random.normal(size=(2, ROWS)), random.normal(size=(3, ROWS)) * 100
    counts = random.uniform(1, 2, ROWS)
    found = finite_shifts(Comparison("aware"), random.normal(size=ROWS), counts, columns, changes)
    np.testing.assert_allclose(found, -fitted(columns, changes, counts), rtol=1e-12)
