"""Errors are counted: over many pictures the estimate is as far from the truth as its error bar says."""

import sys
from pathlib import Path

import numpy as np
import pytest
from linear_fit import linear_names, linear_problem
from linear_pictures import COLUMNS, PSEUDO_INVERSE, SIGMA, TRUTH, judged, picture, white
from scipy import ndimage

from raytrace_jax import FitOptions, fit

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments" / "calibration"))
import calibration


def of_samples(seed):
    """Noise that all channels of a pixel have in common, in one pixel of five."""
    where = np.random.default_rng([seed, 1]).uniform(size=COLUMNS.shape[2:]) < 0.2
    return np.where(where, 3 * white(seed)[:1], 0.01 * white(seed))


def rounded(seed):
    """The error of storing a noisy picture in steps of the noise."""
    target = picture(TRUTH) + white(seed)
    return np.round(target / SIGMA) * SIGMA - picture(TRUTH)


NOISES = {
    "of samples": of_samples,
    "rounded": rounded,
    "white": white,
    "of light": lambda seed: white(seed) * np.sqrt(np.abs(picture(TRUTH)) + 0.05),
    "of neighbours": lambda seed: ndimage.gaussian_filter(white(seed), (0, 0.7, 0.7)),
}


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("name", NOISES)
def test_errors_of_linear_pictures_hold(name):
    draws = 40
    noises = [NOISES[name](seed) for seed in range(draws)]
    z = np.array([PSEUDO_INVERSE @ noise.reshape(-1) / judged(noise).standard_error for noise in noises])
    # The root mean square of 120 is known to 6 %.
    assert 0.82 < np.sqrt(np.mean(z**2)) < 1.18
    assert 0.01 <= np.mean(np.abs(z) > 2) <= 0.12


def fitted(light, weight, **options):
    """The fit of a noisy picture in another unit of light, all of whose weights are the same."""
    target = light * (picture(TRUTH) + white())
    problem = linear_problem(light * COLUMNS, target, start=TRUTH + 0.05)
    weights = np.full(target.shape[1:], weight)
    options = FitOptions(search=False, **options)
    return fit(problem.scene, target, linear_names(3), problem.base, options=options, weights=weights)


@pytest.mark.parametrize("sampling", ["point", "aware"])
def test_answers_ignore_the_unit_of_light(sampling):
    usual = fitted(1.0, 1.0, target_sampling=sampling)
    for light, weight in ((1e-30, 1.0), (1e30, 1.0), (1.0, 1e-30), (1.0, 1e30), (3e-7, 5e5)):
        found, unit = fitted(light, weight, target_sampling=sampling), light * weight**0.5
        assert found.status == usual.status == "converged"
        np.testing.assert_allclose(found.value, usual.value, atol=1e-3 * usual.total_error.min())
        np.testing.assert_allclose(found.total_error, usual.total_error, rtol=1e-3)
        np.testing.assert_allclose(found.uncertainty.sigma, unit * usual.uncertainty.sigma, rtol=1e-3)
        np.testing.assert_allclose(found.weights, weight)
        assert found.steps[0].cost == pytest.approx(unit**2 * usual.steps[0].cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["grid", "stratified", "random", "8 bits", "JPEG 90"])
def test_foreign_pictures_fit_within_errors(name):
    row = calibration.run_fit(name, film=False, number=1)
    assert row["status"] == "converged"
    assert all(abs(row["off"][number]) < 3.6 * row["error"][number] for number in row["off"])
