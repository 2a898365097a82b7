"""What a fit can be told beside its free parameters: ties, priors, exposure, masks, noise, losses and profiles."""

import numpy as np
import pytest
from scenes import assignment_scene, scaled_scene

from raytrace_jax import FitOptions, RenderSettings, fit, parse_scene, render, set_parameters

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
    return fit(start, target, FREE, SETTINGS, options=FitOptions(**options))


def test_a_tied_parameter_follows_its_leader(clean, truth):
    result = solve(noisy(clean), truth)
    assert result.status == "converged", result.message
    np.testing.assert_array_equal(result.scene["red.diffuse"], result.value[1:])
    assert np.all(np.abs(result.value - ANSWER) < 4 * result.standard_error)
    assert result.uncertainty.sigma == pytest.approx(SIGMA, rel=0.1) and not result.uncertainty.sigma_given
    assert np.isnan(result.uncertainty.reduced_chi_square)
    assert result.ties == tuple((f"red.diffuse.{c}", f"yellow.diffuse.{c}") for c in "rgb")


def test_a_prior_pulls_by_its_precision(clean, truth):
    """Two measurements of one number: the mean of both, weighted with their precisions."""
    free = solve(noisy(clean), truth, sigma=SIGMA)
    error = float(free.standard_error[1])
    mean = float(free.value[1]) + 2 * error
    result = solve(noisy(clean), truth, sigma=SIGMA, priors={"yellow.diffuse.r": (mean, error)})
    assert result.value[1] - free.value[1] == pytest.approx(error, rel=0.15)
    assert result.standard_error[1] == pytest.approx(error / np.sqrt(2), rel=0.15)
    assert result.priors == (("yellow.diffuse.r", mean, error),)


STRIP = """
camera eye { pixeldim 49 36 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 4 3 6 emissivity 0 0 0 }
material grey { ambient .2 .2 .2 }
material white { ambient .9 .9 .9 }
plane wall { material grey normal 0 0 1 point 0 0 -5 }
sphere ball { material white center 4.6 3 -1 radius 1.5 }
"""


@pytest.mark.slow
def test_two_alike_places_are_ambiguous():
    """Through a slit a ball to the left looks like one to the right."""
    scene = parse_scene(STRIP)
    target = np.asarray(render(scene, RenderSettings(samples=8)).image)
    slit = np.zeros((36, 49))
    slit[:, 24] = 1
    start = set_parameters(scene, {"ball.center.x": 4.3})
    noise = np.random.default_rng(2).normal(0, 0.01, target.shape)
    result = fit(start, target + noise, ["ball.center.x"], weights=slit, options=FitOptions(target_sampling="box"))
    assert result.status == "ambiguous", (result.message, result.value, result.runner_ups)
    found = sorted([float(result.value[0]), *(float(minimum.value[0]) for minimum in result.runner_ups)])
    np.testing.assert_allclose(found, [3.4, 4.6], atol=0.03)
    assert "runner-ups" in result.advice
    # The whole picture decides.
    result = fit(start, target + noise, ["ball.center.x"], options=FitOptions(target_sampling="box"))
    assert result.status == "converged", result.message
    assert result.value[0] == pytest.approx(4.6, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_fit_of_a_scaled_scene_is_scaled(factor):
    """The unit of length says nothing: the solver takes the same steps to the same index and the scaled center."""
    free, answer = ["vitreous.ior", "vitreous.center"], np.array([1.339, 4.302, 2.299, -1.003])
    scene, options = assignment_scene(), FitOptions(search=False, edges="point", target_sampling="point")
    truth = set_parameters(scene, {"vitreous.ior": answer[0], "vitreous.center": answer[1:]})
    found = []
    # Walls meet the image plane in the first and last columns, which rounding decides.
    weights = np.ones((30, 40))
    weights[:, [0, -1]] = 0
    for size in (1.0, factor):
        # The course's longest path is a length of the model and not of the scene.
        settings = RenderSettings(size=(40, 30), max_bounces=2, path_limit=100 * size)
        target = np.asarray(render(scaled_scene(truth, size), settings).image)
        result = fit(scaled_scene(scene, size), target, free, settings, options=options, weights=weights)
        assert result.status == "converged", result.message
        np.testing.assert_allclose(result.value / [1, size, size, size], answer, atol=1e-7)
        found.append([step.cost for step in result.steps][:4])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)
