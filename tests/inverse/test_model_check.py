"""What an answer rests on, whether a residual is more than noise, what it looks like, and what residuals hide."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_fit import linear_names, linear_problem
from linear_pictures import COLUMNS, POINT, SIGMA, TRUTH, picture, state_at, white
from posing import posed_problem
from scenes import assignment_scene
from scipy import ndimage

from raytrace_jax import RenderSettings
from raytrace_jax.inverse.judge.columns import pixels_to_check
from raytrace_jax.inverse.judge.model_check import beyond, check_model, expected_error
from raytrace_jax.inverse.judge.score_test import (
    SIGNIFICANT,
    Hypothesis,
    Rows,
    find_causes,
    fitted,
    response_hypotheses,
)
from raytrace_jax.inverse.judge.structure import distant_correlation
from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.problem.noise import correlated_scatter, leverage_correction, sample_jump
from raytrace_jax.scene.schema import Attribute, Quantity

FREE = 2
ANYWHERE = Attribute("x", quantity=Quantity())
C = linear_names(3)[2]
ROWS = COLUMNS[:FREE].reshape(FREE, -1).T


def checked(target, stage=POINT, uncertain=None, **options):
    """The least-squares fit of the first two numbers, with the third where the scene has it; and its check."""
    rest = (target - TRUTH[2] * COLUMNS[2]).reshape(-1)
    values = np.linalg.lstsq(ROWS, rest, rcond=None)[0]
    problem = linear_problem(COLUMNS, target, free=FREE, start=TRUTH, **options)
    y = problem.y_of(values)
    state = state_at(problem, y, stage)
    sure = quantify_uncertainty(state, None)
    found = check_model(state, sure.standard_error, uncertain or {})
    return values, sure, found


def assumption(found, name):
    (one,) = [a for a in found.assumptions if a.name == name]
    return one


@pytest.mark.parametrize("uncertain", [{}, {C: 0.005}, {C: 0.5}])
def test_the_expected_error_is_the_final_one(uncertain):
    """Of white noise, beside pixels that are off and few: these are what the last steps take away."""
    target = picture(TRUTH) + white()
    values, sure, found = checked(target, uncertain=uncertain)
    problem = linear_problem(COLUMNS, np.where(np.abs(white()) > 2.8 * SIGMA, 5.0, target), free=FREE, start=TRUTH)
    expected = expected_error(state_at(problem, problem.y_of(values)), uncertain, {})
    total = np.sqrt(np.diag(sure.covariance + found.stated))
    total = np.minimum(total, 30 * sure.standard_error) / problem.slopes(problem.y_of(values))
    np.testing.assert_allclose(expected, total, rtol=0.35 if uncertain else 0.15)


def test_the_expected_error_leaves_the_film_out():
    """Also where nothing else is stated, and where a film's number correlates with one of the scene's."""
    state = state_at(linear_problem(COLUMNS, picture(TRUTH) + white(), free=FREE, start=TRUTH))
    film, both = {"film.gamma": 0.1}, {"film.gamma": 0.1, C: 0.005}
    np.testing.assert_array_equal(expected_error(state, film, {}), expected_error(state, {}, {}))
    correlated = expected_error(state, both, {("film.gamma", C): 0.5})
    np.testing.assert_array_equal(correlated, expected_error(state, {C: 0.005}, {}))


@pytest.mark.slow
def test_the_sensitivity_is_that_of_two_fits():
    target = picture(TRUTH) + white()
    _, _, found = checked(target)
    fits = [np.linalg.lstsq(ROWS, (target - c * COLUMNS[2]).reshape(-1), rcond=None)[0] for c in (0.5, 0.6)]
    np.testing.assert_allclose(assumption(found, C).sensitivity, (fits[1] - fits[0]) / 0.1, rtol=1e-5)
    assert found.assumptions[0].name == C, "nothing else of the scene changes the picture"
    assert not np.any(assumption(found, "eye.viewpoint.x").sensitivity)


def test_a_wrong_number_is_named_as_cause():
    wrong = TRUTH + np.array([0, 0, 0.02])
    values, sure, found = checked(picture(wrong) + white())
    (cause,) = found.causes
    assert cause.name == C and found.is_structured
    assert cause.amount == pytest.approx(0.02, rel=0.05) and cause.score > SIGNIFICANT
    assert cause.words == "c.center.x +4 %"
    error, total = np.abs(values - wrong[:FREE]), np.sqrt(np.diag(sure.covariance + found.structure))
    assert np.any(error > 5 * sure.standard_error), "the case is worth testing"
    assert np.all(error < 2 * total)


@pytest.mark.parametrize(("steps", "is_named"), [(0.9, False), (1.1, True)])
def test_a_change_below_a_step_is_no_cause(steps, is_named):
    """Storing rounds equal colours alike: what it leaves may look like a change of the scene by less than a step."""
    change, step = COLUMNS[2].reshape(1, -1), 1 / 255
    amount = steps * step / np.max(np.abs(change))
    residual = amount * change[0] + 0.2 * white().reshape(-1) * amount
    limit = np.full(residual.shape, step)
    rows = Rows(residual, residual, np.ones_like(residual), np.arange(residual.size) // 48, limit)
    candidates = [Hypothesis(C, 0.0, 0.0, ANYWHERE, change[0])]
    causes, structure = find_causes(rows, ROWS.T, ROWS.T, candidates, np.ones(FREE))
    assert [cause.name for cause in causes] == [C] * is_named
    shift = np.linalg.lstsq(ROWS, amount * change[0], rcond=None)[0]
    np.testing.assert_allclose(structure, np.outer(shift, shift), rtol=0.02)


def of_two(changed, seed):
    """A residual by one of two changes: a number apart from the free ones, and one that they nearly make up for.

    The second leaves little, and that is like the first. Each may be off by a tenth before it is no longer linear.

    Returns:
        The names of the causes; the error that the change makes; and how much counts in the error.
    """
    random = np.random.default_rng([seed, 4])
    free, (apart, other) = random.normal(size=(2, 640)), random.normal(size=(2, 640))
    left = 10 ** random.uniform(-2.5, -1)
    changes = np.stack([apart, random.normal(size=2) @ free + left * (apart + 0.5 * other)])
    amount = random.uniform(0.02, 0.08) * random.choice([-1, 1])
    noise = 0.2 * amount * (left if changed else 1) * random.normal(size=640)
    target = amount * changes[changed] + noise
    estimate = np.linalg.lstsq(free.T, target, rcond=None)[0]
    rows = Rows(*[estimate @ free - target] * 2, np.ones(640), np.arange(640) // 16, np.zeros(640))
    candidates = [
        Hypothesis(name, 1.0, 1.0, ANYWHERE, change, linear=0.1)
        for name, change in zip(("apart", "alike"), changes, strict=True)
    ]
    found, structure = find_causes(rows, free, free, candidates, np.ones(2))
    return [cause.name for cause in found], np.linalg.norm(estimate), np.sqrt(np.trace(structure))


def film_changes(problem, light):
    """What a unit of each of the film's numbers does to a picture all of whose pixels are sampled, by name."""
    found = response_hypotheses(pixels_to_check(state_at(problem)), light)
    return {each.name: each.column for each in found}


