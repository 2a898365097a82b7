"""What a film makes of a picture: each effect beside NumPy and SciPy, their derivatives, and where nothing is done."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene
from scipy import ndimage

from raytrace_jax import ParameterError, RenderSettings, picture_derivatives, render, set_parameters
from raytrace_jax.scene.response import (
    LEAST_LIGHT,
    RESPONSE_EFFECTS,
    Frame,
    apply_response,
    neutral_response,
    without_idle,
)
from raytrace_jax.tracer.settings import resolve_settings

WHOLE = Frame(0, 0, 1, 32, 24)
LIGHT = ndimage.gaussian_filter(np.random.default_rng(0).uniform(0, 1, (3, 24, 32)), (0, 1, 1), mode="nearest")
VALUES = {
    "light": (-0.3, 0.2, 0.1, -0.05, 0.15),
    "vignetting": 0.2,
    "blur": 0.8,
    "gain": (0.9, 1.1, 0.7),
    "offset": (0.01, -0.02, 0.0),
    "gamma": 0.8,
}
SETTINGS = RenderSettings(size=(32, 24), max_bounces=2)


def film_with(**values):
    film = neutral_response(np.dtype(np.float64))
    return dataclasses.replace(film, **{name: jnp.asarray(value, jnp.float64) for name, value in values.items()})


def developed(image=LIGHT, frame=WHOLE, **values):
    return np.asarray(apply_response(jnp.asarray(image), without_idle(film_with(**values)), frame))


def test_the_table_has_every_film_effect():
    assert {effect.name for effect in RESPONSE_EFFECTS} == set(VALUES)
    fields = [field.name for field in dataclasses.fields(neutral_response(np.dtype(np.float64)))]
    assert fields == ["name", *(effect.name for effect in RESPONSE_EFFECTS)]


@pytest.mark.slow
def test_a_neutral_film_does_nothing():
    found = np.asarray(apply_response(jnp.asarray(LIGHT), neutral_response(np.dtype(np.float64)), WHOLE))
    np.testing.assert_allclose(found, LIGHT, atol=1e-14)
    assert developed() is not None and np.array_equal(developed(), LIGHT)


def test_gain_and_offset_are_by_channel():
    gain, offset = np.array([0.9, 1.1, 0.7]), np.array([0.01, -0.02, 0])
    wanted = LIGHT * gain[:, None, None] + offset[:, None, None]
    np.testing.assert_allclose(developed(gain=gain, offset=offset), wanted, atol=1e-15)


def test_vignetting_is_what_the_corners_lose():
    white = np.ones((3, 1001, 1501))
    found = developed(white, Frame(0, 0, 1, 1501, 1001), vignetting=0.3)[0]
    assert found[500, 750] == pytest.approx(1)
    assert found[0, 0] == pytest.approx(0.7, abs=1e-3) == found[-1, -1]
    assert found[500, 0] == pytest.approx(1 - 0.3 * 1501**2 / (1501**2 + 1001**2), abs=1e-3)


def test_light_is_a_quadratic_of_the_picture():
    """From the left to the right and from the top to the bottom side, also of a crop and of pixels in squares."""
    white = np.ones((3, 2, 4))
    u, v = np.array([-0.75, -0.25, 0.25, 0.75]), np.array([[-0.5], [0.5]])
    wanted = 1 - 0.3 * u + 0.2 * v + 0.1 * (u**2 - 1 / 3) - 0.05 * u * v + 0.15 * (v**2 - 1 / 3)
    np.testing.assert_allclose(developed(white, Frame(0, 0, 1, 4, 2), light=VALUES["light"])[1], wanted, atol=1e-15)
    crop = developed(white[:, 1:, 1:3], Frame(1, 1, 1, 4, 2), light=VALUES["light"])
    np.testing.assert_allclose(crop[2], wanted[1:, 1:3], atol=1e-15)
    squares = developed(white, Frame(0, 0, 3, 12, 6), light=VALUES["light"])
    np.testing.assert_allclose(squares[0], wanted, atol=1e-15)


def test_a_part_is_developed_as_the_whole():
    """A crop knows where in the whole picture it is."""
    crop, film = Frame(8, 5, 1, 32, 24), {"light": VALUES["light"], "vignetting": 0.3, "gain": (1.1, 1, 1)}
    found = developed(LIGHT[:, 5:20, 8:30], crop, **film)
    np.testing.assert_allclose(found, developed(**film)[:, 5:20, 8:30], atol=1e-15)


def test_the_blur_is_scipys_gaussian():
    found = developed(blur=1.1)
    wanted = ndimage.gaussian_filter(LIGHT, (0, 1.1, 1.1), mode="nearest", truncate=8)
    inside = np.s_[:, 5:-5, 5:-5]
    np.testing.assert_allclose(found[inside], wanted[inside], atol=1e-4)


def test_gamma_is_linear_near_zero():
    light = np.tile(np.array([-1.0, 0.0, LEAST_LIGHT / 2, LEAST_LIGHT, 0.5]), (3, 1, 1))
    found = developed(light, Frame(0, 0, 1, 5, 1), gamma=0.45)[0, 0]
    assert np.all(np.diff(found) > 0) and np.isfinite(found).all()
    assert found[3] == pytest.approx(LEAST_LIGHT**0.45) and found[4] == pytest.approx(0.5**0.45)


@pytest.mark.fast_cases(4)
@pytest.mark.parametrize(
    ("name", "at"),
    [(name, at) for name in VALUES for at in ("default", "elsewhere") if (name, at) != ("blur", "default")],
)
def test_derivatives_are_finite_differences(name, at):
    """By the effect's numbers and by the light, forward and reverse; at its default, and where there is no light."""
    (effect,) = [effect for effect in RESPONSE_EFFECTS if effect.name == name]
    value = jnp.asarray(effect.neutral if at == "default" else VALUES[name], jnp.float64)
    light = jnp.asarray(np.where(np.arange(32) < 3, 0.0, LIGHT))
    random = np.random.default_rng(1)
    by_value, by_light = (jnp.asarray(random.normal(size=np.shape(x))) for x in (value, light))
    weight = jnp.asarray(random.normal(size=light.shape))

    def total(value, light):
        film = dataclasses.replace(without_idle(film_with()), **{name: value})
        return jnp.sum(weight * apply_response(light, film, WHOLE))

    def moved(step):
        return total(value + step * by_value, light + step * by_light)

    wanted = (moved(1e-7) - moved(-1e-7)) / 2e-7
    _, forward = jax.jvp(total, (value, light), (by_value, by_light))
    gradients = jax.grad(total, (0, 1))(value, light)
    reverse = jnp.sum(gradients[0] * by_value) + jnp.sum(gradients[1] * by_light)
    np.testing.assert_allclose([forward, reverse], wanted, rtol=1e-5, atol=1e-5)


