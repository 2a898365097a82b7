"""The covariance of a loop of one's own, of one picture and of several that share unknowns."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_fit import linear_names, linear_problem
from linear_pictures import COLUMNS, ROWS, SIGMA, TEXTBOOK, TRUTH, judged, picture, white

from raytrace_jax import (
    FitOptions,
    ParameterError,
    RaytraceError,
    RenderSettings,
    covariance,
    fit,
    make_residual,
    parse_scene,
    render,
    set_parameters,
)

POINT = RenderSettings(max_bounces=0, edges="point")
NAMES = linear_names(3)
OTHER = 0.5 * COLUMNS[::-1, :, ::-1]
"""Derivatives of a second camera's picture."""


def linear_residual(columns, target, free=NAMES, **options):
    return make_residual(linear_problem(columns, target).scene, target, list(free), POINT, **options)


def estimate(columns, targets):
    """The least-squares values of several pictures; each unknown is a value here."""
    rows = [part.reshape(len(part), -1).T for part in columns]
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate([one.ravel() for one in targets]))[0]


def two_cameras(seed=0, noises=(1.0, 1.0)):
    columns = (COLUMNS, OTHER)
    targets = [
        picture(TRUTH, part) + noise * white(1000 * k + seed)
        for k, (part, noise) in enumerate(zip(columns, noises, strict=True))
    ]
    return [linear_residual(*both) for both in zip(columns, targets, strict=True)], estimate(columns, targets)


def test_one_picture_has_the_errors_of_a_fit():
    target = picture(TRUTH) + white()
    for sigma in (None, 2 * SIGMA):
        found = covariance(linear_residual(COLUMNS, target), estimate([COLUMNS], [target]), sigma=sigma)
        sure = judged(white(), sigma=sigma)
        assert found.names == NAMES
        np.testing.assert_allclose(found.standard_error, sure.standard_error, rtol=1e-6)
        np.testing.assert_allclose(found.covariance, sure.covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.standard_error, rtol=1e-12)


def test_two_pictures_add_their_information():
    problems, values = two_cameras()
    other = OTHER.reshape(3, -1).T
    wanted = SIGMA**2 * np.linalg.inv(ROWS.T @ ROWS + other.T @ other)
    for sigma in (None, SIGMA):
        found = covariance(problems, values, sigma=sigma)
        np.testing.assert_allclose(found.covariance, wanted, rtol=0.1, atol=0.02 * np.max(wanted))
        assert np.all(found.standard_error < 0.95 * TEXTBOOK)
    # A stated noise counts in both pictures.
    stated = covariance(problems, values, sigma=10 * SIGMA).covariance
    np.testing.assert_allclose(stated, 100 * wanted, rtol=0.01, atol=1e-3 * np.max(100 * wanted))


def test_twice_is_half_the_variance():
    target = picture(TRUTH) + white()
    one, values = linear_residual(COLUMNS, target), estimate([COLUMNS], [target])
    alone, twice = covariance(one, values), covariance([one, one], values)
    np.testing.assert_allclose(twice.covariance, alone.covariance / 2, rtol=1e-3)


def test_each_picture_has_its_own_noise():
    noises = 0.3, 3.0
    problems, values = two_cameras(noises=noises)
    rows = ROWS, OTHER.reshape(3, -1).T
    bread = np.linalg.inv(sum(part.T @ part for part in rows))
    meat = sum((noise * SIGMA) ** 2 * part.T @ part for noise, part in zip(noises, rows, strict=True))
    wanted = np.sqrt(np.diag(bread @ meat @ bread))
    np.testing.assert_allclose(covariance(problems, values).standard_error, wanted, rtol=0.1)


def test_a_decisive_pixel_of_one_picture():
    """It decides nothing where another picture knows the number better."""
    few = np.zeros_like(COLUMNS)
    few[:2], few[2, 0, 5, 5] = COLUMNS[:2], 1.0
    targets = picture(TRUTH) + white(), picture(TRUTH, few) + white(1)
    values = estimate((COLUMNS, few), targets)
    problems = [linear_residual(*both) for both in zip((COLUMNS, few), targets, strict=True)]
    rows = np.concatenate([ROWS, few.reshape(3, -1).T])
    wanted = SIGMA * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    np.testing.assert_allclose(covariance(problems, values).standard_error, wanted, rtol=0.05)


def test_what_no_picture_sees_is_open():
    blind = np.where(np.arange(3)[:, None, None, None] == 2, 0.0, COLUMNS)
    target = picture(TRUTH, blind) + white()
    one = linear_residual(blind, target)
    assert np.isinf(covariance([one, one], TRUTH).standard_error[2])
    # Another picture determines it.
    whole = linear_residual(COLUMNS, picture(TRUTH) + white(1))
    assert np.all(np.isfinite(covariance([one, whole], TRUTH).standard_error))


def test_the_step_that_is_left_is_an_error():
    problems, values = two_cameras()
    off = np.array([0.01, 0, 0])
    found = covariance(problems, values + off, sigma=SIGMA).covariance
    np.testing.assert_allclose(
        found - covariance(problems, values, sigma=SIGMA).covariance, np.outer(off, off), atol=3e-6
    )


