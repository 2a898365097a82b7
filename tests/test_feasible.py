"""Sets of half spaces: their middle, points spread evenly over them, and those that contradict all others."""

import math

import numpy as np
import pytest

from raytrace_jax.inverse.solve.polytope import chebyshev_center, hit_and_run, violations
from raytrace_jax.inverse.solve.set_membership import REACH


def simplex(parameters):
    """Positive numbers whose sum is at most 1."""
    return np.concatenate([-np.eye(parameters), np.ones((1, parameters))]), np.r_[np.zeros(parameters), 1.0]


@pytest.mark.parametrize("parameters", [1, 2, 4, 7])
def test_a_walk_through_a_simplex_has_its_mean_and_covariance(parameters):
    a, b = simplex(parameters)
    # Squeezed and slanted: the walk must not depend on units.
    slant = np.diag(2.0 ** -np.arange(parameters)) + 0.3 * np.tril(np.ones((parameters, parameters)), -1)
    a = a @ np.linalg.inv(slant)
    points = np.linalg.solve(slant, hit_and_run(a, b, chebyshev_center(a, b)))
    assert points.min() > -1e-9 and points.sum(axis=0).max() < 1 + 1e-9
    k = parameters + 1
    # Dirichlet's distribution with all parameters 1.
    covariance = (np.eye(parameters) / k - 1 / k**2) / (k + 1)
    np.testing.assert_allclose(points.mean(axis=1), 1 / k, atol=0.06 / k)
    np.testing.assert_allclose(np.atleast_2d(np.cov(points)), covariance, atol=0.1 * covariance[0, 0])


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
    assert np.flatnonzero(violations(a, b, REACH)).tolist() == wrong.tolist()
