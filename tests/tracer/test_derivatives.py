"""Derivatives of pictures by named parameters: their values, their check by finite differences, their sheet."""

import dataclasses
import functools
import itertools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene

import raytrace_jax as rj
from raytrace_jax import RenderSettings, set_parameters
from raytrace_jax.report import differences
from raytrace_jax.report.derivatives import check_derivative, draw_gradients
from raytrace_jax.report.differences import correlation, finite_differences, relative_error
from raytrace_jax.tracer.rendering import PictureDerivatives
from raytrace_jax.util.compilation import jit

SETTINGS = rj.RenderSettings(size=(24, 18), max_bounces=2, edges="point")
GIVEN = ("vitreous.ior", "vitreous.center")
NAMES = ("vitreous.ior", "vitreous.center.x", "vitreous.center.y", "vitreous.center.z")


@pytest.mark.slow
def test_they_are_those_of_the_picture():
    scene = assignment_scene()
    found = rj.picture_derivatives(scene, GIVEN, SETTINGS)
    renderer = functools.partial(rj.render, settings=SETTINGS)

    def image(center):
        return renderer(rj.set_parameters(scene, {"vitreous.center": center})).image

    jacobian = jit(jax.jacfwd(image))(scene["vitreous.center"])
    assert found.names == NAMES
    assert found.values.shape == (4, 3, 18, 24)
    # Other programs round differently, and a glass ball's derivatives are steep; in the first and the last column
    # rounding decides which wall is seen.
    expected = np.moveaxis(np.asarray(jacobian), -1, 0)[..., 1:-1]
    np.testing.assert_allclose(found.values[1:, ..., 1:-1], expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.image[..., 1:-1], rj.render(scene, SETTINGS).image[..., 1:-1], atol=1e-12)


def test_steps_stay_within_the_limits(monkeypatch):
    seen = []

    def record(scene, settings):
        assert (settings.edges, settings.samples) == ("point", 3)
        seen.append({name: float(scene[name]) for name in ("cyan.alpha", "vitreous.radius")})
        value = seen[-1]["cyan.alpha"] + seen[-1]["vitreous.radius"]  # a picture of which each derivative is 1
        return type("Film", (), {"image": jnp.full((3, 2, 2), value)})

    monkeypatch.setattr("raytrace_jax.report.differences.render", record)
    for alpha, ends in ((1.0, (1.0, 0.9)), (0.0, (0.1, 0.0)), (0.5, (0.6, 0.4)), (0.03, (0.055, 0.005))):
        scene = rj.set_parameters(assignment_scene(), {"cyan.alpha": alpha, "vitreous.radius": 0.07})
        settings = dataclasses.replace(SETTINGS, edges="aware")
        differences = finite_differences(scene, ["cyan.alpha", "vitreous.radius"], settings, 0.1, 3)
        np.testing.assert_allclose(differences, 1)
        np.testing.assert_allclose([end["cyan.alpha"] for end in seen[-4:-2]], ends)
        np.testing.assert_allclose([end["vitreous.radius"] for end in seen[-2:]], (0.12, 0.02))


def test_what_cannot_be_done_is_refused():
    scene = assignment_scene()
    with pytest.raises(rj.ParameterError, match="at least one"):
        rj.picture_derivatives(scene, [], SETTINGS)
    with pytest.raises(rj.ParameterError, match=r"'ior'\?"):
        rj.picture_derivatives(scene, ["vitreous.iorr"], SETTINGS)
    with pytest.raises(rj.ParameterError, match=r"cyan\.alpha.*0\.4 cannot move by a step of 20"):
        finite_differences(scene, ["cyan.alpha"], SETTINGS, step=20.0)
    with pytest.raises(rj.ParameterError, match="step of 1e-30"):
        finite_differences(scene, ["vitreous.ior"], SETTINGS, step=1e-30)
    for step in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="greater than 0"):
            finite_differences(scene, ["vitreous.ior"], SETTINGS, step=step)
    with pytest.raises(ValueError, match="samples is 65"):
        finite_differences(scene, ["vitreous.ior"], SETTINGS, samples=65)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(("count", "checked", "shown"), [(1, False, 2), (4, True, 10), (7, True, 16), (9, False, 10)])