def test_pulls_have_unit_variance():
    pulls = []
    for seed in range(40):
        problems, values = two_cameras(seed)
        pulls.append((values - TRUTH) / covariance(problems, values).standard_error)
    # Of 120 normal numbers, three standard deviations of their variance.
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=3 * np.sqrt(2 / 120))


def test_what_has_no_covariance_is_refused():
    target = picture(TRUTH) + white()
    one = linear_residual(COLUMNS, target)
    swapped = linear_residual(COLUMNS, target, free=NAMES[::-1])
    unit = dataclasses.replace(one.unknowns.transforms[0], unit=10.0)
    scaled = dataclasses.replace(
        one, unknowns=dataclasses.replace(one.unknowns, transforms=(unit, *one.unknowns.transforms[1:]))
    )
    for problem, y, words in (
        ([], TRUTH, "has no problem"),
        ([one, swapped], TRUTH, "problem 2 has c.center.x"),
        ([one, scaled], TRUTH, "unknown of a.center.x is in units of 1 in problem 1, and of 10"),
        (one, TRUTH[:2], r"shape \(2,\)"),
        (one, np.array(["a", "b", "c"]), "row of unknowns"),
    ):
        with pytest.raises(ParameterError, match=words):
            covariance(problem, y)
    with pytest.raises(RaytraceError, match="make_residual"):
        covariance([one, 3], TRUTH)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ParameterError, match="sigma is 0"):
        covariance(one, TRUTH, sigma=0.0)
    with pytest.raises(ParameterError, match="outside of JAX's transformations"):
        jax.jit(lambda y: covariance(one, y).covariance)(jnp.asarray(TRUTH))


BALL = """
camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 6 5 4 emissivity 1 1 1 }
material board { ambient 0.3 0.3 0.3 diffuse 0.6 0.5 0.4 }
material glass { diffuse 0.2 0.1 0.1 alpha 0.8 ior 1.4 }
plane board { material board normal 0 0 1 point 0 0 -4 }
sphere ball { material glass center 4 3 -1 radius 2 }
"""
FREE = ["ball.center", "board.diffuse.r"]
AWARE = RenderSettings(max_bounces=0, edges="aware")


@pytest.fixture(scope="module")
def ball():
    return parse_scene(BALL)


def noisy(scene, seed, sigma=0.02):
    clean = np.asarray(render(scene, AWARE).image)
    return clean + sigma * np.random.default_rng(seed).normal(size=clean.shape)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [None, 0.03])
def test_a_traced_picture_is_as_in_a_fit(ball, sigma):
    target = noisy(ball, 0)
    result = fit(ball, target, FREE, AWARE, options=FitOptions(search=False, target_sampling="aware", sigma=sigma))
    at = make_residual(result.scene, target, FREE, AWARE)
    found = covariance(at, at.start, sigma=sigma)
    np.testing.assert_allclose(found.standard_error, result.standard_error, rtol=1e-3)
    np.testing.assert_allclose(found.covariance, result.uncertainty.covariance, rtol=2e-3, atol=1e-9)


def test_bounds_are_those_of_the_values(ball):
    one = make_residual(ball, noisy(ball, 0), ["glass.alpha", "glass.ior", "ball.center.x"], AWARE)
    assert one.parameters(one.lower)["glass.alpha"] == pytest.approx(0, abs=1e-12)
    assert one.parameters(one.upper)["glass.alpha"] == 1
    np.testing.assert_array_equal(np.isinf(one.lower), [False, False, True])
    np.testing.assert_array_equal(np.isinf(one.upper), [False, one.unknowns.limits[1, 1] == np.inf, True])
    # Beyond a bound nothing changes, and a projection comes back.
    beyond = one.upper.at[2].set(0) + jnp.array([0.5, 0, 0])
    assert one.parameters(beyond)["glass.alpha"] == 1
    assert one.parameters(jnp.clip(beyond, one.lower, one.upper))["glass.alpha"] == 1


@pytest.mark.slow
def test_pulls_of_two_cameras(ball):
    scenes = ball, set_parameters(ball, {"eye.viewpoint": (1.0, 3.5, 6.0)})
    pairs = [
        [make_residual(one, noisy(one, [k, seed]), FREE, AWARE) for k, one in enumerate(scenes)] for seed in range(40)
    ]
    values = np.array(list(pairs[0][0].parameters(pairs[0][0].start).values()))

    @jax.jit
    def look(y, pair):
        def joint(y):
            return jnp.concatenate([jnp.ravel(one.residual(y)) for one in pair])

        return joint(y), jax.jacfwd(joint)(y)

    pulls, gains = [], []
    for pair in pairs:
        y = pair[0].start
        for _ in range(3):
            residual, jacobian = look(y, pair)
            y = jnp.clip(y - jnp.linalg.lstsq(jacobian, residual)[0], pair[0].lower, pair[0].upper)
        errors = covariance(pair, y).standard_error
        gains.append(errors / covariance(pair[0], y).standard_error)
        pulls.append((np.array(list(pair[0].parameters(y).values())) - values) / errors)
    assert np.all(np.mean(gains, axis=0) < 0.95)
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=3 * np.sqrt(2 / np.size(pulls)))
