"""A renderer and the pure picture inside of JAX's transformations, and when a renderer has to grow."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiles import counted_compiles
from scenes import assignment_scene, resolved

from raytrace_jax import Renderer, SceneError, load_scene, make_renderer, picture_derivatives, render, set_parameters
from raytrace_jax.tracer.pure import pure_picture
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
def test_it_works_under_jit_grad_jvp_and_vmap(renderer):
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
def test_a_gradient_without_jit_around_it_is_a_few_programs_and_the_next_one_none(renderer):
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


def test_it_is_made_outside_of_transformations():
    with pytest.raises(ValueError, match="outside of JAX's transformations"):
        jax.jit(lambda scene: make_renderer(scene, SETTINGS)(scene).image)(assignment_scene())
    with pytest.raises(ValueError, match="crop"):
        make_renderer(assignment_scene(), dataclasses.replace(SETTINGS, crop=(10, 10, 10, 10)))


EDGES = resolved(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=1, edges="aware")


@pytest.mark.slow
def test_edge_aware_pictures_and_derivatives_do_not_depend_on_room_and_both_modes_agree():
    scene, room = assignment_scene(), Capacity(1024, 48)

    def picture(index):
        film = pure_picture(set_parameters(scene, {"vitreous.ior": index}), EDGES, room)
        return film.image, film.overflow

    @jax.jit
    def in_both_modes(index):
        image, change, overflow = jax.jvp(picture, (index,), (jnp.ones(()),), has_aux=True)
        return image, change, jax.grad(lambda index: jnp.sum(picture(index)[0] ** 2))(index), overflow

    image, change, backward, overflow = in_both_modes(jnp.asarray(1.36))
    assert overflow == 0
    np.testing.assert_allclose(backward, 2 * np.sum(image * change), rtol=1e-9)
    found = picture_derivatives(set_parameters(scene, {"vitreous.ior": 1.36}), ["vitreous.ior"], EDGES)
    np.testing.assert_allclose(image, found.image, atol=1e-11)
    np.testing.assert_allclose(change, found.values[0], rtol=1e-8, atol=1e-9)
