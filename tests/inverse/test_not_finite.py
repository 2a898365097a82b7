"""Pictures and derivatives that are not finite: a solver never accepts them, they are never best, and it is told."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_fit import linear_names, linear_problem
from linear_pictures import POINT, state_at

from raytrace_jax import PictureError, RaytraceWarning
from raytrace_jax.images.masks import bad_pixels, blackened, mask_in_words
from raytrace_jax.inverse.judge.structure import explains
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.search import choose_levels, find_minima
from raytrace_jax.inverse.solve.solvers import GaussNewton, LevenbergMarquardt, minimise

EXACT = LevenbergMarquardt(relative=1e-10, decrease=1e-12, rejected=8)
COLUMNS = np.random.default_rng(5).normal(size=(2, 3, 12, 16))
TRUTH = np.array([0.6, -0.3])
BROKEN = [("residual", np.nan), ("residual", np.inf), ("jacobian", np.nan), ("jacobian", -np.inf)]


@pytest.fixture(autouse=True)
def not_debugged():
    with jax.debug_nans(False):
        yield


def problem_from(start):
    return linear_problem(COLUMNS, np.tensordot(TRUTH, COLUMNS, 1), start=np.array(start, float))


def broken(linearization, part, value):
    """A linearisation with one number that is not finite."""
    return dataclasses.replace(linearization, **{part: jnp.asarray(getattr(linearization, part)).at[0].set(value)})


def solved(problem, is_broken, how):
    """Where a solver ends, and its steps, if the picture is broken wherever `is_broken` says so of the unknowns."""
    steps = []

    def look(y):
        found = problem.linearize(y, POINT)
        return FitState(problem, y, POINT, broken(found, *how) if is_broken(np.asarray(y)) else found)

    return minimise(EXACT, look(problem.start()), look, lambda *step: steps.append(step)), steps


@pytest.mark.parametrize("how", BROKEN)
def test_a_step_to_a_broken_place_is_cut(how):
    problem = problem_from([-2.0, 2.0])
    # Broken in a region that the straight way to the answer passes, but for its last tenth.
    state, steps = solved(problem, lambda y: 0.2 < y[0] < 0.55, how)
    assert np.all(np.isfinite(state.y)) and state.linearization.is_finite
    assert all(np.isfinite(cost) for cost, _, _ in steps)
    accepted = [cost for cost, is_accepted, _ in steps if is_accepted]
    assert accepted == sorted(accepted, reverse=True)
    assert state.linearization.cost < steps[0][0] or not accepted


def test_what_is_not_finite_explains_nothing():
    problem = problem_from(TRUTH)
    state = state_at(problem)
    assert explains(state)
    assert not explains(dataclasses.replace(state, linearization=broken(state.linearization, "jacobian", np.nan)))


def break_where(monkeypatch, is_broken):
    """Break the pictures of all problems whose unknowns are such."""
    whole = Problem.linearize

    def linearize(self, y, stage):
        found = whole(self, y, stage)
        return broken(found, "residual", np.nan) if is_broken(np.asarray(y)) else found

    monkeypatch.setattr(Problem, "linearize", linearize)


def test_gauss_newton_stops_at_broken_places(monkeypatch):
    problem = problem_from([0.0, 0.0])
    solution = state_at(problem)
    break_where(monkeypatch, lambda y: y[0] > 0.01)
    progress = Progress(problem)
    # The truth is within the reach of one step in natural scales only if these are large: take the step.
    problem.__dict__["scale"] = np.full(2, 100.0)
    with pytest.warns(RaytraceWarning, match="not finite"):
        ended = minimise(GaussNewton(), solution, lambda y: state_at(problem, y), progress.of_level(0, 0))
    assert not ended.settled and ended.linearization.is_finite
    np.testing.assert_array_equal(ended.y, problem.start())
    assert [step.accepted for step in progress.findings.steps] == [False]


def minima_of(problem, monkeypatch, starts):
    monkeypatch.setattr("raytrace_jax.inverse.solve.search.find_starts", lambda *_: list(map(np.asarray, starts)))
    progress = Progress(problem)
    options = FitOptions(blur=(0.0,), edges="point")
    return find_minima(problem, choose_levels(problem, options), options, progress)


def test_a_broken_start_is_left_out(monkeypatch):
    problem = problem_from([0.0, 0.0])
    break_where(monkeypatch, lambda y: y[0] > 1)
    with pytest.warns(RaytraceWarning, match=r"start 1 \(a\.center\.x 3, b\.center\.x 0\) is left out"):
        minima = minima_of(problem, monkeypatch, [[3.0, 0.0], [0.0, 0.0]])
    assert [minimum.summary.candidate for minimum in minima] == [1]
    np.testing.assert_allclose(minima[0].summary.value, TRUTH, atol=1e-3)
    assert linear_names(2) == ("a.center.x", "b.center.x")


def test_a_fit_says_if_every_start_is_broken(monkeypatch):
    problem = problem_from([0.0, 0.0])
    break_where(monkeypatch, lambda y: True)
    with pytest.warns(RaytraceWarning, match="left out"), pytest.raises(PictureError, match="nowhere to begin"):
        minima_of(problem, monkeypatch, [[3.0, 0.0], [0.0, 0.0]])


def test_a_bad_pixel_counts_as_masked():
    bad = np.zeros(COLUMNS.shape[-2:], bool)
    bad[3, 5] = True
    target, start = np.tensordot(TRUTH, COLUMNS, 1), np.array([0.1, 0.2])
    masked = linear_problem(COLUMNS, target, start=start, weights=np.where(bad, 0.0, 1.0))
    expected = masked.linearize(masked.start(), POINT)
    for value in (np.nan, np.inf):
        problem = linear_problem(np.where(bad, value, COLUMNS), target, start=start)
        state = state_at(problem)
        found = state.linearization
        np.testing.assert_array_equal(found.bad, bad)
        for name in ("jacobian", "residual", "pixel_jacobian", "squares", "typical"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12, err_msg=name)
        assert np.all(state.residual[:, 3, 5] == 0)


def test_many_bad_pixels_break_a_picture():
    columns = np.where(np.arange(16) > 13, np.nan, COLUMNS)
    problem = linear_problem(columns, np.tensordot(TRUTH, COLUMNS, 1), start=np.array([0.1, 0.2]))
    found = problem.linearize(problem.start(), POINT)
    assert not np.any(found.bad) and not found.is_finite


def test_bad_pixels_in_words():
    image = np.zeros((3, 4, 9))
    image[1, 2, 3] = np.nan
    assert mask_in_words(bad_pixels(image), (10, 20)) == "1 pixel is NaN or infinite: row 22, column 13"
    image[0, 1] = np.inf
    words = mask_in_words(bad_pixels(image))
    assert words.startswith("10 pixels are NaN or infinite: row 1, column 0; ") and words.endswith("; and 5 more")
    assert np.all(blackened(image) == 0)


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_start_accepts_no_step(how):
    state, steps = solved(problem_from([1.0, 1.0]), lambda y: True, how)
    assert not state.settled and not state.linearization.is_finite
    assert len(steps) == 1 and not steps[0][1]