@pytest.mark.parametrize("changed", [0, 1])
def test_only_possible_causes_add_error(changed):
    """Up to no end the second would make the errors 2600 times as large (median) where the first has changed."""
    names, error, counted = zip(*(of_two(changed, seed) for seed in range(40)), strict=True)
    assert sum(one[0] == ("apart", "alike")[changed] for one in names) >= 38
    ratio = np.array(counted) / error
    assert 0.9 < np.median(ratio) < 1.3 and np.min(ratio) > 0.6
    assert np.quantile(ratio, 0.95) < 5


def test_a_gamma_that_cannot_be_is_no_error():
    """One that a free number nearly makes up for, and of whose rest the residual has three times as much."""
    light = np.clip(picture(TRUTH), 0.05, None)
    pattern = 0.02 * ndimage.gaussian_filter(np.random.default_rng([0, 5]).normal(size=light.shape), (0, 2, 2)) / 0.14
    still = linear_problem(COLUMNS, light, free=FREE, start=TRUTH)
    gamma = film_changes(still, light)["film.gamma"].reshape(light.shape)
    columns = np.stack([gamma - pattern, COLUMNS[1], light])
    columns[2] -= TRUTH[0] * columns[0] + TRUTH[1] * columns[1]
    columns[2] /= TRUTH[2]
    target = light - 3 * pattern + 0.1 * white()
    rows = columns[:FREE].reshape(FREE, -1).T
    values = TRUTH[:FREE] + np.linalg.lstsq(rows, (target - light).reshape(-1), rcond=None)[0]
    problem = linear_problem(columns, target, free=FREE, start=TRUTH)
    found = check_model(state_at(problem, problem.array(values)), np.full(FREE, 1e-4), {})
    (of_gamma,) = [cause for cause in found.causes if cause.name == "film.gamma"]
    assert of_gamma.amount < -2 and of_gamma.advice.endswith("film.gamma must be greater than 0")
    assert np.sqrt(found.structure[0, 0]) < 0.1, "instead of 2.8"


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("seed", range(20))
def test_noise_alone_has_no_structure(seed):
    for noise in (white(seed), white(seed) * (1 + 2 * np.abs(COLUMNS[2])), SIGMA * student(seed)):
        _, _, found = checked(picture(TRUTH) + noise)
        assert not found.is_structured and not np.any(found.structure)


