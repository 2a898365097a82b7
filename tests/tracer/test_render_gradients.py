"""Derivatives of pictures: against differences where the picture is smooth, forward against reverse, never NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assignment_scene, random_scene, resolved

from raytrace_jax import Renderer, RenderSettings, picture_derivatives
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


SHORT = Renderer(resolved(size=SIZE, max_bounces=2, edges="point"), Capacity(8 * 1728, 1728), "classic")
"""With room for both children of every ray: no scene can overflow it."""


@jax.jit
def both_modes(scene, tangent, weights):
    value, change = jax.jvp(lambda scene: SHORT(scene).image, (scene,), (tangent,))
    _, pull = jax.vjp(lambda scene: SHORT(scene).image, scene)
    return value, change, pull(weights)[0]


@pytest.mark.slow
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_scenes_have_finite_derivatives_that_agree(seed):
    scene = random_scene(seed)
    random = np.random.default_rng(seed)
    tangent = jax.tree.map(lambda x: jnp.asarray(random.normal(size=x.shape)), scene)
    weights = jnp.asarray(random.normal(size=(3, *SIZE[::-1])))
    value, change, gradient = both_modes(scene, tangent, weights)
    for leaf in jax.tree.leaves((value, change, gradient)):
        assert np.isfinite(leaf).all()
    terms = [float(jnp.vdot(g, v)) for g, v in zip(jax.tree.leaves(gradient), jax.tree.leaves(tangent), strict=True)]
    scale = float(jnp.sum(jnp.abs(weights * change))) + sum(map(abs, terms))
    np.testing.assert_allclose(sum(terms), float(jnp.vdot(weights, change)), atol=1e-11 * scale)
