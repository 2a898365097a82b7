"""One scene and several pictures: what the views tell together, alone, and where one of them does not fit in."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from linear_fit import LinearScene, differentiate, linear_names, points_of
from PIL import Image
from scipy import ndimage

from raytrace_jax import (
    FitOptions,
    ParameterError,
    PictureError,
    RenderSettings,
    covariance,
    fit,
    load_scene,
    make_residual,
    parse_scene,
    render,
    set_parameters,
)
from raytrace_jax.images.jpeg import jpeg_storage
from raytrace_jax.inverse.problem.prediction import ForwardModel, forward_model
from raytrace_jax.scene.scene import Scene

SIZES = {"left": (24, 32), "right": (36, 48)}
"""Rows and columns of each view."""
NAMES = linear_names(2)
TRUTH = np.array([0.3, -0.2])
"""Of a and b; c is 1 and not free."""
SIGMA = 0.02
POINT = RenderSettings(max_bounces=0, edges="point")


class LinearViews(Scene):
    """Spheres whose centers' x are the parameters: each view's picture is the sum of them times its own columns."""

    columns: dict[str, Float[Array, "parameters 3 _ _"]] = dataclasses.field(kw_only=True)


def of_view(program):
    """The program of linear pictures for the view that is rendered; scenes may be stacked."""

    def run(*arguments):
        arguments = [only_view(each) if isinstance(each, LinearViews) else each for each in arguments]
        return program(*arguments)

    return run


def only_view(scene):
    blocks = {name: value for name, value in vars(scene).items() if name != "columns"}
    return LinearScene(**blocks, columns=scene.columns[scene.camera.name])


@forward_model.register
def _(scene: LinearViews):
    return ForwardModel(of_view(differentiate), of_view(points_of))


def smooth(seed, size):
    """Derivatives of a picture, whose neighbours go together."""
    columns = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(3, 3, *size)), (0, 0, 2, 2))
    return columns / columns.std(axis=(1, 2, 3), keepdims=True)


COLUMNS = {name: smooth(k, size) for k, (name, size) in enumerate(SIZES.items())}


def linear_views(columns):
    text = "material glass { alpha 1 }\n"
    for name, part in columns.items():
        height, width = part.shape[2:]
        text += f"camera {name} {{ pixeldim {width} {height} worlddim 8 6 viewpoint 4 3 6 }}\n"
    for name, x in zip("abc", (0, 0, 1), strict=True):
        text += f"sphere {name} {{ material glass center {x} 0 0 radius 1 }}\n"
    plain = parse_scene(text, dtype=jnp.float64)
    return LinearViews(**vars(plain), columns={name: jnp.asarray(part) for name, part in columns.items()})


def clean(columns, values):
    return np.tensordot([*values, 1], columns, 1)


def noisy(columns, values, sigma=SIGMA, seed=0):
    """A picture at such values with independent noise."""
    noise = np.random.default_rng([7, seed]).normal(size=columns.shape[1:])
    return clean(columns, values) + sigma * noise


SCENE = linear_views(COLUMNS)
PICTURES = {name: noisy(part, TRUTH, seed=k) for k, (name, part) in enumerate(COLUMNS.items())}


def fitted(pictures=PICTURES, scene=SCENE, free=NAMES, weights=None, storage=None, on_phase=None, **options):
    """The fit of linear pictures, of which there is one minimum."""
    nearby = {"search": False, "edges": "point", "target_sampling": "point", "loss": "l2", "blur": [0.0], **options}
    given = {"weights": weights, "storage": storage, "on_phase": on_phase}
    return fit(scene, pictures, list(free), POINT, options=FitOptions(**nearby), **given)


def alone(camera, **options):
    """The fit of one view alone."""
    return fitted(PICTURES[camera], SCENE.seen_by(camera).alone(), **options)


def information(columns, sigma=SIGMA):
    rows = columns[:2].reshape(2, -1)
    return rows @ rows.T / sigma**2


@pytest.fixture(scope="module")
def both():
    return fitted()


@pytest.fixture(scope="module")
def each():
    return {camera: alone(camera) for camera in SIZES}


def test_two_views_tell_more_than_each(both, each):
    assert both.status == "converged", both.message
    assert np.all(np.abs(both.value - TRUTH) < 4 * both.standard_error)
    for view in both.alone:
        one = each[view.camera]
        assert np.all(both.standard_error < one.standard_error)
        # In a linear model what one view tells alone is its own fit.
        np.testing.assert_allclose(view.value, one.value, rtol=1e-6)
        np.testing.assert_allclose(view.standard_error, one.standard_error, rtol=0.02)


def test_the_views_information_adds(both):
    wanted = sum(information(part) for part in COLUMNS.values())
    np.testing.assert_allclose(np.linalg.inv(both.uncertainty.covariance), wanted, rtol=0.15, atol=0.02 * wanted.max())


def test_each_view_has_its_pictures(both):
    for camera, view in both.views.items():
        assert view.scene.camera.name == camera
        assert view.image.shape == view.start_image.shape == view.weights.shape == (3, *SIZES[camera])
        np.testing.assert_array_equal(view.target, PICTURES[camera])
        np.testing.assert_allclose(view.image, clean(COLUMNS[camera], both.value), atol=1e-12)
        assert view.rms_residual == pytest.approx(SIGMA, rel=0.05)
        np.testing.assert_array_equal(view.value, both.value)


def test_covariance_of_a_loop_is_that_of_the_fit(both):
    problem = make_residual(SCENE, PICTURES, NAMES, POINT)
    unknowns = problem.unknowns.unknowns(both.value)
    np.testing.assert_allclose(covariance(problem, unknowns).covariance, both.uncertainty.covariance, rtol=0.01)


def test_a_noisy_view_counts_less(each):
    pictures = PICTURES | {"right": noisy(COLUMNS["right"], TRUTH, 10 * SIGMA)}
    found = fitted(pictures)
    assert found.status == "converged", found.message
    wanted = np.linalg.inv(information(COLUMNS["left"]) + information(COLUMNS["right"], 10 * SIGMA))
    np.testing.assert_allclose(found.standard_error, np.sqrt(np.diag(wanted)), rtol=0.1)
    assert np.all(np.abs(found.value - each["left"].value) < each["left"].standard_error)


def test_weights_are_a_views_own(each):
    """Without a quarter of its pixels, as without them in the picture."""
    weights = np.ones(SIZES["right"])
    weights[:, 24:] = 0
    spoilt = PICTURES["right"] + np.where(weights, 0, 5.0)
    found = fitted(PICTURES | {"right": spoilt}, weights={"right": weights})
    assert found.status == "converged", found.message
    seen = COLUMNS["right"][..., :24]
    wanted = information(COLUMNS["left"]) + information(seen)
    np.testing.assert_allclose(found.standard_error, np.sqrt(np.diag(np.linalg.inv(wanted))), rtol=0.1)
    np.testing.assert_array_equal(found.views["left"].weights > 0, True)


def test_a_prior_counts_once():
    tight = {NAMES[0]: (0.3, 2e-4)}
    found = fitted(priors=tight)
    wanted = sum(information(part) for part in COLUMNS.values()) + np.diag([2e-4**-2, 0])
    np.testing.assert_allclose(found.standard_error, np.sqrt(np.diag(np.linalg.inv(wanted))), rtol=0.1)


def test_exposure_is_a_views_own():
    gains, offsets = {"left": 1.2, "right": 0.8}, {"left": 0.1, "right": -0.05}
    pictures = {name: gains[name] * each + offsets[name] for name, each in PICTURES.items()}
    found = fitted(pictures, fit_exposure=True)
    assert found.status == "converged", found.message
    for name in SIZES:
        for number, wanted in (("gain", gains[name]), ("offset", offsets[name])):
            estimate = found[f"{name}.{number}.r"]
            assert abs(estimate.value - wanted) < 4 * estimate.error < 0.02


def test_a_view_that_contradicts_is_named():
    found = fitted(PICTURES | {"right": noisy(COLUMNS["right"], TRUTH + np.array([0.01, 0.015]))})
    assert found.status == "model_incomplete"
    assert "the view right contradicts the others: b.center.x is -0.185" in found.message


def test_a_view_that_sees_nothing_free(each):
    """It shows something, but nothing of what is free."""
    blind = COLUMNS | {"right": COLUMNS["right"] * np.array([0, 0, 1]).reshape(3, 1, 1, 1)}
    found = fitted(PICTURES | {"right": noisy(blind["right"], TRUTH)}, linear_views(blind))
    np.testing.assert_allclose(found.value, each["left"].value, rtol=1e-5)
    np.testing.assert_allclose(found.standard_error, each["left"].standard_error, rtol=0.02)
    by_camera = {view.camera: view for view in found.alone}
    assert np.all(np.isinf(by_camera["right"].standard_error))
    assert found.status == "converged", found.message


def test_a_target_that_no_view_explains_names_no_cause():
    found = fitted({name: noisy(0 * part, TRUTH) for name, part in COLUMNS.items()}, max_steps=3)
    assert found.status == "not_converged"
    assert "looks like none" not in found.message
    # An error bar there would be one of another answer.
    assert np.all(np.isnan(found.total_error)) and np.all(np.isnan(found.uncertainty.cramer_rao))
    assert "(" not in found.summary().partition("not_converged")[0] and "error unknown" in repr(found)


def test_an_interrupted_fit_has_no_pictures():
    def stop(words):
        raise KeyboardInterrupt

    found = fitted(on_phase=stop)
    assert found.status == "interrupted"
    for camera, view in found.views.items():
        assert view.image is None
        assert view.target.shape == (3, *SIZES[camera])


LEFT, RIGHT = PICTURES["left"], PICTURES["right"]


@pytest.mark.parametrize(
    ("error", "words", "given"),
    [
        (ParameterError, r"no picture of the camera right: give one", {"pictures": {"left": LEFT}}),
        (ParameterError, r"rigth.*Did you mean 'right'", {"pictures": {"left": LEFT, "right": RIGHT, "rigth": RIGHT}}),
        (ParameterError, r'cameras left, right: a picture of each is wanted, as \{"left"', {"pictures": LEFT}),
        (PictureError, r"right.*target is 32 x 24 pixels.*48 x 36", {"pictures": {"left": LEFT, "right": LEFT}}),
        (PictureError, r"right.*mask is 0 everywhere", {"weights": {"right": np.zeros(SIZES["right"])}}),
        (PictureError, r"left.*mask is 48 x 36 pixels", {"weights": np.ones(SIZES["right"])}),
        (ParameterError, r"weights of 'rigth'", {"weights": {"rigth": np.ones(SIZES["right"])}}),
        (ParameterError, r"storage of 'middle'", {"storage": {"middle": None}}),
        (ParameterError, r"left.gian", {"free": [*NAMES, "left.gian.r"]}),
        (ParameterError, r"right.gain.r", {"priors": {"right.gain.r": (1.0, 0.1)}}),
    ],
)
def test_what_makes_no_sense_is_refused(error, words, given):
    with pytest.raises(error, match=words):
        fitted(**given)


def test_settings_may_be_of_some_views():
    options = FitOptions(search=False, edges="point", target_sampling="point", loss="l2", blur=[0.0])
    found = fit(SCENE, PICTURES, list(NAMES), {"left": POINT}, options=options)
    assert found.views["left"].settings.max_bounces == 0
    with pytest.raises(ParameterError, match="settings of 'middle'"):
        fit(SCENE, PICTURES, list(NAMES), {"middle": POINT}, options=options)
    with pytest.raises(ParameterError, match="a scene of 'middle'"):
        fit(SCENE, PICTURES, list(NAMES), options=options, shown={"middle": SCENE})


def test_a_jpeg_is_a_views_own(tmp_path):
    """What its blocks change is no noise of the other view, and its residuals go together in blocks of its own."""
    Image.fromarray(np.zeros((*SIZES["right"], 3), np.uint8)).save(tmp_path / "a.jpg", quality=90, subsampling=0)
    storage = jpeg_storage(tmp_path / "a.jpg")
    columns = {name: 0.05 * part for name, part in COLUMNS.items()}
    columns = {name: part + np.array([0, 0, 0.4]).reshape(3, 1, 1, 1) for name, part in columns.items()}
    pictures = {name: noisy(part, TRUTH, 0.01, seed=5) for name, part in columns.items()}
    pictures["right"] = storage.compress(storage.encode(pictures["right"]))
    found = fitted(pictures, linear_views(columns), storage={"right": storage})
    assert found.status == "converged", found.message
    assert np.all(np.abs(found.value - TRUTH) < 4 * found.standard_error)


def test_time_that_is_over():
    found = fitted(max_seconds=1e-3)
    assert found.status == "interrupted"
    assert all(view.image is None for view in found.views.values())
    np.testing.assert_array_equal(found.views["right"].target, PICTURES["right"])


BALL = """
camera left { pixeldim 16 12 viewpoint -2 0 4.5 lookat 0 0 0 up 0 1 0 fov 40 }
camera right { pixeldim 20 16 viewpoint 2 0 4.5 lookat 0 0 0 up 0 1 0 fov 40 }
light lamp { location 3 4 8 emissivity 1 1 1 }
material clay { ambient 0.1 0.1 0.1 diffuse 0.7 0.6 0.5 }
sphere ball { material clay center 0 0 0 radius 1 }
"""
OF_BALL = ["ball.center.x", "ball.radius", "right.viewpoint.x"]
"""What both views see, and what is one camera's."""