def student(seed):
    return np.random.default_rng(seed).standard_t(3, size=COLUMNS.shape[1:])


def test_what_a_camera_does_is_named():
    light = np.clip(picture(TRUTH), 0.05, None)
    columns = np.concatenate([COLUMNS[:FREE], (light - picture(TRUTH))[None] / TRUTH[2] + COLUMNS[2:]])
    still = linear_problem(columns, light, free=FREE, start=TRUTH)
    changed = film_changes(still, light)
    changes = {"film.gamma": 0.02, "film.offset.g": 0.01, "film.vignetting": -0.05, "film.light.x": 0.05}
    for name, amount in changes.items():
        target = light + amount * changed[name].reshape(light.shape) + 0.2 * white()
        problem = linear_problem(columns, target, free=FREE, start=TRUTH)
        found = check_model(state_at(problem), np.ones(FREE), {})
        assert found.causes[0].name == name
        assert found.causes[0].amount == pytest.approx(amount, rel=0.2)


@pytest.mark.parametrize(
    ("free", "options", "absent", "present"),
    [
        (["film.gain", "film.blur"], {}, {"film.gain", "film.gain.r", "film.blur"}, {"film.offset.g", "film.gamma"}),
        (["film.light.x"], {}, {"film.light", "film.light.x"}, {"film.light.y", "film.light.xx", "film.gain"}),
        ([], {"fit_exposure": True}, {"film.gain", "film.offset"}, {"film.gain.r", "film.offset.b", "film.blur"}),
    ],
)
def test_fitted_effects_are_no_suspects(free, options, absent, present):
    """Of channels that are tied each may still be off on its own."""
    scene, light = assignment_scene(), np.random.default_rng(0).uniform(0.1, 1, (3, 12, 16))
    problem = posed_problem(scene, light, ["vitreous.ior", *free], RenderSettings(size=(16, 12)), **options)
    names = set(film_changes(problem, light))
    assert not names & absent and names >= present


def test_stated_film_numbers_are_no_causes():
    target = picture(TRUTH) + white()
    target[1] *= 1.01
    _, _, found = checked(target)
    assert [cause.name for cause in found.causes] == ["film.gain.g"]
    assert found.causes[0].amount == pytest.approx(0.01, rel=0.2) and found.causes[0].unit == "%"
    _, _, stated = checked(target, uncertain={"film.gain.g": 0.01})
    assert not stated.causes
    gain = assumption(stated, "film.gain.g")
    moved = 0.01 * gain.sensitivity
    assert gain.uncertainty == 0.01 and gain.value == 1
    np.testing.assert_allclose(stated.stated, np.outer(moved, moved))


