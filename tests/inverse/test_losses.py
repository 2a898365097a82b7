"""The robust losses: that each is what its name says, and that score, curvature and tuning belong to it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_fit import linear_problem
from linear_pictures import state_at

from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.linearize import LOSSES, gauss_newton_step
from raytrace_jax.inverse.solve.solvers import predicted_decrease, step_to_minimum

NAMES = sorted(LOSSES)
DEFINITIONS = {"l2": lambda r, s: r**2 / 2, "cauchy": lambda r, s: s**2 / 2 * np.log1p((r / s) ** 2)}
names = st.sampled_from(NAMES)
scales = st.floats(1e-6, 1e3)
floats = functools.partial(st.floats, allow_subnormal=False)  # XLA takes what is so small for zero.
magnitudes = floats(1e-200, 1e6) | floats(0.01, 3) | st.sampled_from([0.0, 1e-9, 1e-5, 1e-4, 1.0])
ratios = st.builds(np.copysign, magnitudes, st.sampled_from([1.0, -1.0]))
"""Residuals in units of the scale: the small ones lie where Cauchy's residual changes over to its limit."""


def at(name, ratio, scale):
    """Loss, residual and scale, both as arrays."""
    return LOSSES[name], jnp.asarray(ratio * scale), jnp.asarray(scale)


@given(names, ratios, scales)
def test_the_robust_residual_gives_the_loss(name, ratio, scale):
    loss, r, s = at(name, ratio, scale)
    found = float(loss.residual(r, s))
    assert found**2 / 2 == pytest.approx(float(DEFINITIONS[name](float(r), scale)), rel=2e-8)
    assert np.sign(found) == np.sign(float(r))


@pytest.mark.parametrize("name", NAMES)
def test_score_and_curvature_are_differences(name):
    """No automatic derivative is trusted here, nor any formula but the definition."""
    loss, s, step = LOSSES[name], 0.7, 1e-4
    r = np.array([-30.0, -2.0, -0.69, -0.3, -1e-3, 0.0, 1e-3, 0.5, 0.71, 5.0])
    low, middle, high = (DEFINITIONS[name](r + move, s) for move in (-step, 0, step))
    np.testing.assert_allclose(loss.score(jnp.asarray(r), jnp.asarray(s)), (high - low) / (2 * step), atol=1e-7)
    curvature = (high - 2 * middle + low) / step**2
    np.testing.assert_allclose(loss.curvature(jnp.asarray(r), jnp.asarray(s)), curvature, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_residual_slopes_lie_within_0_and_1(name, dtype):
    positive = np.concatenate([[0.0], np.logspace(-30, 12, 400)])
    r = jnp.asarray(np.concatenate([-positive, positive, [1.0, -1.0]]), dtype)
    slope = jax.jit(jax.vmap(jax.grad(lambda r: LOSSES[name].residual(r, jnp.asarray(1.0, dtype)))))(r)
    slope = np.asarray(slope)
    assert np.all(np.isfinite(slope)) and np.all(slope >= 0) and np.all(slope <= 1 + 1e-6)
    assert slope[0] == 1  # at 0


@given(ratios, scales)
def test_an_infinite_scale_is_least_squares(ratio, scale):
    loss, r, infinite = LOSSES["cauchy"], jnp.asarray(ratio * scale), jnp.asarray(jnp.inf)
    assert (float(loss.residual(r, infinite)), float(loss.score(r, infinite))) == (float(r), float(r))
    assert float(loss.curvature(r, infinite)) == 1


def test_cauchy_is_95_percent_efficient():
    """An estimate's variance is E[score^2] / E[curvature]^2; that of least squares on standard Gaussian noise is 1."""
    loss, r = LOSSES["cauchy"], np.linspace(-12, 12, 400_001)
    weight = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi) * (r[1] - r[0])
    scale = jnp.asarray(loss.tuning)
    score, curvature = (np.asarray(f(jnp.asarray(r), scale)) for f in (loss.score, loss.curvature))
    assert np.sum(weight * curvature) ** 2 / np.sum(weight * score**2) == pytest.approx(0.95, abs=0.005)


@given(names, ratios, scales)
def test_weighted_squares_are_below_the_loss(name, ratio, scale):
    loss, r, s = at(name, ratio, scale)
    squares = float(loss.weight(r, s) * r * r)
    assert 0 <= squares <= float(loss.residual(r, s)) ** 2 * (1 + 1e-12) + 1e-300


@pytest.mark.parametrize("name", NAMES)
def test_a_robust_step_meets_linear_targets(name):
    """The root of the loss, in place of its weights, would overshoot."""
    columns, truth = np.random.default_rng([0, 4]).normal(size=(2, 3, 8, 8)), np.array([3.0, -2.0])
    problem = linear_problem(columns, np.tensordot(truth, columns, 1))
    found = problem.linearize(problem.start(), Stage("point", loss=name, loss_scale=0.05))
    np.testing.assert_allclose(gauss_newton_step(found), truth, rtol=1e-9)
    state = state_at(problem, stage=Stage("point", loss=name, loss_scale=0.05))
    np.testing.assert_allclose(step_to_minimum(state, found), truth, rtol=1e-9)
    residual = jnp.asarray(-np.tensordot(truth, columns, 1))
    assert found.cost == pytest.approx(0.5 * float(jnp.sum(LOSSES[name].residual(residual, jnp.asarray(0.05)) ** 2)))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("priors", [{}, {"a.center.x": (2.99, 1e-3)}])
def test_one_step_ends_at_the_minimum_of_noise(name, priors):
    """Residuals are linear, their weights are not; some are outliers, and most are roundings of unequal size."""
    random = np.random.default_rng(7)
    columns = random.normal(size=(2, 3, 24, 32))
    noise = random.normal(size=columns.shape[1:]) * 10 ** random.uniform(-3, 0, size=columns.shape[1:])
    problem = linear_problem(columns, np.tensordot([3.0, -2.0], columns, 1) + noise, priors=priors)
    stage = Stage("point", loss=name, loss_scale=0.1, noise=0.05)
    near = state_at(problem, problem.array([3.05, -2.02]), stage)
    there = near.y + step_to_minimum(near, near.linearization)
    end = state_at(problem, there, stage)
    assert predicted_decrease(end.linearization) < 1e-6 * predicted_decrease(near.linearization)
    assert end.linearization.cost <= near.linearization.cost
