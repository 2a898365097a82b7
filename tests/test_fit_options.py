"""What a fit can be told beside its free parameters: ties, priors, exposure, masks, noise, losses and profiles."""

import numpy as np
import pytest
from scenes import assignment_scene, scaled_scene

from raytrace_jax import ParameterError, RenderSettings, fit, get_parameter, parse_scene, render, set_parameters

pytestmark = [pytest.mark.slow, pytest.mark.optimized]

SETTINGS = RenderSettings(size=(48, 36), max_bounces=2)
FREE = ["cyan.ior", "yellow.diffuse"]
TIES = {"red.diffuse": "yellow.diffuse"}
ANSWER = np.array([1.4, 0.3, 0.6, 0.8])
SIGMA = 0.002


@pytest.fixture(scope="module")
def truth():
    colour = {"yellow.diffuse": ANSWER[1:], "red.diffuse": ANSWER[1:]}
    return set_parameters(assignment_scene(), {"cyan.ior": ANSWER[0], **colour})


@pytest.fixture(scope="module")
def clean(truth):
    return np.asarray(render(truth, SETTINGS).image)


def noisy(clean, seed=0):
    return clean + np.random.default_rng(seed).normal(0, SIGMA, clean.shape)


def solve(target, truth, **options):
    """A fit on point-sampled pictures from nearby, one program for most of these tests."""
    start = set_parameters(truth, {"cyan.ior": 1.403, "yellow.diffuse": (0.32, 0.58, 0.79)})
    options = {"ties": TIES, "edges": "point", "target_sampling": "point", "search": False, **options}
    return fit(start, target, FREE, SETTINGS, **options)


def test_a_tied_parameter_follows_and_the_noise_is_found(clean, truth):
    result = solve(noisy(clean), truth)
    assert result.status == "converged", result.message
    np.testing.assert_array_equal(get_parameter(result.scene, "red.diffuse"), result.value[1:])
    assert np.all(np.abs(result.value - ANSWER) < 4 * result.standard_error)
    assert result.uncertainty.sigma == pytest.approx(SIGMA, rel=0.1) and not result.uncertainty.sigma_given
    assert np.isnan(result.uncertainty.reduced_chi_square)
    assert result.ties == tuple((f"red.diffuse.{c}", f"yellow.diffuse.{c}") for c in "rgb")


def test_given_noise_is_judged_by_the_reduced_chi_square(clean, truth):
    found = [solve(noisy(clean), truth, sigma=sigma).uncertainty for sigma in (SIGMA, 2 * SIGMA)]
    right, wrong = (sure.reduced_chi_square for sure in found)
    assert right == pytest.approx(1, abs=0.1)
    assert wrong == pytest.approx(right / 4, rel=1e-2)


@pytest.mark.slow
def test_exposure_and_offset_are_found_beside_the_rest(clean, truth):
    result = solve(0.9 * clean + 0.03, truth, fit_exposure=True)
    assert result.names[-2:] == ("film.gain.r", "film.offset.r")
    np.testing.assert_allclose(result.value, [*ANSWER, 0.9, 0.03], atol=1e-6)
    assert result.initial[-2:].tolist() == [1, 0]
    np.testing.assert_allclose(result.pictures.estimate, result.pictures.target, atol=0.05)


def test_a_mask_hides_what_the_scene_lacks_even_nan(clean, truth):
    spoilt, mask = noisy(clean), np.ones(clean.shape[1:])
    spoilt[:, :, 24:30], mask[:, 24:30] = np.nan, 0
    result = solve(spoilt, truth, weights=mask)
    assert result.status == "converged", result.message
    assert np.all(np.abs(result.value - ANSWER) < 4 * result.standard_error)
    np.testing.assert_array_equal(result.pictures.weights, mask)


def test_weights_are_inverse_variances(clean, truth):
    """A half with a tenth of the noise and a hundred times the weight: chi-square is right, the errors are smaller."""
    scale = np.where(np.arange(clean.shape[2]) < 24, 0.1, 1.0)
    noise = SIGMA * scale * np.random.default_rng(5).normal(size=clean.shape)
    result = solve(clean + noise, truth, weights=np.ones((clean.shape[1], 1)) / scale**2, sigma=SIGMA)
    even = solve(noisy(clean), truth, sigma=SIGMA)
    assert result.uncertainty.reduced_chi_square == pytest.approx(1, abs=0.1)
    assert np.all(result.uncertainty.cramer_rao < even.uncertainty.cramer_rao)
    assert np.all(np.abs(result.value - ANSWER) < 4 * result.standard_error)


def test_the_robust_loss_withstands_outliers_and_least_squares_do_not(clean, truth):
    random = np.random.default_rng(3)
    bad = random.random(clean.shape[1:]) < 0.03
    target = np.where(bad, random.random(clean.shape), noisy(clean))
    robust, plain = solve(target, truth, loss="cauchy", sigma=SIGMA), solve(target, truth, loss="l2", sigma=SIGMA)
    assert robust.loss == "cauchy" and plain.loss == "l2"
    errors = [np.linalg.norm((result.value - ANSWER) / robust.uncertainty.cramer_rao) for result in (robust, plain)]
    assert errors[0] < 8 and errors[0] < 0.4 * errors[1], errors


def test_a_prior_pulls_by_its_precision(clean, truth):
    """Two measurements of one number: the mean of both, weighted with their precisions."""
    free = solve(noisy(clean), truth, sigma=SIGMA)
    error = float(free.standard_error[1])
    mean = float(free.value[1]) + 2 * error
    result = solve(noisy(clean), truth, sigma=SIGMA, priors={"yellow.diffuse.r": (mean, error)})
    assert result.value[1] - free.value[1] == pytest.approx(error, rel=0.15)
    assert result.standard_error[1] == pytest.approx(error / np.sqrt(2), rel=0.15)
    assert result.priors == (("yellow.diffuse.r", mean, error),)


