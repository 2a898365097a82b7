"""What no free number changes is compared with the target before a fit: own pictures whose camera is another."""

import dataclasses

import numpy as np
import pytest

from raytrace_jax import RenderSettings, fit, load_scene, render, set_parameters
from raytrace_jax.errors import PictureError, RaytraceWarning
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.inverse.judge.model_check import Cause, ModelCheck
from raytrace_jax.inverse.judge.still import compare_still
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.scene.bundled import scene_path
from raytrace_jax.tracer.settings import resolve_settings

FREE = ("glass.ior", "ball.center")
SETTINGS = RenderSettings(size=(80, 60))


@pytest.fixture(scope="module")
def scene():
    return load_scene(scene_path("ball"))


@pytest.fixture(scope="module")
def target(scene):
    moved = set_parameters(scene, {"glass.ior": 1.47, "ball.center": (0.1, -0.1, 0.1)})
    return np.asarray(render(moved, dataclasses.replace(SETTINGS, samples=4)).image)


def compared(scene, target, free=FREE, weights=None, **values):
    scene = set_parameters(scene, {name.replace("__", "."): value for name, value in values.items()})
    settings = resolve_settings(scene, SETTINGS)
    return compare_still(build_problem(scene, target, free, settings, FitOptions(), weights).problem, "aware", 1)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_right_camera_is_silent(scene, target, noise):
    noisy = target + noise * np.random.default_rng(0).normal(size=target.shape)
    assert not compared(scene, noisy)
    assert not compared(scene, 0.3 * noisy + 0.2)  # Another exposure.
    assert not compared(scene, target, glass__ior=1.9)


def test_a_wrong_angle_of_view_is_refused_before_the_search(scene, target):
    phases, wrong = [], set_parameters(scene, {"eye.fov": 40.0})
    with pytest.raises(PictureError, match=r"look first at the camera's numbers, eye\.fov, eye\.") as caught:
        fit(wrong, target, FREE, SETTINGS, on_phase=phases.append)
    assert "--free eye.fov" in str(caught.value) and len(phases) == 1


def test_a_doubtful_angle_of_view_warns_and_is_named_first(scene, target):
    with pytest.warns(RaytraceWarning, match="correlation with the picture at the start is 0\\.[3-7]"):
        words = compared(scene, target, eye__fov=33.7)
    check = dataclasses.replace(ModelCheck.nothing(1), displaced=words)
    cause = Cause("glass.emission.b", "", 1.0, "free it", 0.1, 9.0)
    assert dataclasses.replace(check, causes=(cause,)).looks.index("eye.fov") < check.looks.index("board and texture")
    assert "The residual looks like glass.emission.b" in dataclasses.replace(check, causes=(cause,)).looks


def test_what_may_move_or_does_not_count_is_not_compared(scene, target):
    assert not compared(scene, target, (*FREE, "eye.fov"), eye__fov=40.0)
    assert not compared(scene, target, (*FREE, "squares.square"), eye__fov=40.0)
    middle = np.zeros(target.shape[1:])
    middle[20:40, 30:50] = 1
    assert not compared(scene, target, weights=middle, eye__fov=40.0)
