"""Which numbers a picture leaves open, how they are named, and how a prior settles them."""

import numpy as np
import pytest
from linear_fit import linear_problem
from linear_pictures import COLUMNS, ROWS, SIGMA, TEXTBOOK, TRUTH, A, B, C, judged, picture, state_at, white

from raytrace_jax.inverse.linearize import Comparison
from raytrace_jax.inverse.uncertainty import in_words, quantify_uncertainty


def test_a_parameter_that_changes_nothing_is_open_and_the_others_are_not():
    columns = COLUMNS.copy()
    columns[1] = 0
    sure, without = judged(white(), columns=columns), judged(white(), columns=columns[[0, 2]])
    assert sure.undetermined == (B,)
    assert sure.weakest == f"{B} +1"
    assert np.isinf(sure.condition_number)
    for found, expected in (
        (sure.standard_error, without.standard_error),
        (sure.cramer_rao, without.cramer_rao),
    ):
        assert np.isinf(found[1])
        np.testing.assert_allclose(found[[0, 2]], expected, rtol=0.01)


@pytest.mark.parametrize("factor", [2.0, -0.25])
def test_two_parameters_that_change_the_same_are_open_and_named_with_the_combination(factor):
    columns = COLUMNS.copy()
    columns[2] = factor * columns[0]
    sure, without = judged(white(), columns=columns), judged(white(), columns=columns[:2])
    assert sure.undetermined == (A, C)
    # a +1 and c -1/factor together change nothing; the larger of the two comes first.
    change = {A: 1.0, C: -1 / factor}
    first, second = sorted(change, key=lambda name: -abs(change[name]))
    assert sure.weakest == f"{first} +1, {second} {change[second] / change[first]:+.3g}"
    assert np.all(np.isinf(sure.standard_error[[0, 2]])) and np.all(np.isinf(sure.cramer_rao[[0, 2]]))
    assert sure.standard_error[1] == pytest.approx(without.standard_error[1], rel=0.01)
    assert sure.cramer_rao[1] == pytest.approx(without.cramer_rao[1], rel=0.01)


def test_an_error_of_more_than_half_the_natural_scale_leaves_a_parameter_open():
    scale = np.array([1.0, 1.9 * TEXTBOOK[1], 1.0])
    sure = judged(white(), scale=scale)
    assert sure.undetermined == (B,)
    np.testing.assert_allclose(sure.standard_error, TEXTBOOK, rtol=0.05)  # It is still the error.
    assert judged(white(), scale=scale * 1.2).undetermined == ()


def test_a_prior_settles_what_the_picture_leaves_open():
    """Only a + 2c is seen: what is known of `a` is what is known before, and `c` follows from it."""
    columns = COLUMNS.copy()
    columns[2] = 2 * columns[0]
    deviation = 0.03
    comparison = Comparison("point", noise=SIGMA)
    values = np.array([0.3, -0.2, 0.3])
    target = picture(values, columns) + white()
    problem = linear_problem(columns, target, priors={A: (0.3, deviation)})
    y = problem.array(values)
    sure = quantify_uncertainty(state_at(problem, y, comparison), SIGMA)
    pair = judged(white(), columns=columns[:2], sigma=SIGMA)
    assert sure.undetermined == ()
    for errors, seen in ((sure.standard_error, pair.standard_error), (sure.cramer_rao, pair.cramer_rao)):
        assert errors[0] == pytest.approx(deviation, rel=1e-3)
        assert errors[1] == pytest.approx(seen[1], rel=0.01)
        assert errors[2] == pytest.approx(np.hypot(deviation, seen[0]) / 2, rel=1e-3)


def test_prior_and_picture_add_their_information():
    comparison = Comparison("point", noise=SIGMA)
    sure = judged(white(), comparison, sigma=SIGMA, priors={A: (0.3, TEXTBOOK[0])})
    information = ROWS.T @ ROWS / SIGMA**2 + np.diag([1 / TEXTBOOK[0] ** 2, 0, 0])
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(sure.cramer_rao, expected, rtol=1e-9)
    np.testing.assert_allclose(sure.standard_error, expected, rtol=0.05)
    assert expected[0] < 0.75 * TEXTBOOK[0]


@pytest.mark.parametrize("loss", ["l2", "cauchy"])
def test_where_no_parameter_changes_the_picture_all_are_open(loss):
    comparison = Comparison("point", loss=loss, loss_scale=SIGMA)
    sure = judged(white(), comparison, values=TRUTH, columns=np.zeros_like(COLUMNS))
    assert np.all(np.isinf(sure.standard_error)) and np.all(np.isinf(sure.cramer_rao))
    assert sure.undetermined == (A, B, C)


def test_the_weakest_combination_is_in_the_parameters_own_units_and_leaves_out_what_hardly_takes_part():
    # Nothing changes along (1, 0, -2, 0.01) in natural scales.
    weakest = np.array([1.0, 0.0, -2.0, 0.01])
    triangle = np.eye(4) - np.outer(weakest, weakest) / (weakest @ weakest)
    words = in_words(triangle, np.array([1.0, 1.0, 10.0, 1.0]), ("a", "b", "c", "d"))
    assert words == "c +1, a -0.05"
