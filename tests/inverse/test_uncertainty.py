"""How sure an estimate is, on pictures that are linear in their parameters: textbook and Monte Carlo are the judges."""

import dataclasses
import operator

import equinox as eqx
import numpy as np
import pytest
from linear_fit import linear_problem
from linear_pictures import (
    COLUMNS,
    POINT,
    PSEUDO_INVERSE,
    ROWS,
    SIGMA,
    SIZE,
    TEXTBOOK,
    TRUTH,
    A,
    B,
    C,
    judged,
    picture,
    state_at,
    white,
)

from raytrace_jax.inverse.judge.uncertainty import direction_in_words, noise_level, quantify_uncertainty
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.linearize import LOSSES, gauss_newton_step
from raytrace_jax.inverse.problem.noise import rounding_scatter
from raytrace_jax.inverse.problem.unknowns import Transform

DRAWS = 2000
"""Noisy pictures of a Monte Carlo run: the scatter of their estimates is known to 1.6 %."""


def spread(draw, estimate=lambda noise: PSEUDO_INVERSE @ noise.reshape(-1)):
    """Standard deviation of the estimates over many pictures; the pictures' seeds are not those of other tests."""
    return np.std([estimate(draw(seed)) for seed in range(10_000, 10_000 + DRAWS)], axis=0)


def reported(draw, **options):
    """Mean of the standard errors that are reported for a few of the pictures."""
    return np.mean([judged(draw(seed), **options).standard_error for seed in range(20)], axis=0)


def test_white_noise_has_textbook_errors():
    sure = judged(white())
    np.testing.assert_allclose(sure.standard_error, TEXTBOOK, rtol=0.05)
    inverse = np.linalg.inv(ROWS.T @ ROWS)
    root = np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(sure.correlation, inverse / np.outer(root, root), atol=0.05)
    np.testing.assert_allclose(np.diag(sure.correlation), 1, rtol=1e-12)
    assert sure.sigma == pytest.approx(SIGMA, rel=0.02)
    assert sure.undetermined == ()
    lengths = np.linalg.norm(ROWS, axis=0)
    assert sure.condition_number == pytest.approx(np.linalg.cond(ROWS / lengths), rel=1e-9)


def test_the_bound_is_inverse_fisher():
    np.testing.assert_allclose(judged(white(), sigma=SIGMA).cramer_rao, TEXTBOOK, rtol=1e-9)
    # It is for the sigma that is given, whatever the residuals show.
    np.testing.assert_allclose(judged(white(), sigma=3 * SIGMA).cramer_rao, 3 * TEXTBOOK, rtol=1e-9)


