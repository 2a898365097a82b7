"""What a fit starts from: the target and its weights, what is free, what is tied to it and what is stated."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import FitOptions, ParameterError, PictureError, load_scene, set_parameters
from raytrace_jax.inverse.build_problem import asked_for
from raytrace_jax.inverse.problem.fixed import root_covariance, stated_uncertainties
from raytrace_jax.inverse.problem.observation import observe
from raytrace_jax.inverse.problem.unknowns import Transform, Unknowns, make_prior, make_unknowns, natural_scale, spelled
from raytrace_jax.scene.parameters import with_response

SIZE = (7, 5)
HEIGHT, WIDTH = SIZE[::-1]
SETTINGS = resolved(size=SIZE)
TARGET = np.random.default_rng(0).uniform(size=(3, HEIGHT, WIDTH))
HOLE = np.ones((HEIGHT, WIDTH))
HOLE[1:3, 2:4] = 0
"""A mask that leaves four pixels out."""


def seen(target=TARGET, weights=None, scene=None, settings=SETTINGS):
    return observe(target, weights, scene or assignment_scene(), settings)


def test_the_residual_is_image_minus_target():
    image, bias = np.random.default_rng(2).uniform(size=(2, *TARGET.shape))
    observation = dataclasses.replace(seen(weights=HOLE), bias=jnp.asarray(bias))
    np.testing.assert_allclose(observation.residual(jnp.asarray(image)), (image + bias - TARGET) * HOLE, atol=1e-15)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_target_has_the_scenes_dtype(dtype):
    observation = seen(TARGET.astype(np.float16), HOLE.astype(int), assignment_scene(dtype))
    assert observation.target.dtype == observation.root_weight.dtype == dtype


def of_channels(weights):
    """The weights of pixels as those of their three channels."""
    return np.broadcast_to(weights, TARGET.shape)


def test_each_channel_has_its_weight():
    weights = np.random.default_rng(1).uniform(0, 4, (3, HEIGHT, WIDTH))
    weights[2] = 0
    observation = seen(with_value(np.nan, (2, 1, 3)), weights)
    np.testing.assert_allclose(observation.root_weight**2, weights)
    assert observation.count == 2 * HEIGHT * WIDTH and observation.counts.all()
    np.testing.assert_allclose(observation.residual(np.zeros_like(TARGET)), -TARGET * np.sqrt(weights))
    np.testing.assert_allclose(seen(weights=weights[0]).root_weight ** 2, of_channels(weights[0]))


def test_a_mosaic_is_seen_in_large_pixels():
    """Each pixel has one channel, as of a sensor: a large pixel is the mean of the numbers that there are."""
    mosaic = np.zeros((3, 4, 6))
    mosaic[0, ::2, ::2] = mosaic[1, ::2, 1::2] = mosaic[1, 1::2, ::2] = mosaic[2, 1::2, 1::2] = 1
    colour = np.array([0.2, 0.5, 0.8])[:, None, None]
    target = np.where(mosaic > 0, colour * (1 + np.arange(6) // 2), np.nan)
    large = seen(target, mosaic, settings=resolved(size=(6, 4))).binned(2)
    np.testing.assert_allclose(large.target, np.broadcast_to(colour * [1, 2, 3], (3, 2, 3)))
    np.testing.assert_allclose(large.root_weight**2, np.broadcast_to([[[0.25]], [[0.5]], [[0.25]]], (3, 2, 3)))


def test_masked_pixels_are_zero():
    target = np.where(HOLE > 0, TARGET, np.nan)
    target[:, 1, 2] = np.inf
    observation = seen(target, HOLE)
    np.testing.assert_array_equal(observation.target, np.where(HOLE > 0, TARGET, 0))
    assert observation.count == 3 * (HEIGHT * WIDTH - 4)


def test_the_size_is_that_of_the_window():
    cropped = resolved(size=(20, 20), crop=(3, 2, *SIZE))
    assert seen(settings=cropped).target.shape == TARGET.shape
    assert seen(settings=resolved(size=(2 * WIDTH + 1, 2 * HEIGHT), binning=2)).target.shape == TARGET.shape


def with_value(value, *places, of=TARGET):
    changed = of.copy()
    for place in places:
        changed[place] = value
    return changed


def masked(values, *places):
    """An array of `numpy.ma` with junk under its mask."""
    hidden = with_value(True, *places, of=np.zeros(values.shape, bool))
    return np.ma.array(np.where(hidden, 5, values), mask=hidden)


GREY = np.full_like(TARGET, 0.25)


@pytest.mark.parametrize(
    ("target", "weights", "words"),
    [
        (TARGET[:, :-1], None, "the target is 7 x 4 pixels, the scene renders 7 x 5; set the size"),
        (np.moveaxis(TARGET, 0, -1), None, r"shape \(5, 7, 3\); wanted \(3, 5, 7\)"),
        (with_value(np.nan, (0, 0, 0), (2, 4, 6)), None, "2 values that are NaN or infinite"),
        (with_value(np.inf, (1, 1, 2), (1, 0, 0)), HOLE, "1 values that are NaN or infinite"),
        (GREY, None, "one constant colour; there is nothing"),
        (with_value(1.0, (0, 1, 2), of=GREY), HOLE, "one constant colour, as far as the mask shows it"),
        (TARGET, HOLE[:-1], "the mask is 7 x 4 pixels, the target 7 x 5"),
        (TARGET, HOLE.T, "the mask is 5 x 7 pixels, the target 7 x 5"),
        (TARGET, np.ones((HEIGHT, WIDTH, 3)), r"the mask has shape \(5, 7, 3\); wanted \(5, 7\) or \(3, 5, 7\)"),
        (TARGET, np.ones((2, HEIGHT, WIDTH)), r"the mask has shape \(2, 5, 7\)"),
        (TARGET, np.ones(HEIGHT * WIDTH), r"the mask has shape \(35,\)"),
        (TARGET, 1.0, r"the mask has shape \(\)"),
        (TARGET, with_value(-1.0, (0, 0), (3, 3), of=HOLE), "2 values that are negative, NaN or infinite"),
        (TARGET, with_value(np.inf, (0, 0), of=HOLE), "1 values that are negative, NaN or infinite"),
        (TARGET, 0 * HOLE, "the mask is 0 everywhere"),
        (masked(TARGET, ...), None, "no pixel of the target is there"),
        (masked(with_value(1.0, (0, 1, 2), of=GREY), (0, 1, 2)), None, "one constant colour, as far as the mask"),
        (TARGET.astype(object), None, "the target is an array of the dtype object, and real numbers are wanted"),
        (TARGET.astype(str), None, "the target is an array of the dtype <U"),
        (TARGET.astype(complex), None, "the target is an array of the dtype complex128"),
        ([TARGET[0], TARGET[1, :2]], None, "the target is no array of numbers, but a list"),
        (TARGET, HOLE.astype(object), "the mask is an array of the dtype object"),
    ],
)
def test_what_makes_no_sense_is_refused(target, weights, words):
    with pytest.raises(PictureError, match=words):
        seen(target, weights)


@pytest.mark.parametrize("mask_out", [lambda values: values, list], ids=["whole", "channels"])
def test_pixels_masked_by_numpy_do_not_count(mask_out):
    target, weights = masked(TARGET, (0, 1, 2), (2, 3, 4)), with_value(np.nan, (0, 0), of=np.full(HOLE.shape, 2.0))
    wanted = with_value(0.0, (1, 2), (3, 4), of=np.ones_like(HOLE))
    np.testing.assert_array_equal(seen(mask_out(target)).root_weight, of_channels(wanted))
    found = seen(mask_out(target), np.ma.masked_invalid(weights))
    np.testing.assert_allclose(found.root_weight**2, of_channels(with_value(0.0, (0, 0), of=2 * wanted)))
    np.testing.assert_array_equal(found.target, np.where(found.root_weight > 0, TARGET, 0))
    three = masked(np.ones(TARGET.shape, int), (1, 1, 2), (1, 3, 4))
    np.testing.assert_array_equal(seen(TARGET, three).root_weight, of_channels(wanted))


def test_a_nearly_constant_target_is_taken():
    seen(with_value(0.26, (2, 4, 6), of=GREY))


def test_a_large_pixel_is_a_mean_or_masked():
    weights = with_value(3.0, (0, 0), of=HOLE)
    large = seen(weights=weights).binned(2)
    assert large.target.shape == (3, 2, 3)  # What does not fill a pixel is left out.
    np.testing.assert_allclose(large.target[:, 0, 0], TARGET[:, :2, :2].mean((1, 2)))
    np.testing.assert_allclose(np.asarray(large.root_weight[0]) ** 2, [[1.5, 0, 1], [1, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(large.target[:, 1, 2], TARGET[:, 2:4, 4:6].mean((1, 2)))
    assert large.count == 3 * 4
    bias = np.random.default_rng(2).uniform(size=TARGET.shape)
    large = dataclasses.replace(seen(weights=weights), bias=jnp.asarray(bias)).binned(2)
    np.testing.assert_allclose(large.bias, bias[:, :4, :6].reshape(3, 2, 2, 3, 2).mean((2, 4)))


def test_a_vector_is_free_in_all_its_numbers():
    unknowns = make_unknowns(assignment_scene(), ["vitreous.center", "cyan.ior"])
    assert unknowns.names == ("vitreous.center.x", "vitreous.center.y", "vitreous.center.z", "cyan.ior")
    assert unknowns.transforms == (Transform(), Transform(), Transform(), Transform(1.0))
    np.testing.assert_allclose(unknowns.initial(assignment_scene()), [4.3, 2.3, -1, 1.337])


def test_the_scene_has_values_and_ties():
    unknowns = make_unknowns(
        assignment_scene(),
        ["vitreous.center", "vitreous.radius"],
        {"central.center": "vitreous.center", "upperright.radius": "vitreous.radius"},
    )
    assert unknowns.ties == (
        *((f"central.center.{axis}", f"vitreous.center.{axis}") for axis in "xyz"),
        ("upperright.radius", "vitreous.radius"),
    )
    scene = unknowns.scene(assignment_scene(), np.array([1.0, 2.0, -3.0, 0.7]))
    for name, expected in {
        "vitreous.center": [1, 2, -3],
        "central.center": [1, 2, -3],
        "vitreous.radius": 0.7,
        "upperright.radius": 0.7,
        "central.radius": 1.3,
    }.items():
        np.testing.assert_array_equal(scene[name], expected)


@pytest.mark.parametrize(
    ("free", "ties", "words"),
    [
        ([], {}, "nothing to fit"),
        (["vitreous.center"], {"central.center": "vitreous.radius"}, "central.center has 3 numbers, .* has 1"),
        (["vitreous.ior"], {"red.ior": "blue.ior"}, "blue.ior: it is not free; free are vitreous.ior"),
        (["vitreous.ior"], {"cyan.ior": "vitreous.ior"}, "both give the number"),
        (
            ["vitreous.center"],
            {"central.center": "vitreous.center", "central.center.x": "vitreous.center.y"},
            "given twice|both give",
        ),
    ],
)
def test_senseless_names_are_refused(free, ties, words):
    with pytest.raises(ParameterError, match=words):
        make_unknowns(assignment_scene(), free, ties)


def test_exposure_begins_at_no_change():
    scene, free, ties = asked_for(assignment_scene(), ["vitreous.ior"], FitOptions(fit_exposure=True))
    unknowns = make_unknowns(scene, free, ties)
    assert unknowns.names == ("vitreous.ior", "film.gain.r", "film.offset.r")
    np.testing.assert_allclose(unknowns.initial(scene), [1.337, 1, 0])
    moved = unknowns.scene(scene, np.array([1.5, 2.0, 0.1]))
    assert float(moved["vitreous.ior"]) == 1.5
    np.testing.assert_allclose(moved["film.gain"], 2)
    np.testing.assert_allclose(moved["film.offset"], 0.1)
    assert float(unknowns.values(jnp.asarray([0.0, -30.0, -5.0]))[1]) > 0  # A gain is positive.
    assert unknowns.traced_unknowns.names == ("vitreous.ior",) and unknowns.traced_unknowns.ties == ()


def test_film_and_scene_cannot_be_tied():
    scene, free, _ = asked_for(assignment_scene(), ["vitreous.ior", "film.blur"], FitOptions())
    with pytest.raises(ParameterError, match="one is the film's"):
        make_unknowns(scene, free, {"film.gamma": "vitreous.ior"})


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("vitreous.ior", 0.337),
        ("vitreous.center.x", 2.3),
        ("vitreous.radius", 2.3),
        ("vitreous.alpha", 0.4),
        ("green.ambient.r", 0.1),  # 0 has no size of its own
        ("topright.location.x", np.sqrt(36 + 16 + 1)),
        ("leftwall.point.x", 1),
        ("film.gain.r", 1),
        ("film.offset.r", 0.1),
        ("blue.ior", 0.25),  # An index counts from 1.
        ("red.ior", 0.1),
    ],
)
def test_natural_scales(name, expected):
    scene = set_parameters(assignment_scene(), {"blue.ior": 0.75, "red.ior": 1.0})
    assert natural_scale(with_response(scene, [name]), name) == pytest.approx(expected)


NAMES = Unknowns(("ball.ior", "ball.radius"), (Transform(1.0), Transform(0.0)))


def test_a_prior_stands_at_its_parameter():
    prior = make_prior({"ball.radius": (2.0, 0.25)}, NAMES, jnp.dtype(jnp.float32))
    np.testing.assert_array_equal(prior.precision, [0, 4])
    assert prior.mean[1] == 2 and prior.mean.dtype == jnp.float32
    np.testing.assert_array_equal(make_prior({}, NAMES, jnp.dtype(jnp.float64)).precision, 0)


@pytest.mark.parametrize(
    ("priors", "words"),
    [
        ({"ball.ior": (1.0, 0.0)}, "prior on ball.ior: 1+-0; wanted a finite mean and a standard deviation above 0"),
        ({"ball.ior": (1.0, np.inf)}, "1+-inf"),
        ({"ball.ior": (np.nan, 1.0)}, "nan+-1"),
    ],
)
def test_senseless_priors_are_refused(priors, words):
    with pytest.raises(ParameterError, match=re.escape(words)):
        make_prior(priors, NAMES, jnp.dtype(jnp.float64))


def test_a_number_is_known_by_all_its_names():
    scene, names = assignment_scene(), ("cyan.ior", "vitreous.center.x")
    assert spelled(scene, names, "vitreous.ior", "prior") == "cyan.ior"
    assert spelled(scene, names, "vitreous.center.x", "prior") == "vitreous.center.x"
    for name, words in (("red.ior", "not free"), ("vitreous.center", "several numbers"), ("vitreous.iro", "ior")):
        with pytest.raises(ParameterError, match=words):
            spelled(scene, names, name, "prior")


SCENE = load_scene(Path(__file__).parents[2] / "data" / "vitreous.txt")
FREE = make_unknowns(SCENE, ["vitreous.ior", "vitreous.center"])


def stated(**uncertain):
    return stated_uncertainties(SCENE, FREE, {name.replace("__", "."): amount for name, amount in uncertain.items()})


def test_a_number_a_share_of_it_and_a_vector():
    assert stated(vitreous__radius=0.002) == {"vitreous.radius": 0.002}
    assert stated(vitreous__radius="0.1%") == {"vitreous.radius": pytest.approx(0.0023)}
    assert stated(vitreous__radius="0.1 %") == stated(vitreous__radius="0.1%")
    length = float(np.linalg.norm([6, 4, 1]))
    expected = {f"topright.location.{letter}": pytest.approx(0.01 * length, rel=1e-6) for letter in "xyz"}
    assert stated(topright__location="1%") == expected
    assert stated(vitreous__alpha=0.01) == {"cyan.alpha": 0.01}, "by its canonical name"


def test_blocks_name_their_fixed_numbers():
    of_plane = {f"cam1.{what}.{x}" for what in ("worlddim", "center") for x in "xy"}
    assert set(stated(cam1=0.1)) == of_plane | {f"cam1.viewpoint.{x}" for x in "xyz"}
    assert {name.partition(".")[0] for name in stated(lights="1%")} == {"centerback", "backleft", "topright"}
    assert set(stated(vitreous=0.1)) == {"vitreous.radius"}, "its center is free"


def test_what_is_said_of_fewer_numbers_holds():
    found = stated(cam1=0.1, cam1__viewpoint__z=0.5)
    assert found["cam1.viewpoint.z"] == 0.5 and found["cam1.viewpoint.x"] == 0.1
    assert stated(cam1__viewpoint__z=0.5, cam1=0.1) == found


@pytest.mark.parametrize(
    ("uncertain", "message"),
    [
        ({"vitreous.ior": 0.1}, "uncertain vitreous.ior: vitreous.ior is free; .* prior"),
        ({"vitreous.radius": 0.0}, "wanted a standard deviation above 0 .* share as 0.1%"),
        ({"vitreous.radius": "much"}, "uncertain vitreous.radius=much"),
        ({"vitreous.radios": 1.0}, "radios.*Did you mean 'radius'"),
        (
            {"lamps": 1.0},
            "neither a number, as .* nor a block nor a kind of blocks. Blocks are .*cam1.*kinds are .*lights",
        ),
        ({"green.alpha": "1%"}, "it is 0, of which a share is nothing"),
    ],
)
def test_what_cannot_be_stated_is_refused(uncertain, message):
    with pytest.raises(ParameterError, match=message):
        stated_uncertainties(SCENE, FREE, uncertain)


def test_a_covariance_root_gives_it_back():
    names, spread = ("a.x", "a.y", "b"), np.array([0.1, 2.0, 3e-4])
    correlations = {("a.x", "a.y"): 0.9, ("b", "a.x"): -0.5}
    matrix = np.array([[1, 0.9, -0.5], [0.9, 1, 0], [-0.5, 0, 1]])
    matrix[1, 2] = matrix[2, 1] = -0.3
    root = root_covariance(names, spread, correlations | {("a.y", "b"): -0.3})
    np.testing.assert_allclose(root.T @ root, matrix * np.outer(spread, spread), rtol=1e-12)
    alone = root_covariance(names, spread, {})
    np.testing.assert_allclose(alone.T @ alone, np.diag(spread**2), atol=1e-18)
    # Two numbers that are one, as far as six digits tell.
    one = root_covariance(("a", "b"), np.ones(2), {("a", "b"): 1 + 5e-7})
    np.testing.assert_allclose(one.T @ one, 1, atol=1e-6)


@pytest.mark.parametrize(
    ("correlations", "words"),
    [
        ({("a", "c"): 0.1}, "'c' is not stated to be uncertain; there are a, b"),
        ({("a", "b"): 1.5}, "from -1 to 1"),
        pytest.param({("a", "b"): np.nan}, "correlations: ", id="nan"),
    ],
)
def test_impossible_correlations_are_refused(correlations, words):
    with pytest.raises(ParameterError, match=words):
        root_covariance(("a", "b"), np.ones(2), correlations)
