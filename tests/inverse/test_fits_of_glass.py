"""Glass before a checkered board in pictures by POV-Ray: what a fit finds, with which error bar, and its last word."""

from pathlib import Path

import numpy as np
import pytest
from physical_scenes import Camera, Checker, Material, Rectangle, Scene, Sphere, scene_text

from raytrace_jax import FitOptions, RenderSettings, fit, load_scene, parse_scene, read_picture, set_parameters
from raytrace_jax.inverse.result import last_word

DATA = Path(__file__).parents[2] / "data"
PICTURES = Path(__file__).parents[1] / "physical_pictures"
SIZE = (80, 60)
SQUARES = Checker((0.1, 0.15, 0.25), (0.9, 0.85, 0.8), 0.8, (0.13, 0.07))
BOARD = Rectangle(Material(emission=(1, 1, 1), texture=SQUARES), (0, 0, -2.5), (6, 0, 0), (0, 6, 0))
BALL = Sphere(Material(transmission=1, ior=1.5168), (0.12, -0.07, 0.15), 1)
NEAR = {"m1.ior": 1.512, "s1.center": (0.123, -0.073, 0.153)}


def errors_of(target, *balls, free, start, **hidden):
    """The fit, each estimate's error, and the same in total errors."""
    eye = Camera(SIZE, (0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
    described = Scene(eye, [BOARD, *balls], radiance=(0.05, 0.06, 0.08), max_bounces=12, least_weight=1e-6)
    truth = parse_scene(scene_text(described))
    scene = set_parameters(truth, {**start, **hidden})
    result = fit(
        scene, read_picture(PICTURES / target), free, RenderSettings(size=SIZE), options=FitOptions(search=False)
    )
    off = result.value - np.array([float(truth[name]) for name in result.names])
    return result, np.abs(off), np.abs(off) / result.total_error


@pytest.mark.slow
@pytest.mark.optimized
def test_the_index_is_read_within_its_error():
    result, off, in_errors = errors_of("fit_ball.exr", BALL, free=["m1.ior", "s1.center"], start=NEAR)
    assert result.status == "converged" and result.target_samples == 8, result.message
    assert off[0] < 2e-5 and off.max() < 6e-5
    assert in_errors.max() < 3


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("by_abbe", [True, False])
def test_the_glass_of_a_dispersive_ball_is_named(by_abbe):
    """POV-Ray's N-SF11, by the catalogue's index in each channel: n_d 1.78472, V_d 25.68."""
    start = {"m1.ior": 1.78, "m1.abbe": 30} if by_abbe else {"m1.ior": (1.78, 1.79, 1.8)}
    ball = Material(transmission=1, ior=1.7, abbe=40) if by_abbe else Material(transmission=1, ior=(1.7, 1.7, 1.7))
    eye = Camera(SIZE, (0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
    shapes = [BOARD, Sphere(ball, (0.123, -0.073, 0.153), 1)]
    described = Scene(eye, shapes, radiance=(0.05, 0.06, 0.08), max_bounces=12, least_weight=1e-6)
    scene = set_parameters(parse_scene(scene_text(described)), start)
    options = FitOptions(search=False)
    target = read_picture(PICTURES / "fit_flint.exr")
    result = fit(scene, target, [*start, "s1.center"], RenderSettings(size=SIZE), options=options)
    found = result.dispersions["m1"]
    assert result.status == "converged", result.message
    assert found.n_d == pytest.approx(1.78472, abs=3e-4) and abs(found.abbe - 25.68) < 2 * found.errors[1] < 1.0
    words = last_word(result)
    assert "N-SF11" in words and "V_d 25." in words and words.endswith(f"{result.which_glass[0]}.")


@pytest.mark.slow
@pytest.mark.optimized
def test_a_wrong_radius_does_not_converge():
    wrong = {"s1.radius": 1.001}
    result, off, in_errors = errors_of("fit_ball.exr", BALL, free=["m1.ior", "s1.center"], start=NEAR, **wrong)
    assert off[0] > 1e-4 and (result.status != "converged" or in_errors.max() < 3), result.message


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("wrong", [{"eye.fov": 40.012}, {"squares.square": 0.8004}])
def test_what_only_the_board_shows_is_seen(wrong):
    """A hair's breadth of the board, beside the ball: no free number moves there, and the index is ten errors off."""
    truth = {"glass.ior": 1.5168, "glass.center": (0.12, -0.07, 0.15)}
    scene = set_parameters(load_scene(DATA / "pov_ball.txt", dtype=np.float64), truth | wrong)
    options = FitOptions(search=False, blur=[0.0], target_samples=8)
    result = fit(scene, read_picture(DATA / "pov_ball.exr"), list(truth), options=options)
    assert abs(result.value[0] - 1.5168) > 1e-5, "the case is worth testing"
    assert result.status == "model_incomplete"
    assert np.all(np.abs(result.value - np.hstack(list(truth.values()))) < 2 * result.total_error)


@pytest.mark.slow
@pytest.mark.optimized
def test_a_level_board_leaves_fov_open():
    """They change sides of a row of samples all at once: steps with the derivative end nine errors off."""
    scene = load_scene(PICTURES / "numpy_ball.txt", dtype=np.float64)
    target = read_picture(PICTURES / "numpy_ball.png", transfer="srgb")
    result = fit(scene, target, ["ball.ior", "ball.center", "eye.fov"], options=FitOptions(search=False))
    assert result.status == "converged", result.message
    truth = [1.47, 0.15, -0.1, 0.2, 32]
    assert np.all(np.abs(result.value - truth) < 3 * result.total_error)
    assert np.all(result.standard_error < [2e-5, 1e-5, 1e-5, 1e-4, 5e-4])
