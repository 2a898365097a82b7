"""Derivatives of pictures by named parameters: their values, their check, their sheet."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene

import raytrace_jax as rj
from raytrace_jax.report.derivatives import draw_gradients
from raytrace_jax.scene.parameters import resolve
from raytrace_jax.tracer.derivatives import correlation, finite_differences, relative_error
from raytrace_jax.util.compilation import jit

SETTINGS = rj.RenderSettings(size=(24, 18), max_bounces=2, edges="point")
GIVEN = ("vitreous.ior", "vitreous.center")
NAMES = ("vitreous.ior", "vitreous.center.x", "vitreous.center.y", "vitreous.center.z")


@pytest.mark.slow
def test_they_are_those_of_the_rendered_picture():
    scene = assignment_scene()
    found = rj.picture_derivatives(scene, GIVEN, SETTINGS)
    renderer = rj.make_renderer(scene, SETTINGS)

    def image(center):
        return renderer(rj.set_parameters(scene, {"vitreous.center": center})).image

    jacobian = jit(jax.jacfwd(image))(rj.get_parameter(scene, "vitreous.center"))
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
        seen.append({name: float(rj.get_parameter(scene, name)) for name in ("cyan.alpha", "vitreous.radius")})
        value = seen[-1]["cyan.alpha"] + seen[-1]["vitreous.radius"]  # a picture of which each derivative is 1
        return type("Film", (), {"image": jnp.full((3, 2, 2), value)})

    monkeypatch.setattr("raytrace_jax.tracer.derivatives.render", record)
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


def test_units():
    scene = rj.parse_scene(
        """
        camera eye { pixeldim 24 18 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
        material red { ior 1.5 }
        sphere a.b { material red center 0 0 0 radius 2 }
        rectangle backdrop { material red center 0 0 -2 right 6 0 0 up 0 4 0 }
        """
    )
    units = {"a.b.ior": "unit of index", "a.b.radius": "world unit", "red.diffuse.g": "unit of diffuse"}
    units |= {"eye.fov": "degree", "eye.center.x": "pixel", "backdrop.center.z": "world unit"}
    assert {name: resolve(scene, name).attribute.unit for name in units} == units


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(("count", "checked", "shown"), [(1, False, 2), (4, True, 10), (7, True, 16), (9, False, 10)])
def test_the_sheet_has_a_panel_for_each_parameter(count, checked, shown, tmp_path):
    random = np.random.default_rng(1)
    values = random.normal(size=(count, 3, 18, 24))
    values[0] = 0  # a parameter on which nothing depends
    names = tuple(f"ball{k}.center.x" for k in range(count))
    found = rj.PictureDerivatives(random.uniform(size=(3, 18, 24)), names, values, ("world unit",) * count)
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


def test_the_sheet_says_what_its_colours_clip():
    values = np.random.default_rng(2).normal(size=(1, 3, 18, 24))
    values[0, :, 7, 5] = 300.0
    found = rj.PictureDerivatives(np.zeros((3, 18, 24)), ("ball.radius",), values, ("world unit",))
    figure = draw_gradients(found, values, "how", ["agree"], origin=(100, 200))
    labels = [bar.get_ylabel() for ax in figure.axes for bar in ax.child_axes]
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
STEPS = {
    "ball0.ior": 4e-3,
    "ball0.center.y": 2e-3,
    "backdrop.center.z": 1.6e-2,
    "eye.fov": 0.1,
    "ball0.absorption.g": 0.01,
}
"""So short that no edge seen through the ball moves by half a pixel: it shows the board's lines magnified."""


@pytest.mark.slow
@pytest.mark.optimized
def test_derivatives_of_glass_before_a_board_are_those_of_supersampled_pictures():
    scene, settings = rj.load_scene(BOARD), rj.RenderSettings(size=(64, 48), max_bounces=8)
    aware = rj.picture_derivatives(scene, list(STEPS), rj.RenderSettings(size=(64, 48), max_bounces=8, edges="aware"))
    for name, values in zip(STEPS, aware.values, strict=True):
        reference = finite_differences(scene, [name], settings, step=STEPS[name], samples=40)[0]
        assert correlation(values, reference) > 0.95, name
        assert relative_error(values, reference) < 0.3, name