def test_unexplained_structure_is_structure():
    rows, columns = np.mgrid[: COLUMNS.shape[2], : COLUMNS.shape[3]]
    stripes = np.broadcast_to(np.sign(np.sin(rows / 5) * np.sin(columns / 7)), COLUMNS.shape[1:])
    _, _, found = checked(picture(TRUTH) + white() + 2 * SIGMA * stripes)
    assert found.is_structured and found.distant_correlation > 3


def test_roundings_are_no_structure():
    _, _, found = checked(picture(TRUTH) * (1 + 1e-15))
    assert not found.is_structured


def test_what_storing_did_is_no_structure():
    """A picture of areas of one colour each, in float32: each area is off by its own rounding."""
    areas = np.random.default_rng(0).normal(size=(3, 4, 5)).repeat(16, 1).repeat(16, 2)
    columns = np.concatenate([COLUMNS[:FREE], areas[None] / TRUTH[2]])
    target = picture(TRUTH, columns)
    target = np.where(np.arange(80) < 70, target - picture(TRUTH[:FREE], COLUMNS[:FREE]), target)
    columns[:FREE, :, :, :70] = 0
    target = target.astype(np.float32).astype(np.float64)
    problem = linear_problem(columns, target, free=FREE, start=TRUTH)
    assert distant_correlation(state_at(problem).residual) > 3, "the case is worth testing"
    assert not check_model(state_at(problem), np.ones(FREE), {}).is_structured


def test_storage_is_judged_in_flat_areas():
    """Areas of one colour each in 8 bits, beside a fifth of pixels that are noisy; and noise everywhere."""
    random, step = np.random.default_rng(8), 1 / 255
    areas = random.uniform(size=(3, 4, 5)).repeat(16, 1).repeat(16, 2)
    noise = 20 * step * random.normal(size=areas.shape)
    at_edges = np.where(np.arange(80) % 16 >= 13, noise, 0.0)
    everywhere = 3 * step * random.normal(size=areas.shape)
    for extra, is_noisy in ((at_edges, False), (everywhere, True)):
        target = np.round((areas + extra) / step) * step
        problem = linear_problem(COLUMNS, target, free=FREE, start=TRUTH)
        residual = areas - target
        shown = beyond(problem.observation, residual, np.ones_like(target), np.array(1.5 * step))
        within = np.abs(residual) <= 1.5 * step
        np.testing.assert_array_equal(shown, residual if is_noisy else np.where(within, 0, residual))


def test_rounded_samples_are_no_structure():
    """Means of samples that were cut off to 16 bits are all half a step too dark; ten steps are an offset."""
    for steps, is_structured in ((0.5, False), (10, True)):
        target = picture(TRUTH) - steps / 65535 + 1e-7 * np.random.default_rng(7).normal(size=COLUMNS.shape[1:])
        problem = linear_problem(COLUMNS, target, free=FREE, start=TRUTH)
        state = state_at(problem)
        # The last two are means of samples, the latter on no grid that was told.
        of_grid, of_any = (
            dataclasses.replace(state, problem=dataclasses.replace(problem, samples=samples)) for samples in (8, None)
        )
        for one, expected in ((of_grid, is_structured), (of_any, is_structured), (state, True)):
            assert check_model(one, np.ones(FREE), {}).is_structured == expected


def test_white_noise_pairs_score_about_one():
    scores = np.array([distant_correlation(white(seed)) for seed in range(60)])
    assert abs(scores.mean()) < 0.5 and abs(scores.std() - 1) < 0.35


def test_correlated_neighbours_are_no_distant_pairs():
    blurred = ndimage.gaussian_filter(white(3), (0, 0.8, 0.8))
    assert abs(distant_correlation(blurred)) < 3 < distant_correlation(ndimage.gaussian_filter(white(3), (0, 6, 6)))


