"""A renderer inside of JAX's transformations: when it has to grow, and its derivatives, by default those of areas."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiles import counted_compiles
from scenes import assignment_scene, resolved

import raytrace_jax as rj
from raytrace_jax import Renderer, SceneError, load_scene, make_renderer, render, set_parameters
from raytrace_jax.tracer.derivatives import finite_differences, relative_error
from raytrace_jax.tracer.run import Capacity

SETTINGS = resolved(size=(16, 12), crop=(1, 0, 14, 12), max_bounces=1, edges="point")
"""Without the first and the last column, in which rounding decides which wall is seen."""


@pytest.fixture(scope="module")
def renderer():
    return make_renderer(assignment_scene(), SETTINGS)


def moved(scene, ior):
    return set_parameters(scene, {"vitreous.ior": ior})


def test_a_renderer_renders_what_render_does(renderer):
    scene = moved(assignment_scene(), 1.6)
    np.testing.assert_allclose(renderer(scene).image, render(scene, SETTINGS).image, atol=1e-12)


def test_a_scene_of_another_model_is_refused(renderer):
    other = load_scene("glass_on_board")
    with pytest.raises(
        SceneError, match="made with a scene of the classic model, and this scene is of the physical one"
    ):
        renderer(other)


@pytest.mark.slow
def test_it_works_under_transformations(renderer):
    scene = assignment_scene()

    def brightness(ior):
        return renderer(moved(scene, ior)).image.mean()

    value, slope = jax.jit(jax.value_and_grad(brightness))(jnp.asarray(1.5))
    _, forward = jax.jvp(jax.jit(brightness), (jnp.asarray(1.5),), (jnp.ones(()),))
    np.testing.assert_allclose(slope, forward, rtol=1e-10)
    many = jax.jit(jax.vmap(brightness))(jnp.asarray([1.4, 1.5]))
    np.testing.assert_allclose(many[1], value, rtol=1e-12)
    step = 1e-6
    difference = (brightness(jnp.asarray(1.5 + step)) - brightness(jnp.asarray(1.5 - step))) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)


@pytest.mark.slow
def test_an_unjitted_gradient_compiles_once(renderer):
    scene = assignment_scene()
    gradient = jax.grad(lambda ior: renderer(moved(scene, ior)).image.mean())
    with counted_compiles() as compiles:
        first = gradient(jnp.asarray(1.5))
    # Forward and back, and small ones for what stands around the picture; thousands if its operations were programs.
    assert compiles.count("jit(pure_picture)") == 2 and len(compiles) < 50
    with counted_compiles() as compiles:
        second = gradient(jnp.asarray(1.6))
    assert not compiles and first != second


@pytest.mark.slow
def test_it_grows_where_rays_lack_room():
    scene = assignment_scene()
    settings = dataclasses.replace(SETTINGS, size=(48, 36), crop=(20, 13, 14, 12), max_bounces=3)
    tight = Renderer(settings, Capacity(192, 48), "classic")
    film = jax.jit(tight)(scene)
    assert film.overflow > 0
    assert np.abs(np.asarray(film.image - render(scene, settings).image)).max() > 0.01
    assert tight.grow(scene) and not tight.grow(scene)
    assert jax.jit(lambda scene: tight(scene))(scene).overflow == 0
    np.testing.assert_allclose(tight(scene).image, render(scene, settings).image, atol=1e-12)


def test_it_is_made_outside_transformations():
    with pytest.raises(ValueError, match="outside of JAX's transformations"):
        jax.jit(lambda scene: make_renderer(scene, SETTINGS)(scene).image)(assignment_scene())
    with pytest.raises(ValueError, match=r"crop \(10, 10, 10, 10\).*16 x 12"):
        make_renderer(assignment_scene(), dataclasses.replace(SETTINGS, crop=(10, 10, 10, 10)))


DISC = """camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 } material white { ambient 4 3 2 }
light lamp { location 4 3 3 emissivity 1 1 1 } sphere ball { material white center 4 3 -2 radius 2 }"""
NAMES = ("ball.radius", "ball.center.x")
FLAT = rj.RenderSettings(max_bounces=0)
SHADE = np.linspace(0.2, 1, 24)
"""Weights of columns, so that a disc that moves aside changes their sum."""


def at(scene, values):
    return rj.set_parameters(scene, dict(zip(NAMES, values, strict=True)))


@pytest.mark.slow
def test_both_modes_contain_moving_edges():
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
def test_the_readmes_derivative_is_right():
    scene = rj.load_scene("vitreous")
    settings = rj.RenderSettings(size=(160, 120))
    renderer = rj.make_renderer(scene, settings)
    found = jax.jit(jax.grad(lambda scene: renderer(scene).image.mean()))(scene)["vitreous.center"]
    names = [f"vitreous.center.{axis}" for axis in "xyz"]
    differences = finite_differences(scene, names, settings, samples=16).mean(axis=(1, 2, 3))
    # Points say (-0.0138, +0.0022, +0.0017), the wrong sign at last.
    np.testing.assert_allclose(differences, [-0.0134, 0.0074, -0.0104], atol=2e-4)
    np.testing.assert_allclose(found, differences, atol=6e-4)
