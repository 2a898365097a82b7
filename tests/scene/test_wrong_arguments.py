"""Arguments of a wrong shape or type: each public function says what came and what is wanted."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import raytrace_jax as package
from raytrace_jax import (
    ParameterError,
    RaytraceError,
    RenderSettings,
    SettingsError,
    make_residual,
    optics,
    parse_scene,
    set_parameters,
)

SCENE = parse_scene("""settings main { model physical max_bounces 2 }
camera eye { pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
material crown { transmission 1 ior 1.5 }
sphere ball { material crown center 0.12 -0.07 0.15 radius 1 }
""")


@pytest.fixture(autouse=True)
def as_users_call_it():
    """The tests' own check of types, which users do not have, is off."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


PICTURE = np.linspace(0, 1, 3 * 6 * 8).reshape(3, 6, 8)
SCALAR = [name for name in dir(optics) if name.islower() and hasattr(getattr(optics, name), "__wrapped__")]
SCALAR = [name for name in SCALAR if name not in ("reflect", "refract")]
OFTEN = ["snell_angle", "slab_shift", "prism_deviation", "sphere_deviation", "lens_focal_length"]
OFTEN += ["fresnel_amplitudes", "fresnel_dielectric", "fresnel_schlick"]


def test_every_formula_is_checked():
    assert len(SCALAR) == 15 and set(OFTEN) < set(SCALAR)


@pytest.mark.parametrize("name", SCALAR)
@pytest.mark.parametrize("value", ["a", None, 1j, object(), [[1.0], [1.0, 2.0]]])
def test_what_is_no_real_number(name, value):
    more = {"prism_deviation": 2, "slab_shift": 2, "lensmaker_focal_length": 2, "prism_index": 1}
    rest = (more | {"prism_least_deviation": 1}).get(name, int(name in OFTEN))
    with pytest.raises(SettingsError, match=r"^\w+ is (no array of numbers|an array of the dtype)"):
        getattr(optics, name)(value, *[0.5] * rest)


@pytest.mark.parametrize("name", OFTEN)
def test_shapes_that_do_not_fit(name):
    function = getattr(optics, name)
    rest = [np.full(3, 0.5)] * (2 if name in ("prism_deviation", "slab_shift") else 1)
    for run in (function, jax.jit(function)):
        with pytest.raises(SettingsError, match=r"has \(2,\), \w+ has \(3,\)"):
            run(np.full(2, 0.5), *rest)


ROWS, ONE = jnp.full((3, 4), 0.5), jnp.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("d", "n", "words"),
    [
        (ROWS.T, ROWS.T, r"d has the shape \(4, 3\)"),
        (ROWS, ONE, r"n has the shape \(3,\)"),
        (1.0, 1.0, r"d has the shape \(\)"),
        (ROWS, ROWS[:, :2], r"d has \(3, 4\), n has \(3, 2\)"),
        (ROWS + 0j, ROWS, "d is an array of the dtype complex"),
        ("a", ROWS, "d is an array of the dtype <U1"),
    ],
)
def test_directions_of_another_shape(d, n, words):
    for call in (lambda: optics.reflect(d, n), lambda: optics.refract(d, n, jnp.asarray(1.5))):
        with pytest.raises(SettingsError, match=words):
            call()


def test_lists_are_rows_of_numbers():
    """A ray at 45 degrees is mirrored, and follows Snell's law by the textbook's angle, 28.126 degrees in 1.5."""
    np.testing.assert_allclose(optics.reflect([1, -1, 0], [0, 1, 0]), [1, 1, 0])
    root = 0.5**0.5
    bent, _, _ = optics.refract([root, -root, 0], [0, 1, 0], 1.5)
    np.testing.assert_allclose(np.degrees(np.arcsin(float(bent[0]))), 28.1255, atol=1e-3)
    np.testing.assert_allclose(optics.snell_angle([0.0, np.pi / 2], [1.5, 1.5]), [0, np.arcsin(1 / 1.5)], rtol=1e-6)


def test_derivatives_go_through_the_checks():
    slope = jax.jit(jax.vmap(jax.grad(optics.snell_angle)))(jnp.array([0.1, 0.2]), jnp.array([1.5, 1.5]))
    np.testing.assert_allclose(slope, np.cos([0.1, 0.2]) / np.sqrt(2.25 - np.sin([0.1, 0.2]) ** 2), rtol=1e-5)


@pytest.mark.parametrize("names", [None, 3, PICTURE, np.array(1.0), "crown.ior"])
def test_what_is_no_row_of_names(names):
    for call in (lambda: make_residual(SCENE, PICTURE, names), lambda: package.picture_derivatives(SCENE, names)):
        with pytest.raises(ParameterError, match="a list of names is wanted, and this is"):
            call()


@pytest.mark.parametrize("values", [None, 3, PICTURE, "crown.ior", ("crown.ior",)])
def test_values_without_names(values):
    with pytest.raises(ParameterError, match="values by the names of parameters are wanted"):
        set_parameters(SCENE, values)


@pytest.mark.parametrize("rays", [-1, 0, np.nan, np.inf, "a", PICTURE])
def test_a_ray_budget_that_makes_no_sense(rays):
    with pytest.raises(SettingsError, match=r"(?s)rays_per_pixel is .*; wanted a number from 1 to less than"):
        RenderSettings(rays_per_pixel=rays)


@pytest.mark.parametrize("name", [3, None, [], PICTURE])
def test_what_is_no_name_of_a_file(name):
    calls = [getattr(package, read) for read in ("load_scene", "read_exr", "read_picture", "read_mask", "jpeg_storage")]
    calls += [lambda path: package.write_exr(path, PICTURE), lambda path: package.write_png(path, PICTURE)]
    for call in calls:
        with pytest.raises(RaytraceError, match="the name of a file is wanted, and this is of the type"):
            call(name)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda path: package.write_film(path, PICTURE, SCENE), "a Film is wanted, as render returns it"),
        (lambda path: package.write_derivatives(path, PICTURE, SCENE), "a PictureDerivatives is wanted"),
        (lambda path: package.write_exr(path, [[1, 2], [3]]), r"\(3, height, width\) or channels by their names"),
        (lambda path: package.write_exr(path, {1: PICTURE[0]}), "1 is not a channel name"),
        (lambda path: package.write_png(path, {1: PICTURE[0]}), "the channels R, G and B are wanted, not 1"),
        (lambda path: package.fit(SCENE, PICTURE, ["crown.ior"], storage=3), "a JpegStorage is wanted"),
        (lambda path: make_residual(SCENE, PICTURE, ["crown.ior"], ties=PICTURE), "ties is array"),
        (lambda path: parse_scene(3), "the text of a scene is wanted"),
    ],
)
def test_results_of_another_kind(tmp_path, call, words):
    with pytest.raises(RaytraceError, match=words):
        call(tmp_path / "file")