def test_the_sheet_has_a_panel_a_parameter(count, checked, shown, tmp_path):
    random = np.random.default_rng(1)
    values = random.normal(size=(count, 3, 18, 24))
    values[0] = 0  # a parameter on which nothing depends
    names = tuple(f"ball{k}.center.x" for k in range(count))
    found = PictureDerivatives(random.uniform(size=(3, 18, 24)), names, values, ("world unit",) * count)
    figure = draw_gradients(found, 1.1 * values if checked else None, "how")
    panels = [ax for ax in figure.axes if ax.get_visible()]
    assert len(panels) == shown
    titles = [ax.get_title() for ax in panels]
    assert all(f"d.{name}" in titles for name in names)
    assert sum("relative L2 error 0.0909" in title for title in titles) == (count - 1 if checked else 0)
    for ax in panels:
        for image in ax.images[:1] if ax.get_title().startswith("d.") else []:
            low, high = image.get_clim()
            assert low == -high < 0
    figure.savefig(tmp_path / "sheet.png")
    # No caption runs into another panel's, and the sheet is about as wide as a slide.
    boxes = [ax.get_tightbbox() for ax in panels]
    assert not any(
        one.x0 < two.x1 and two.x0 < one.x1 and one.y0 < two.y1 and two.y0 < one.y1
        for one, two in itertools.combinations([box.padded(-1) for box in boxes], 2)
    )
    assert 1.1 < np.divide(*figure.get_size_inches()) < 3.1


def test_the_sheet_says_what_it_clips():
    values = np.random.default_rng(2).normal(size=(1, 3, 18, 24))
    values[0, :, 7, 5] = 300.0
    found = PictureDerivatives(np.zeros((3, 18, 24)), ("ball.radius",), values, ("world unit",))
    figure = draw_gradients(found, values, "how", ["agree"], origin=(100, 200))
    labels = [ax.get_xlabel() for ax in figure.axes if ax.child_axes]
    words = [
        "mean of R, G, B per world unit",
        "0.7 % of its pixels are off the scale",
        "and make 100 % of its sum of squares",
        "(100 % pixel 105, 207 alone)",
    ]
    assert labels == ["\n".join(words)] * 2
    assert figure.axes[3].get_title().endswith("agree")


def test_measures_of_agreement():
    one = np.random.default_rng(0).normal(size=(3, 4, 5))
    zero = np.zeros_like(one)
    assert relative_error(one, one) == 0 and relative_error(zero, zero) == 0
    assert relative_error(one, zero) == float("inf")
    np.testing.assert_allclose(relative_error(1.1 * one, one), 0.1)
    np.testing.assert_allclose([correlation(2 * one + 1, one), correlation(-one, one)], [1, -1])
    assert correlation(one, zero) == 0


BOARD = Path(__file__).parents[2] / "experiments" / "edge_gradients" / "scenes" / "checker.txt"
STEPS = {"ball0.ior": 4e-3, "ball0.center.y": 2e-3, "backdrop.center.z": 1.6e-2, "eye.fov": 0.1}
STEPS |= {"ball0.absorption.g": 0.01}
"""So short that no edge seen through the ball moves by half a pixel: it shows the board's lines magnified."""


@pytest.mark.slow
@pytest.mark.optimized
def test_derivatives_through_glass_agree():
    scene, settings = rj.load_scene(BOARD), rj.RenderSettings(size=(64, 48), max_bounces=8)
    aware = rj.picture_derivatives(scene, list(STEPS), rj.RenderSettings(size=(64, 48), max_bounces=8, edges="aware"))
    for name, values in zip(STEPS, aware.values, strict=True):
        reference = finite_differences(scene, [name], settings, step=STEPS[name], samples=40)[0]
        assert correlation(values, reference) > 0.95, name
        assert relative_error(values, reference) < 0.3, name


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

    def differ(scene, names, settings, step, samples):
        taken.extend(step for _ in names)
        return np.stack([picture(step) for _ in names])

    monkeypatch.setattr(differences, "finite_differences", differ)
    return differences.steady_differences(
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


def test_they_are_finite_differences():
    scene = set_parameters(assignment_scene(), {"vitreous.ior": 1.4})
    settings = RenderSettings(size=(24, 18), max_bounces=2)
    found = differences.steady_differences(scene, ["topright.location"], settings, step=1e-3, samples=1)
    assert found.values.shape == (3, 3, 18, 24) and len(found.spreads) == len(found.steps) == 3
    assert max(found.spreads) < 0.05  # light is smooth
