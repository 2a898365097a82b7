"""Course model A against a plain recursive restatement of it that shares no code with the package."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy_tracer import NumpyTracer
from scenes import assignment_scene, random_scene, rows_last

from raytrace_jax import render, set_parameters
from raytrace_jax.tracer.settings import ResolvedSettings

SIZE = (48, 36)
SEEDS = st.integers(0, 2**32 - 1)


def assert_same_picture(scene, render_settings, most_ties=4):
    """Both tracers agree to rounding, except in the few pixels where a tie is decided by it."""
    picture = rows_last(render(scene, render_settings).image)
    expected = NumpyTracer(scene, render_settings).image()
    # The walls of the assignment's scene meet z = 0 exactly in the first and last column: rounding decides there.
    error = np.abs(picture - expected).max(-1)[:, 1:-1]
    assert expected.max() <= 1 and expected.min() >= 0
    assert np.sum(error > 1e-9) <= most_ties, f"{np.sum(error > 1e-9)} pixels differ, by up to {error.max():.3g}"
    return expected


BASE = ResolvedSettings(size=SIZE, max_bounces=3, edges="point")


@pytest.mark.fast_cases(4)
@pytest.mark.parametrize(
    "switches",
    [
        {"max_bounces": 5},
        {"reflectance": "none", "max_bounces": 5},
        {"reflectance": "none", "eta": "physical"},
        {"eta": "physical"},
        {"total_internal_reflection": False},
        {"second_root": False},
        {"reflection": False},
        {"max_bounces": 0},
    ],
    ids=lambda switches: " ".join(f"{name}={value}" for name, value in switches.items()),
)
def test_the_assignment_agrees_by_any_switch(switches):
    scene = assignment_scene()
    switched = dataclasses.replace(BASE, **switches)
    picture = assert_same_picture(scene, switched)
    # The switch does something: the picture is not the base one.
    assert np.abs(picture - NumpyTracer(scene, BASE).image()).max() > 1e-4


@pytest.mark.slow
@settings(max_examples=25)
@given(seed=SEEDS, schlick=st.booleans(), physical=st.booleans())
@example(seed=1, schlick=True, physical=False)
def test_random_glass_and_mirrors_agree(seed, schlick, physical):
    chosen = dataclasses.replace(
        BASE, reflectance="schlick" if schlick else "none", eta="physical" if physical else "course"
    )
    assert_same_picture(random_scene(seed), chosen)


@settings(max_examples=10)
@given(seed=SEEDS)
def test_random_scenes_agree_inside_glass(seed):
    assert_same_picture(random_scene(seed, camera_inside=True), BASE)


@pytest.mark.slow
def test_a_path_longer_than_100_is_black():
    scene = set_parameters(assignment_scene(), {"leftwall.point": [-150.0, 0.0, 0.0], "rightwall.point": [60.0, 0, 0]})
    picture = assert_same_picture(scene, BASE)
    assert np.mean(picture[:, 0].max(-1) == 0) > 0.5  # the far left wall


def test_without_lights_ambient_light_shows():
    picture = assert_same_picture(random_scene(3, lights=0), BASE)
    assert picture.max() > 0
