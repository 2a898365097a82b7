"""Edge-aware pictures: coverage against counting, pictures and derivatives against many samples, no NaN anywhere."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from awkward_physical import faults_of, in_both_modes
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import AWKWARD, assignment_scene, awkward_scene, random_scene, resolved

from raytrace_jax import RenderSettings, parse_scene, picture_derivatives, render, set_parameters
from raytrace_jax.report.differences import finite_differences, relative_error
from raytrace_jax.tracer.visibility.coverage import cut_pixel

SIZE = (80, 60)
AWARE = RenderSettings(size=SIZE, edges="aware")
BALL = """
camera eye { pixeldim 49 36 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 4 3 6 emissivity 0 0 0 }
material white { ambient .9 .9 .9 }
sphere ball { material white center 4.6 3 -1 radius 1.5 }
"""
INSIDE = np.s_[:, :, 1:-1]  # Both walls meet the image plane in the first and last column.


jitted_cut = jax.jit(cut_pixel)


@given(st.floats(-0.8, 0.8), st.floats(0, 2 * np.pi))
def test_a_cut_pixel_against_counting(d, angle):
    normal = np.array([np.cos(angle), np.sin(angle)])
    grid = (np.arange(400) + 0.5) / 400 - 0.5
    along = normal[0] * grid[:, None] + normal[1] * grid
    near = along > -d
    cut = jitted_cut(jnp.asarray(d), jnp.asarray(normal))
    assert float(cut.area) == pytest.approx(near.mean(), abs=5e-3)
    for part, shift, width in zip((near, ~near), cut.shift, cut.width, strict=True):
        if part.mean() > 0.02:
            assert float(shift) == pytest.approx(along[part].mean(), abs=5e-3)
            assert float(width) == pytest.approx(along[part].std() / along.std(), abs=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("reflectance", ["none", "schlick"])
def test_one_aware_sample_beats_one_point(reflectance):
    scene, how = assignment_scene(), {"size": SIZE, "reflectance": reflectance}
    many = np.asarray(render(scene, RenderSettings(**how, samples=12)).image)[INSIDE]
    pictures = (render(scene, RenderSettings(**how, edges=edges)).image for edges in ("point", "aware"))
    point, aware = (np.sqrt(np.mean((np.asarray(image)[INSIDE] - many) ** 2)) for image in pictures)
    assert aware < 0.0025 and aware < 0.15 * point, (aware, point)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reflectance", "worst"),
    [
        ("vitreous.center.y", "schlick", 0.2),
        ("vitreous.radius", "schlick", 0.2),
        ("central.center.x", "schlick", 0.2),
        # Highlights are cut off where the light sets.
        ("topright.location.x", "schlick", 0.08),
        ("vitreous.center.y", "none", 0.2),
    ],
)
def test_derivative_pictures_see_edges(name, reflectance, worst):
    scene, how = assignment_scene(), dataclasses.replace(AWARE, reflectance=reflectance)
    derivative = picture_derivatives(scene, [name], how).values[0][INSIDE]
    expected = finite_differences(scene, [name], how, step=0.006, samples=12)[0][INSIDE]
    assert relative_error(derivative, expected) < worst


@pytest.mark.slow
def test_total_reflection_begins_at_an_edge():
    # From inside of a large ball: the critical angle is a circle on the picture, which shrinks as the index grows.
    inside = {"vitreous.ior": 2.2, "vitreous.center": (4.0, 3.0, 3.0), "vitreous.radius": 3.5}
    scene = set_parameters(assignment_scene(), inside)
    how = RenderSettings(size=(40, 30), reflectance="none", max_bounces=1, edges="aware")
    derivative = picture_derivatives(scene, ["vitreous.ior"], how).values[0]
    expected = finite_differences(scene, ["vitreous.ior"], how, step=0.006, samples=16)[0]
    assert relative_error(derivative, expected) < 0.3  # 0.22, and 0.90 if each ray is either in or out


@pytest.mark.slow
def test_no_pixel_spikes_at_critical_angle():
    # A ray of this pixel leaves the ball within 0.001 of the critical angle, after four bounces: there the derivative
    # of what one ray transmits has no limit, that of what its footprint transmits has.
    how = dataclasses.replace(AWARE, size=(96, 72), crop=(94, 52, 1, 1))
    derivative = picture_derivatives(assignment_scene(), ["vitreous.ior"], how).values[0]
    expected = finite_differences(assignment_scene(), ["vitreous.ior"], how, step=0.002, samples=32)[0]
    assert np.abs(derivative - expected).max() < 1.5  # By the footprint's middle alone it is 29.


@pytest.mark.slow
def test_scaling_from_the_eye_keeps_the_rim():
    """Only its ambient light, which falls off with the distance, changes: the derivative there has no rim."""
    scene = parse_scene(BALL)
    names = ("ball.center.x", "ball.center.z", "ball.radius")
    away = np.array([0.6, -7, 1.5]) / 7.2
    how = RenderSettings(edges="aware")
    found = np.tensordot(away, np.asarray(picture_derivatives(scene, names, how).values), 1)
    step, at = 0.02, np.array([4.6, -1, 1.5])

    def picture(values):
        moved = set_parameters(scene, dict(zip(names, values, strict=True)))
        return np.asarray(render(moved, RenderSettings(samples=48)).image)

    expected = (picture(at + step * away) - picture(at - step * away)) / (2 * step)
    assert relative_error(found, expected) < 0.01


SMALL = in_both_modes(resolved(size=(16, 12), edges="aware"), 170)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.integers(0, 2**31), st.sampled_from(AWKWARD))
def test_awkward_scenes_agree_in_both_modes(seed, what):
    assert faults_of(SMALL, awkward_scene(seed, what, (16, 12)), seed) == []


SETTINGS = RenderSettings(size=(48, 36), max_bounces=3, edges="point")
NAMES = ("vitreous.ior", "vitreous.center", "vitreous.radius", "central.center", "topright.location")
NAMES += ("cam1.viewpoint", "red.diffuse", "cyan.alpha", "rightwall.normal")


def test_smooth_derivatives_are_differences():
    scene = assignment_scene()
    found = picture_derivatives(scene, NAMES, SETTINGS)
    small, large = (finite_differences(scene, NAMES, SETTINGS, step, 1) for step in (1e-6, 2e-6))
    # Where an edge or a clamp crosses the pixel within the step, or a derivative is steep, the two steps disagree.
    smooth = np.abs(small - large) <= 1e-6 * (0.01 + np.abs(small))
    smooth[..., [0, -1]] = False  # there both walls meet z = 0 exactly: an edge in the pixel itself
    assert smooth.mean() > 0.85
    for name in NAMES:
        mine = [one.startswith(name) for one in found.names]
        assert np.sum(np.abs(small[mine][smooth[mine]]) > 1e-3) > 50, name  # it matters to many of them
    for name, derivative, difference, where in zip(found.names, found.values, small, smooth, strict=True):
        np.testing.assert_allclose(derivative[where], difference[where], rtol=1e-5, atol=1e-7, err_msg=name)


SHORT = in_both_modes(resolved(size=(48, 36), max_bounces=2, edges="point"), 8)
"""With room for both children of every ray: no scene can overflow it."""


@pytest.mark.slow
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_scenes_agree_in_both_modes(seed):
    assert faults_of(SHORT, random_scene(seed), seed, tolerance=1e-10) == []