@pytest.mark.parametrize("shown", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("stage", [POINT, Stage("point", loss="cauchy", loss_scale=3 * SIGMA)])
def test_no_error_is_below_the_stated_bound(shown, stage):
    errors = [judged(shown * white(seed), stage, sigma=SIGMA).standard_error for seed in range(4)]
    np.testing.assert_allclose(np.mean(errors, axis=0), TEXTBOOK, rtol=0.08)


def test_reduced_chi_square_uses_given_sigma():
    assert judged(white(), sigma=SIGMA).reduced_chi_square == pytest.approx(1, abs=0.05)
    assert judged(white(), sigma=2 * SIGMA).reduced_chi_square == pytest.approx(0.25, abs=0.01)
    assert np.isnan(judged(white()).reduced_chi_square)


def blocky(seed, size=4):
    """Noise in squares, as compression leaves it, and a little in each pixel."""
    random = np.random.default_rng(seed)
    blocks = random.normal(size=(3, SIZE[0] // size, SIZE[1] // size)).repeat(size, 1).repeat(size, 2)
    return SIGMA * (blocks + 0.3 * random.normal(size=(3, *SIZE)))


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("size", [4, 8])
def test_correlated_noise_has_larger_errors(size):
    found, true = reported(lambda seed: blocky(seed, size)), spread(lambda seed: blocky(seed, size))
    naive = TEXTBOOK * np.sqrt(1 + 0.3**2)
    assert np.all(true > 2 * naive)
    np.testing.assert_allclose(found, true, rtol=0.25)


UNEVEN = 1 + np.abs(COLUMNS[0]) ** 2
"""The noise's standard deviation where it is largest at the pixels that tell most of the first parameter."""


def uneven(seed):
    return white(seed) * UNEVEN


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_storage_scatter_is_as_predicted(noise):
    random = np.random.default_rng(3)
    square = np.kron(np.indices((4, 6)).sum(axis=0) % 2, np.ones((6, 6)))
    columns = random.normal(1.0, 0.5, (2, 3, 24, 36))
    columns[1] *= square
    pulls, told = [], []
    for _ in range(400):
        picture = np.where(square, random.uniform(0.3, 0.6, (3, 1, 1)), random.uniform(0.6, 0.9, (3, 1, 1)))
        target = np.rint(255 * picture + noise * random.normal(size=picture.shape)) / 255
        pulls.append(np.sum(columns * (picture - target), axis=(1, 2, 3)))
        alone = (columns * (picture - target)).reshape(2, -1)
        told.append(alone @ alone.T + rounding_scatter(columns, np.ones_like(picture), picture, target))
    scatter, expected = np.sqrt(np.mean(np.square(pulls), axis=0)), np.sqrt(np.diag(np.mean(told, axis=0)))
    np.testing.assert_allclose(expected, scatter, rtol=0.1)
    white = np.sqrt(np.sum(columns**2, axis=(1, 2, 3)) / 12) / 255
    assert np.all(scatter > 5 * white) if noise == 0 else np.all(scatter < 5 * white)


def test_unequal_noise_is_seen():
    true, found = spread(uneven), reported(uneven)
    np.testing.assert_allclose(found, true, rtol=0.08)
    naive = TEXTBOOK * np.sqrt(np.mean(UNEVEN**2))
    assert true[0] > 1.25 * naive[0]


def test_right_weights_give_the_bound():
    weights = np.array([1.0, 0.25, 4.0])[np.arange(SIZE[1]) % 3] * np.ones(SIZE)
    noise = white() / np.sqrt(weights)
    weighted = ROWS * np.tile(np.sqrt(weights).reshape(-1), 3)[:, None]
    values = TRUTH + np.linalg.pinv(weighted) @ (noise * np.sqrt(weights)).reshape(-1)
    sure = judged(noise, sigma=SIGMA, values=values, weights=weights)
    expected = SIGMA * np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    np.testing.assert_allclose(sure.cramer_rao, expected, rtol=1e-9)
    np.testing.assert_allclose(sure.standard_error, expected, rtol=0.05)
    assert sure.reduced_chi_square == pytest.approx(1, abs=0.05)


def test_noise_is_measured_where_it_matters():
    """A backdrop that fits exactly says nothing of the noise elsewhere."""
    columns, noise = COLUMNS.copy(), white()
    columns[:, :, 30:] = noise[:, 30:] = 0
    for stage in (POINT, Stage("point", loss="cauchy", loss_scale=2.385 * SIGMA)):
        assert judged(noise, stage, columns=columns).sigma == pytest.approx(SIGMA, rel=0.12)


def test_outliers_hardly_raise_robust_noise():
    noise = white()
    noise[:, ::7, ::7] = 0.8
    problem = linear_problem(COLUMNS, picture(TRUTH) + noise)
    y = problem.array(TRUTH)
    stage = Stage("point", loss="cauchy", loss_scale=2.385 * SIGMA)
    assert noise_level(state_at(problem, y, stage)) == pytest.approx(SIGMA, rel=0.1)
    assert noise_level(state_at(problem, y)) > 4 * SIGMA


def outliers(seed):
    """Gaussian noise with one number in twenty anywhere."""
    random = np.random.default_rng([seed, 1])
    return np.where(random.uniform(size=(3, *SIZE)) < 0.05, random.uniform(-1, 1, (3, *SIZE)), white(seed))


@pytest.mark.slow
def test_robust_errors_hold_with_outliers():
    """The estimates are by iteratively reweighted least squares, a method that shares nothing with the solver."""
    scale = LOSSES["cauchy"].tuning * SIGMA

    def weight(r):
        return 1 / (1 + (r / scale) ** 2)

    def estimate(noise, rounds=12):
        flat, off = noise.reshape(-1), np.zeros(3)
        for _ in range(rounds):
            weighted = ROWS * weight(flat - ROWS @ off)[:, None]
            off = np.linalg.solve(weighted.T @ ROWS, weighted.T @ flat)
        return off

    true = np.std([estimate(outliers(seed)) for seed in range(300)], axis=0)  # known to 4 %
    stage = Stage("point", loss="cauchy", loss_scale=scale)
    found = [judged(outliers(s), stage, values=TRUTH + estimate(outliers(s))).standard_error for s in range(20)]
    np.testing.assert_allclose(np.mean(found, axis=0), true, rtol=0.15)
    assert np.all(true < 0.5 * spread(outliers))


@pytest.mark.parametrize("factor", [1000.0, 1e-6])
def test_a_unit_changes_only_its_own_error(factor):
    units = np.array([1.0, factor, 1.0])
    plain = judged(white(), sigma=SIGMA)
    columns = COLUMNS / units[:, None, None, None]
    other = judged(white(), sigma=SIGMA, columns=columns, scale=units)
    np.testing.assert_allclose(other.standard_error, plain.standard_error * units, rtol=1e-6)
    np.testing.assert_allclose(other.cramer_rao, plain.cramer_rao * units, rtol=1e-6)
    np.testing.assert_allclose(other.correlation, plain.correlation, atol=1e-6)
    assert other.condition_number == pytest.approx(plain.condition_number, rel=1e-6)
    assert other.undetermined == plain.undetermined


def test_errors_do_not_depend_on_transforms():
    values = np.array([0.7, 0.35, 1.2])
    columns, found = COLUMNS, []
    for transforms in (None, [Transform(), Transform(0.0, 1.0), Transform(1.0)]):
        problem = linear_problem(columns, picture(values) + white(), transforms=transforms, priors={C: (1.2, 1e-3)})
        y = problem.y_of(values)
        stage = Stage("point", noise=SIGMA)
        found.append(quantify_uncertainty(state_at(problem, y, stage), SIGMA))
    for one, other in zip(*map(vars, found), strict=True):
        assert one == other
    np.testing.assert_allclose(found[1].standard_error, found[0].standard_error, rtol=1e-9)
    np.testing.assert_allclose(found[1].cramer_rao, found[0].cramer_rao, rtol=1e-9)
    np.testing.assert_allclose(found[1].correlation, found[0].correlation, atol=1e-9)


@pytest.mark.parametrize("loss", ["l2", "cauchy"])
def test_an_exact_picture_has_zero_errors(loss):
    sure = judged(np.zeros((3, *SIZE)), Stage("point", loss=loss, loss_scale=1e-12), values=TRUTH)
    assert np.all(sure.standard_error < 1e-12) and sure.undetermined == ()


def test_overflow_leaves_errors_unknown(monkeypatch):
    problem = linear_problem(COLUMNS, np.tensordot(TRUTH, COLUMNS, 1))
    state = state_at(problem)
    for name in ("information", "curvature", "jacobian", "residual"):
        broken = eqx.tree_at(operator.attrgetter(name), state.linearization, replace_fn=lambda x: x + np.inf)
        found = quantify_uncertainty(dataclasses.replace(state, linearization=broken), None)
        assert np.all(np.isnan(found.standard_error)) and found.undetermined == ()
        assert np.all(np.isfinite(gauss_newton_step(broken)))

    def unconverged(*_):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(np.linalg, "eigh", unconverged)
    assert np.all(np.isnan(quantify_uncertainty(state, 0.1).cramer_rao))


def test_only_an_idle_parameter_is_open():
    columns = COLUMNS.copy()
    columns[1] = 0
    sure, without = judged(white(), columns=columns), judged(white(), columns=columns[[0, 2]])
    assert sure.undetermined == (B,)
    assert sure.weakest == f"{B} +1"
    assert np.isinf(sure.condition_number)
    for found, expected in ((sure.standard_error, without.standard_error), (sure.cramer_rao, without.cramer_rao)):
        assert np.isinf(found[1])
        np.testing.assert_allclose(found[[0, 2]], expected, rtol=0.01)


@pytest.mark.parametrize("factor", [2.0, -0.25])
def test_confounded_parameters_are_named(factor):
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


def test_a_too_large_error_leaves_it_open():
    scale = np.array([1.0, 1.9 * TEXTBOOK[1], 1.0])
    sure = judged(white(), scale=scale)
    assert sure.undetermined == (B,)
    np.testing.assert_allclose(sure.standard_error, TEXTBOOK, rtol=0.05)  # It is still the error.
    assert judged(white(), scale=scale * 1.2).undetermined == ()


def test_a_prior_settles_what_is_open():
    """Only a + 2c is seen: what is known of `a` is what is known before, and `c` follows from it."""
    columns = COLUMNS.copy()
    columns[2] = 2 * columns[0]
    deviation = 0.03
    stage = Stage("point", noise=SIGMA)
    values = np.array([0.3, -0.2, 0.3])
    target = picture(values, columns) + white()
    problem = linear_problem(columns, target, priors={A: (0.3, deviation)})
    y = problem.array(values)
    sure = quantify_uncertainty(state_at(problem, y, stage), SIGMA)
    pair = judged(white(), columns=columns[:2], sigma=SIGMA)
    assert sure.undetermined == ()
    for errors, seen in ((sure.standard_error, pair.standard_error), (sure.cramer_rao, pair.cramer_rao)):
        assert errors[0] == pytest.approx(deviation, rel=1e-3)
        assert errors[1] == pytest.approx(seen[1], rel=0.01)
        assert errors[2] == pytest.approx(np.hypot(deviation, seen[0]) / 2, rel=1e-3)


@pytest.mark.parametrize("loss", ["l2", "cauchy"])
def test_all_are_open_if_nothing_changes(loss):
    stage = Stage("point", loss=loss, loss_scale=SIGMA)
    sure = judged(white(), stage, values=TRUTH, columns=np.zeros_like(COLUMNS))
    assert np.all(np.isinf(sure.standard_error)) and np.all(np.isinf(sure.cramer_rao))
    assert sure.undetermined == (A, B, C)


def test_the_weakest_combination_has_units():
    # Nothing changes along (1, 0, -2, 0.01) in natural scales.
    weakest = np.array([1.0, 0.0, -2.0, 0.01])
    triangle = np.eye(4) - np.outer(weakest, weakest) / (weakest @ weakest)
    words = direction_in_words(triangle, np.array([1.0, 1.0, 10.0, 1.0]), ("a", "b", "c", "d"))
    assert words == "c +1, a -0.05"
