"""Finite differences that know their own error, and what they say of a derivative picture."""

import numpy as np
import pytest
from scenes import assignment_scene

from raytrace_jax import RenderSettings, set_parameters
from raytrace_jax.report.derivatives import check_derivative
from raytrace_jax.tracer import derivatives
from raytrace_jax.tracer.derivatives import relative_error

RANDOM = np.random.default_rng(0)
TRUE = RANDOM.normal(size=(3, 30, 40))
NOISE = RANDOM.normal(size=(3, 30, 40))


def with_pixel(value):
    changed = TRUE.copy()
    changed[0, 12, 30] = value
    return changed


@pytest.mark.parametrize(
    ("derivative", "spread", "verdict", "words"),
    [
        (1.1 * TRUE, 0.05, "agree", "agree, to 0.1 of the norm; the differences by two steps to 0.05"),
        (0 * TRUE, 0.05, "disagree", "disagree, by 1 of the norm"),
        (TRUE + 0.7 * NOISE, 0.1, "disagree", "disagree, by 0.7"),
        (with_pixel(60.0), 0.1, "disagree", "pixel (130, 212) holds 50 % of the squared norm, R 60 where"),
        (with_pixel(23.0), 0.1, "disagree", "disagree, by 0.39 of the norm: pixel (130, 212) holds 13 %"),
        (with_pixel(23.0), 0.4, "agree", "agree, to 0.39"),  # The differences' own error may lie there.
        (TRUE + 0.7 * NOISE, 0.6, "undecided", "0.6 of their norm apart, too coarse to judge by"),
    ],
)
def test_verdicts(derivative, spread, verdict, words):
    check = check_derivative(derivative, TRUE, spread, origin=(100, 200))
    assert (check.verdict, check.error) == (verdict, relative_error(derivative, TRUE))
    assert words in check.words and check.words.startswith(verdict.split(" but")[0])


def test_many_wrong_pixels_are_no_exceptions():
    derivative = TRUE.copy()
    derivative[:, 3, :5] += 9
    check = check_derivative(derivative, TRUE, 0.1)
    assert check.verdict == "agree but for pixels" and 1 < check.exceptions <= 5
    assert check.words.startswith(f"agree but for {check.exceptions} pixels: pixel (")
    derivative[:, 3] += 9
    assert check_derivative(derivative, TRUE, 0.1).verdict == "disagree"


def test_what_depends_on_nothing_agrees():
    assert check_derivative(0 * TRUE, 0 * TRUE, 0.0).verdict == "agree"
    check = check_derivative(TRUE, 0 * TRUE, 0.0)
    assert check.verdict == "disagree" and "inf" in check.words


def differences_of(monkeypatch, picture, **how):
    """What `steady_differences` makes of a difference that is a function of the step, and the steps it took."""
    taken = []

    def differ(scene, names, settings, step, samples, on_step):
        taken.extend(step for _ in names)
        return np.stack([picture(step) for _ in names])

    monkeypatch.setattr(derivatives, "finite_differences", differ)
    return derivatives.steady_differences(
        assignment_scene(), ["vitreous.ior"], RenderSettings(size=(40, 30)), **how
    ), taken


@pytest.mark.parametrize(
    ("how", "most", "steps", "spread"),
    [
        ({}, 1.0, [0.006, 0.003, 0.0015], 0.15),  # Until two agree.
        ({"step": 0.02, "samples": 7}, 1.0, [0.02, 0.01], 0.71),  # One that is told, with its half.
        ({"step": 0.006}, 0.001, [0.006, 0.003, 0.0015, 0.00075], 0.025),  # Limits that make two the same say nothing.
    ],
)
def test_steps_are_halved_until_two_agree(how, most, steps, spread, monkeypatch):
    found, taken = differences_of(monkeypatch, lambda step: TRUE + 100 * min(step, most) * NOISE, **how)
    np.testing.assert_allclose(taken, steps)
    assert found.steps == (steps[-1],) and found.samples == how.get("samples", found.samples)
    assert found.spreads[0] == pytest.approx(spread, rel=0.1)
    assert how or relative_error(found.values[0], TRUE) == pytest.approx(found.spreads[0], rel=0.1)


def test_steps_are_halved_while_it_helps(monkeypatch):
    # Samples that edges cross, or not, are noise, and the more of it the shorter the step.
    def noisy(step):
        return TRUE + 1e-3 / step * np.random.default_rng(int(1 / step)).normal(size=TRUE.shape)

    found, taken = differences_of(monkeypatch, noisy)
    np.testing.assert_allclose(taken, [0.006, 0.003, 0.0015])
    assert found.steps == (0.003,) and found.spreads[0] > 0.3


def test_they_are_finite_differences_of_the_picture():
    scene = set_parameters(assignment_scene(), {"vitreous.ior": 1.4})
    settings = RenderSettings(size=(24, 18), max_bounces=2)
    found = derivatives.steady_differences(scene, ["topright.location"], settings, step=1e-3, samples=1)
    assert found.values.shape == (3, 3, 18, 24) and len(found.spreads) == len(found.steps) == 3
    assert max(found.spreads) < 0.05  # light is smooth