@pytest.fixture(scope="module")
def loop():
    scene = parse_scene(BALL, dtype=jnp.float64)
    settings = RenderSettings(max_bounces=0, edges="point")
    random = np.random.default_rng(0)
    targets = {name: random.uniform(size=(3, *scene.seen_by(name).camera.pixeldim[::-1])) for name in scene.cameras}
    return scene, settings, targets, make_residual(scene, targets, OF_BALL, settings)


def test_a_residual_is_each_picture_minus_its_target(loop):
    scene, settings, targets, problem = loop
    found = jax.jit(lambda y: problem.residual(y))(problem.start)
    assert len(found) == 2
    for camera, residual in zip(scene.cameras, found, strict=True):
        image = render(scene.seen_by(camera).alone(), settings).image
        np.testing.assert_allclose(residual, image - targets[camera], atol=1e-12)


def test_a_residuals_derivative_has_all_views(loop):
    problem = loop[-1]

    def flat(y):
        return jnp.concatenate([part.ravel() for part in problem.residual(y)])

    y, step, of_left = problem.start + 0.01, 1e-5, 3 * 16 * 12
    at = jax.jit(flat)
    forward = jax.jit(jax.jacfwd(flat))(y)
    differences = np.stack([(at(y + step * e) - at(y - step * e)) / (2 * step) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(forward, differences, atol=1e-5)
    pull = np.random.default_rng(1).normal(size=len(forward))
    np.testing.assert_allclose(jax.jit(jax.grad(lambda y: flat(y) @ pull))(y), pull @ forward, atol=1e-10)
    # A number of one camera moves its view alone.
    assert np.all(forward[:of_left, 2] == 0)
    assert np.all(np.any(np.asarray(forward[of_left:]), axis=0))


@pytest.mark.slow
@pytest.mark.optimized
def test_two_views_of_glass_find_its_index():
    """A whole fit with its search: two views know the ball's distance three times as well as each of them."""
    scene = load_scene(Path(__file__).parents[2] / "data/two_views.txt")
    truth = set_parameters(scene, {"glass.ior": 1.5168, "glass.center": (0.12, -0.07, 0.15)})
    size, pictures = (96, 72), {}
    for seed, name in enumerate(scene.cameras):
        image = np.asarray(render(truth.seen_by(name).alone(), RenderSettings(size=size, samples=4)).image)
        pictures[name] = image + np.random.default_rng(seed).normal(size=image.shape) / 255
    found = fit(scene, pictures, ["glass.ior", "glass.center"], RenderSettings(size=size))
    assert found.status == "converged", found.message
    assert np.all(np.abs(found.value - [1.5168, 0.12, -0.07, 0.15]) < 4 * found.standard_error)
    for view in found.alone:
        assert found.standard_error[3] < view.standard_error[3] / 3