def test_derivatives_are_finite_when_dark():
    film = without_idle(film_with(), kept=set(VALUES))
    black = jnp.zeros((3, 24, 32))

    def total(film, light):
        return jnp.sum(apply_response(light, film, WHOLE))

    gradient = jax.grad(total, (0, 1))(film, black)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    assert float(gradient[0].blur) == 0


@pytest.mark.slow
def test_a_scene_is_rendered_with_its_film():
    scene = assignment_scene()
    plain = render(scene, SETTINGS).image
    filmed = set_parameters(scene, {"film.blur": 0.9, "film.gain": (0.9, 1, 1.2), "film.vignetting": 0.1})
    found = render(filmed, SETTINGS)
    film = without_idle(filmed.film)
    frame = resolve_settings(scene, SETTINGS).frame(scene.camera.pixeldim)
    np.testing.assert_allclose(found.image, apply_response(plain, film, frame), atol=1e-12)
    light, traced = (jax.jit(functools.partial(render, settings=SETTINGS))(each) for each in (scene, filmed))
    off = np.abs(np.asarray(traced.image - apply_response(light.image, film, frame)))
    assert np.median(off) < 1e-14, "but around pixels on an edge, where rounding decides"


@pytest.mark.slow
def test_derivative_pictures_know_the_film():
    scene = assignment_scene()
    names = ["film.gain.g", "film.blur", "film.vignetting", "vitreous.ior"]
    filmed = set_parameters(scene, {"film.blur": 0.9, "film.gain": (0.9, 1, 1.2)})
    found = picture_derivatives(filmed, names, SETTINGS)
    for name, derivative in zip(names[:3], found.values, strict=False):
        value = float(filmed[name])
        ahead, behind = (render(set_parameters(filmed, {name: value + s}), SETTINGS).image for s in (1e-5, -1e-5))
        np.testing.assert_allclose(derivative, (ahead - behind) / 2e-5, atol=1e-7)
    # Of a scene without a film too.
    gain = picture_derivatives(scene, ["film.gain.g"], SETTINGS)
    np.testing.assert_allclose(gain.values[0][1], gain.image[1], atol=1e-12)
    assert not np.any(np.asarray(gain.values)[0, [0, 2]])


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("film.gain.r", 0.0, "gain must be greater than 0"),
        ("film.blur", -0.1, "blur must be 0 or greater"),
        ("film.vignetting", 1.0, "vignetting must be -1 or greater and less than 1"),
        ("film.shift.x", 1.0, "unknown attribute 'shift'"),
    ],
)
def test_what_no_film_can_do_is_refused(name, value, words):
    with pytest.raises(ParameterError, match=words):
        set_parameters(assignment_scene(), {name: value})