@pytest.mark.slow
def test_a_profile_of_a_nearly_linear_problem_is_the_parabola_of_its_error(clean, truth):
    result = solve(noisy(clean), truth, sigma=SIGMA, profiles=["yellow.diffuse.g"])
    (profile,) = result.profiles
    place = result.names.index(profile.name)
    error, estimate = result.standard_error[place], result.value[place]
    assert np.all(np.diff(profile.value) > 0) and profile.chi_square.min() == 0
    np.testing.assert_allclose(profile.chi_square, ((profile.value - estimate) / error) ** 2, rtol=0.35, atol=0.05)
    low, high = profile.interval
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=0.2)
    np.testing.assert_array_equal(profile.others[place], profile.value)


STRIP = """
camera eye { pixeldim 49 36 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 4 3 6 emissivity 0 0 0 }
material grey { ambient .2 .2 .2 }
material white { ambient .9 .9 .9 }
plane wall { material grey normal 0 0 1 point 0 0 -5 }
sphere ball { material white center 4.6 3 -1 radius 1.5 }
"""


@pytest.mark.slow
def test_two_places_that_look_the_same_are_ambiguous():
    """Through a slit a ball to the left looks like one to the right."""
    scene = parse_scene(STRIP)
    target = np.asarray(render(scene, RenderSettings(samples=8)).image)
    slit = np.zeros((36, 49))
    slit[:, 24] = 1
    start = set_parameters(scene, {"ball.center.x": 4.3})
    noise = np.random.default_rng(2).normal(0, 0.01, target.shape)
    result = fit(start, target + noise, ["ball.center.x"], weights=slit, target_sampling="box")
    assert result.status == "ambiguous", (result.message, result.value, result.history.runner_ups)
    found = sorted([float(result.value[0]), *(float(minimum.value[0]) for minimum in result.history.runner_ups)])
    np.testing.assert_allclose(found, [3.4, 4.6], atol=0.03)
    assert "runner-ups" in result.advice
    # The whole picture decides.
    result = fit(start, target + noise, ["ball.center.x"], target_sampling="box")
    assert result.status == "converged", result.message
    assert result.value[0] == pytest.approx(4.6, abs=0.01)


@pytest.mark.slow
def test_a_product_of_two_numbers_is_degenerate_until_a_prior_settles_it():
    """A wall shows how bright its lamp is times how much it reflects, and neither alone."""
    text = STRIP.replace("emissivity 0 0 0", "emissivity .6 .6 .6").replace(
        "grey { ambient .2 .2 .2", "grey { diffuse .5 .5 .5"
    )
    scene, how = parse_scene(text), RenderSettings(max_bounces=0)
    target = np.asarray(render(scene, how).image)
    noise = np.random.default_rng(2).normal(0, 0.01, target.shape)
    free = ["lamp.emissivity.r", "grey.diffuse.r"]
    options = {"edges": "point", "target_sampling": "point", "search": False, "sigma": 0.01}
    result = fit(scene, target + noise, free, how, **options)
    assert result.status == "degenerate", result.message
    assert np.all(np.isinf(result.standard_error)) and "does not determine" in result.message
    # The product stays when one grows by the share by which the other shrinks.
    first, second = (piece.rsplit(" ", 1) for piece in result.uncertainty.weakest.split(", "))
    change = {first[0]: float(first[1]), second[0]: float(second[1])}
    ratio = change["lamp.emissivity.r"] / change["grey.diffuse.r"]
    assert ratio == pytest.approx(-result.value[0] / result.value[1], rel=1e-2)
    result = fit(scene, target + noise, free, how, priors={"grey.diffuse.r": (0.5, 0.02)}, **options)
    assert result.status == "converged", result.message
    assert result.standard_error[1] == pytest.approx(0.02, rel=0.1)
    assert result.standard_error[0] == pytest.approx(0.02 * 0.6 / 0.5, rel=0.2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ties": {"red.diffuse": "cyan.ior"}}, "numbers"),
        ({"ties": {"red.alpha": "yellow.alpha"}}, "not free"),
        ({"priors": {"yellow.diffuse": (1.0, 1.0)}}, "several numbers"),
        ({"priors": {"red.alpha": (1.0, 1.0)}}, "not free"),
        ({"profiles": ["red.alpha"]}, "not free"),
        ({"sigma": 0.0}, "sigma"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, words, clean, truth):
    with pytest.raises(ParameterError, match=words):
        solve(clean, truth, **options)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_fit_of_a_scaled_scene_is_the_scaled_fit(factor):
    """The unit of length says nothing: the solver takes the same steps to the same index and the scaled center."""
    free, answer = ["vitreous.ior", "vitreous.center"], np.array([1.339, 4.302, 2.299, -1.003])
    scene, options = assignment_scene(), {"search": False, "edges": "point", "target_sampling": "point"}
    truth = set_parameters(scene, {"vitreous.ior": answer[0], "vitreous.center": answer[1:]})
    found = []
    # Walls meet the image plane in the first and last columns, which rounding decides.
    weights = np.ones((30, 40))
    weights[:, [0, -1]] = 0
    for size in (1.0, factor):
        # The course's longest path is a length of the model and not of the scene.
        settings = RenderSettings(size=(40, 30), max_bounces=2, path_limit=100 * size)
        target = np.asarray(render(scaled_scene(truth, size), settings).image)
        result = fit(scaled_scene(scene, size), target, free, settings, weights=weights, **options)
        assert result.status == "converged", result.message
        np.testing.assert_allclose(result.value / [1, size, size, size], answer, atol=1e-7)
        found.append([step.cost for step in result.history.steps][:4])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)
