"""Derivatives of glass before a checkered board: edge-aware ones beside differences of supersampled pictures."""

from pathlib import Path

import pytest

from raytrace_jax import RenderSettings, load_scene, picture_derivatives
from raytrace_jax.tracer.derivatives import correlation, finite_differences, relative_error

SCENE = Path(__file__).parent.parent / "experiments" / "edge_gradients" / "scenes" / "checker.txt"
STEPS = {
    "ball0.ior": 4e-3,
    "ball0.center.y": 2e-3,
    "backdrop.center.z": 1.6e-2,
    "eye.fov": 0.1,
    "ball0.absorption.g": 0.01,
}
"""So short that no edge seen through the ball moves by half a pixel: it shows the board's lines magnified."""

pytestmark = [pytest.mark.slow, pytest.mark.optimized]


def test_derivatives_are_those_of_supersampled_pictures():
    scene, settings = load_scene(SCENE), RenderSettings(size=(64, 48), max_bounces=8)
    aware = picture_derivatives(scene, list(STEPS), RenderSettings(size=(64, 48), max_bounces=8, edges="aware"))
    for name, values in zip(STEPS, aware.values, strict=True):
        reference = finite_differences(scene, [name], settings, step=STEPS[name], samples=40)[0]
        assert correlation(values, reference) > 0.95, name
        assert relative_error(values, reference) < 0.3, name