@pytest.mark.parametrize("blur", [0.0, 0.5, 1.0])
def test_noise_covariance_is_that_of_draws(blur):
    everywhere = np.ones(COLUMNS.shape[1:], bool)

    def noise(seed):
        return ndimage.gaussian_filter(white(seed), (0, blur, blur)) if blur else white(seed)

    pulls = np.array([np.tensordot(COLUMNS, noise(seed), 3) for seed in range(400)])
    alone = [np.einsum("pchw,qchw,chw->pq", COLUMNS, COLUMNS, noise(seed) ** 2) for seed in range(5)]
    found = [a + correlated_scatter(COLUMNS, noise(seed), everywhere) for seed, a in enumerate(alone)]
    ratio = np.sqrt(np.diag(np.mean(found, axis=0))) / pulls.std(axis=0)
    np.testing.assert_allclose(ratio, 1, atol=0.15)
    if blur == 0:
        assert not any(correlated_scatter(COLUMNS, noise(seed), everywhere).any() for seed in range(5))


def test_gray_noise_counts_as_one_channel():
    gray = np.repeat(white(1)[:1], 3, axis=0)
    same = np.repeat(COLUMNS[:, :1], 3, axis=1)
    alone = np.einsum("pchw,qchw,chw->pq", same, same, gray**2)
    total = state_at(linear_problem(same, gray)).linearization.pixel_scatter
    np.testing.assert_allclose(np.diag(total) / np.diag(alone), 3, rtol=1e-6)


@pytest.mark.parametrize(("flips", "samples", "may_be"), [(1.9, 8, True), (2.1, 8, False), (1.9, None, False)])
def test_single_edge_samples_prove_nothing(flips, samples, may_be):
    target = picture(TRUTH)
    state = state_at(linear_problem(COLUMNS, target, free=FREE, start=TRUTH))
    problem = dataclasses.replace(state.problem, samples=samples)
    state = dataclasses.replace(state, problem=problem, confusion=np.zeros((FREE, FREE)))
    evidence = np.zeros_like(target)
    evidence[1, 20, 30] = -flips * np.ptp(target) / 64
    jump = np.array(sample_jump(state))
    assert beyond(problem.observation, evidence, np.ones_like(target), jump).any() != may_be


PIXELS = 30


def columns_with_a_decisive_pixel(seed, largest):
    columns = np.random.default_rng(seed).normal(size=(3, 2, PIXELS))
    columns[1, 0, 7] = largest
    return columns


@given(st.integers(0, 1000), st.floats(1, 100))
def test_scatter_is_that_of_the_jackknife(seed, largest):
    columns = columns_with_a_decisive_pixel(seed, largest)
    random = np.random.default_rng(seed)
    weight, data = random.uniform(0.2, 1, (2, PIXELS)), random.normal(size=(2, PIXELS))

    def estimate(keep):
        flat, seen, counts = (part[..., keep].reshape(*part.shape[:-2], -1) for part in (columns, data, weight))
        return fitted(flat, seen[None], counts)[:, 0]

    everything = np.arange(PIXELS)
    whole = estimate(everything)
    score = weight * (data - np.tensordot(whole, columns, 1))
    moved = np.array([estimate(everything != pixel) - whole for pixel in range(PIXELS)])
    flat = columns.reshape(3, -1)
    # Along directions in which the weighted columns have the identity.
    half = np.linalg.inv(np.linalg.cholesky((flat * weight.reshape(-1)) @ flat.T))
    along = np.tensordot(half, columns, 1)
    pulls = np.sum(along * score, axis=1)
    jackknife = half.T @ (pulls @ pulls.T + leverage_correction(along, weight, score)) @ half
    # Leverages of less than a hundredth are passed over.
    np.testing.assert_allclose(jackknife, moved.T @ moved, rtol=0.03, atol=0.03 * np.max(moved.T @ moved))


def test_a_decisive_pixel_has_finite_errors():
    columns = np.zeros((2, 2, PIXELS))
    columns[0], columns[0, 0, 3], columns[1, 0, 3] = (2 * PIXELS - 1) ** -0.5, 0.0, 1.0
    weight, score = np.ones((2, PIXELS)), np.full((2, PIXELS), 0.1)
    score[:, 3] = 1e-17
    assert np.all(np.isfinite(leverage_correction(columns, weight, score)))
