"""A picture whose settings say nothing of edges: its values are those of points, its derivatives those of areas."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import raytrace_jax as rj
from raytrace_jax.tracer.derivatives import finite_differences, relative_error

DISC = """camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 } material white { ambient 4 3 2 }
light lamp { location 4 3 3 emissivity 1 1 1 } sphere ball { material white center 4 3 -2 radius 2 }"""
NAMES = ("ball.radius", "ball.center.x")
FLAT = rj.RenderSettings(max_bounces=0)
SHADE = np.linspace(0.2, 1, 24)
"""Weights of columns, so that a disc that moves aside changes their sum."""


def at(scene, values):
    return rj.set_parameters(scene, dict(zip(NAMES, values, strict=True)))


@pytest.mark.slow
def test_forward_and_reverse_mode_contain_the_motion_of_edges_and_the_picture_is_that_of_points():
    scene = rj.parse_scene(DISC)
    renderer, start = rj.make_renderer(scene, FLAT), jnp.asarray([2.0, 4.0])

    def brightness(values):
        return jnp.mean(renderer(at(scene, values)).image * jnp.asarray(SHADE))

    value, reverse = jax.jit(jax.value_and_grad(brightness))(start)
    forward = jax.jit(jax.jacfwd(brightness))(start)
    points = rj.render(scene, dataclasses.replace(FLAT, edges="point")).image
    np.testing.assert_allclose(value, np.mean(np.asarray(points) * SHADE), rtol=1e-12)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    differences = finite_differences(scene, NAMES, FLAT, step=0.03, samples=32)
    np.testing.assert_allclose(forward, np.mean(differences * SHADE, axis=(1, 2, 3)), rtol=0.02)
    found = rj.picture_derivatives(scene, NAMES, FLAT)
    assert all(relative_error(*both) < 0.3 for both in zip(found.values, differences, strict=True))
    np.testing.assert_allclose(found.image, points, atol=1e-12)
    np.testing.assert_allclose(np.mean(found.values * SHADE, axis=(1, 2, 3)), forward, rtol=1e-9)

    # Who asks for points gets the derivative of points: a disc of one colour that grows changes nothing.
    blind = rj.picture_derivatives(scene, NAMES, dataclasses.replace(FLAT, edges="point"))
    assert np.abs(np.mean(blind.values[0])) < 0.3 * np.abs(np.mean(found.values[0]))


@pytest.mark.slow
def test_aovs_are_differentiated_as_points():
    scene = rj.parse_scene(DISC)
    settings = dataclasses.replace(FLAT, aov=("depth",))
    found = []
    for how in (settings, dataclasses.replace(settings, edges="point")):
        renderer = rj.make_renderer(scene, how)

        def depth(values, renderer=renderer):
            found = renderer(at(scene, values)).aov["depth"]
            return jnp.sum(jnp.where(found < 100, found, 0))

        found.append(jax.jit(jax.grad(depth))(jnp.asarray([2.0, 4.0])))
    assert np.abs(found[0]).max() > 1
    np.testing.assert_allclose(*found, rtol=1e-9)


@pytest.mark.slow
def test_the_derivative_that_the_readme_shows_is_right():
    scene = rj.load_scene("vitreous")
    settings = rj.RenderSettings(size=(160, 120))
    renderer = rj.make_renderer(scene, settings)
    found = jax.jit(jax.grad(lambda scene: renderer(scene).image.mean()))(scene)["vitreous.center"]
    names = [f"vitreous.center.{axis}" for axis in "xyz"]
    differences = finite_differences(scene, names, settings, samples=16).mean(axis=(1, 2, 3))
    # Points say (-0.0138, +0.0022, +0.0017), the wrong sign at last.
    np.testing.assert_allclose(differences, [-0.0134, 0.0074, -0.0104], atol=2e-4)
    np.testing.assert_allclose(found, differences, atol=6e-4)
