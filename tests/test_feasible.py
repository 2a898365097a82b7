"""Sets of half spaces: their middle, points spread evenly over them, and those that contradict all others."""

import math

import numpy as np
import pytest
from scipy import stats

from raytrace_jax.inverse.solve.set_membership import FEASIBLE, chebyshev_center, hit_and_run, violations


def simplex(parameters):
    """Positive numbers whose sum is at most 1."""
    return np.concatenate([-np.eye(parameters), np.ones((1, parameters))]), np.r_[np.zeros(parameters), 1.0]


FALSE_ALARM = 1e-6
"""Probability with which a walk that is right fails a test."""


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("parameters", [1, 2, 4, 7])
def test_a_walk_through_a_simplex_has_its_mean_and_covariance(parameters, seed):
    """The walkers are independent: the mean of each, over the mean's scatter between them, is Student's t.

    So are their mean products of deviations from the true mean, whose true mean is the covariance.
    """
    a, b = simplex(parameters)
    # Squeezed and slanted: the walk must not depend on units.
    slant = np.diag(2.0 ** -np.arange(parameters)) + 0.3 * np.tril(np.ones((parameters, parameters)), -1)
    a = a @ np.linalg.inv(slant)
    points = np.linalg.solve(slant, hit_and_run(a, b, chebyshev_center(a, b), seed))
    assert points.min() > -1e-9 and points.sum(axis=0).max() < 1 + 1e-9
    k = parameters + 1
    # Dirichlet's distribution with all parameters 1.
    covariance = (np.eye(parameters) / k - 1 / k**2) / (k + 1)
    deviations = (points - 1 / k).reshape(parameters, -1, FEASIBLE.chains)
    products = np.einsum("isc,jsc->ijc", deviations, deviations) / deviations.shape[1]
    row, column = np.triu_indices(parameters)
    found = np.concatenate([deviations.mean(axis=1), (products - covariance[..., None])[row, column]])
    error = found.std(axis=1, ddof=1) / np.sqrt(FEASIBLE.chains)
    bound = stats.t.isf(FALSE_ALARM / (2 * len(found)), FEASIBLE.chains - 1)
    assert np.all(np.abs(found.mean(axis=1)) < bound * error)
    # Many enough: of seven numbers the mean is known to 0.036 of the spread, the covariance to 0.08 of the variance.
    # The scatter of 50 walkers is itself known to a tenth, that of their products to a fourth.
    assert np.all(error[:parameters] < 0.06 * np.sqrt(covariance[0, 0]))
    assert np.all(error[parameters:] < 0.25 * covariance[0, 0])


def test_half_spaces_that_bound_nothing_change_nothing():
    a, b = simplex(3)
    inside = chebyshev_center(a, b)
    more = np.concatenate([a, a, np.ones((1, 3))]), np.r_[b, b + 2, 5.0]
    np.testing.assert_allclose(hit_and_run(*more, inside), hit_and_run(a, b, inside))


def test_the_interior_point_of_a_right_triangle_is_its_incenter():
    np.testing.assert_allclose(chebyshev_center(*simplex(2)), 1 - 1 / math.sqrt(2), rtol=1e-6)


def test_half_spaces_without_a_common_point_have_no_interior():
    with pytest.raises(np.linalg.LinAlgError):
        chebyshev_center(np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0]))


def test_the_few_that_contradict_many_are_found():
    random = np.random.default_rng(2)
    a = random.normal(size=(500, 3))
    inside = np.array([0.3, -0.2, 0.1])
    b = a @ inside + random.uniform(0, 1, 500)
    wrong = np.arange(7)
    b[wrong] = a[wrong] @ inside - random.uniform(0.5, 1, 7)
    assert np.flatnonzero(violations(a, b, FEASIBLE.reach)).tolist() == wrong.tolist()
