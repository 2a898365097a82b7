"""Derivatives of pictures: against differences where the picture is smooth, forward against reverse, never NaN."""

import numpy as np
import pytest
from awkward_physical import faults_of, in_both_modes
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assignment_scene, random_scene, resolved

from raytrace_jax import RenderSettings, picture_derivatives
from raytrace_jax.tracer.derivatives import finite_differences
from raytrace_jax.tracer.run import Capacity

SIZE = (48, 36)
SETTINGS = RenderSettings(size=SIZE, max_bounces=3, edges="point")
NAMES = (
    "vitreous.ior",
    "vitreous.center",
    "vitreous.radius",
    "central.center",
    "topright.location",
    "cam1.viewpoint",
    "red.diffuse",
    "cyan.alpha",
    "rightwall.normal",
)


def test_derivatives_equal_central_differences_where_the_picture_is_smooth():
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


SHORT = in_both_modes(resolved(size=SIZE, max_bounces=2, edges="point"), Capacity(8 * 1728, 1728))
"""With room for both children of every ray: no scene can overflow it."""


@pytest.mark.slow
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_scenes_have_finite_derivatives_that_agree(seed):
    assert faults_of(SHORT, random_scene(seed), seed, tolerance=1e-10) == []
