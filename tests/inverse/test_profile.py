"""The profile likelihood: on a linear picture it is a parabola, its interval and its regression the textbook's."""

import numpy as np
import pytest
from linear_fit import linear_names, linear_problem
from linear_pictures import COLUMNS, ROWS, SIGMA, TRUTH, state_at

from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.result import PROFILE_95
from raytrace_jax.inverse.solve.refine import find_profile, interval


def drawn(place, columns=COLUMNS, priors=None):
    """The profile of one parameter at the optimum, and the optimum."""
    rows = columns.reshape(3, -1).T
    target = rows @ TRUTH + SIGMA * np.random.default_rng(0).normal(size=len(rows))
    precision = np.zeros(3)
    for name, (_, deviation) in (priors or {}).items():
        precision[linear_names(3).index(name)] = SIGMA / deviation
    mean = np.array([(priors or {}).get(name, (0.0, 0.0))[0] for name in linear_names(3)])
    system = np.concatenate([rows, np.diag(precision)])
    best = np.linalg.lstsq(system, np.concatenate([target, precision * mean]), rcond=1e-12)[0]
    problem = linear_problem(columns, target.reshape(columns.shape[1:]), priors=priors)
    stage, y = Stage("point", noise=SIGMA), problem.array(best)
    solution = state_at(problem, y, stage)
    sure = quantify_uncertainty(solution, SIGMA)
    return find_profile(solution, place, sure, 30, Progress(problem)), best, sure


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_linear_profile_is_a_parabola(place):
    found, best, sure = drawn(place)
    covariance = SIGMA**2 * np.linalg.inv(ROWS.T @ ROWS)
    away = found.value - best[place]
    assert found.name == linear_names(3)[place]
    reach = 3 * sure.standard_error[place]
    np.testing.assert_allclose(away, np.linspace(-reach, reach, 13), atol=1e-9)
    np.testing.assert_allclose(found.chi_square, away**2 / covariance[place, place], rtol=1e-5, atol=1e-6)
    along = covariance[:, place] / covariance[place, place]
    np.testing.assert_allclose(found.others, best[:, None] + along[:, None] * away, atol=1e-6)
    half = np.sqrt(PROFILE_95 * covariance[place, place])
    np.testing.assert_allclose(found.interval, [best[place] - half, best[place] + half], rtol=1e-5)


def test_a_prior_counts_in_the_profile():
    deviation = SIGMA / np.sqrt(ROWS[:, 0] @ ROWS[:, 0])
    found, best, _ = drawn(0, priors={"a.center.x": (0.3, deviation)})
    information = ROWS.T @ ROWS / SIGMA**2 + np.diag([1 / deviation**2, 0, 0])
    variance = np.linalg.inv(information)[0, 0]
    np.testing.assert_allclose(found.chi_square, (found.value - best[0]) ** 2 / variance, rtol=1e-4, atol=1e-5)


def test_an_undetermined_profile_is_flat():
    columns = COLUMNS.copy()
    columns[1] = 0
    found, _, _ = drawn(1, columns)
    np.testing.assert_allclose(found.chi_square, 0, atol=1e-6)
    assert found.interval == (-np.inf, np.inf)


def test_an_interval_ends_at_the_bound():
    value = np.linspace(-3, 3, 13)
    low, high = interval(value, np.where(value < 0, 4 * value**2, value**2))
    assert low == pytest.approx(-np.sqrt(PROFILE_95) / 2) and high == pytest.approx(np.sqrt(PROFILE_95))
    assert interval(value, np.where(value < 0, value**2, 1.0 * (value > 0))) == (pytest.approx(-1.96, abs=1e-3), np.inf)
    # A profile whose lowest point is not the estimate.
    shifted = interval(value, (value - 1) ** 2)
    assert shifted == (pytest.approx(1 - 1.96, abs=1e-3), pytest.approx(1 + 1.96, abs=1e-3))
