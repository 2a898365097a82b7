"""Points in batches, whose room changes no picture; how often JAX traces a level, and how large programs are."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from posing import posed_problem
from scenes import assignment_scene, resolved

from raytrace_jax import picture_derivatives, render, set_parameters
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer import batches, level, pixels
from raytrace_jax.tracer.pixels import differentiate_batches, picture_pixels, pixel_colors

SETTINGS = resolved(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=2, edges="point")
"""Without the first and the last column, in which rounding decides which wall is seen."""


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edges", ["point", "aware"])
def test_little_room_gives_the_same_picture(edges, monkeypatch):
    scene = assignment_scene()
    points, step = picture_pixels(scene, SETTINGS)
    pictures = []
    for rays in (8192, 256):
        monkeypatch.setattr(batches, "QUEUE", {"point": rays, "aware": rays})
        stacked = map_scenes(lambda x: np.asarray(x)[None], scene)
        pictures.append(pixel_colors(stacked, points, SETTINGS, None if edges == "point" else step)[0])
    np.testing.assert_allclose(*pictures, atol=1e-12)
    if edges == "point":
        np.testing.assert_allclose(pictures[0], np.asarray(render(scene, SETTINGS).image).reshape(3, -1), atol=1e-12)


def test_derivatives_are_traced_until_no_pixel_lacks_room():
    scene = assignment_scene()
    little, enough = (
        picture_derivatives(
            scene, ["vitreous.radius"], dataclasses.replace(SETTINGS, edges="aware", rays_per_pixel=rays)
        )
        for rays in (1.0, None)
    )
    np.testing.assert_allclose(little.image, enough.image, atol=1e-12)
    np.testing.assert_allclose(little.values, enough.values, atol=1e-10)


def test_other_renders_change_nothing():
    scenes = [set_parameters(assignment_scene(), {"vitreous.radius": radius}) for radius in (1.0, 2.0)]
    first = [np.asarray(render(scene, SETTINGS).image) for scene in scenes]
    with ThreadPoolExecutor(4) as threads:
        again = list(threads.map(lambda scene: np.asarray(render(scene, SETTINGS).image), 4 * scenes))
    for number, image in enumerate(again):
        np.testing.assert_array_equal(image, first[number % 2])


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("edges", "name"), [("point", "point_level"), ("aware", "area_level")])
def test_a_level_is_traced_once_or_twice(edges, name, monkeypatch):
    calls, usual = [], getattr(level, name)

    def counted(*arguments):
        calls.append(name)
        return usual(*arguments)

    monkeypatch.setattr(level, name, counted)
    how = resolved(size=(26, 14), max_bounces=2, edges=edges, samples=2)
    scene = assignment_scene()  # Kept by the tests: it must not be made while JAX traces.

    def image(ior):
        return render(set_parameters(scene, {"vitreous.ior": ior}), how).image

    def derivative(direction):
        return jax.jvp(image, (jnp.asarray(1.4),), (direction,))

    # Once of the values and once of the derivative's rule, which JAX runs with another of its settings.
    jax.make_jaxpr(jax.vmap(derivative))(jnp.eye(2)[0])
    assert len(calls) <= 2
    jax.make_jaxpr(jax.grad(lambda ior: image(ior).sum()))(jnp.asarray(1.4))
    assert len(calls) <= 2


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("edges", "most"), [("point", 4_100), ("aware", 8_400)])
def test_the_largest_program_does_not_grow(edges, most, monkeypatch):
    """3,700 and 7,600 lines of StableHLO today. Who needs more should see what a first fit takes then."""
    programs = []

    def lower(*arguments):
        program = jax.jit(differentiate_batches.function, static_argnums=(3, 4, 5)).lower(*arguments)
        programs.append(program.as_text().count("\n"))
        raise KeyboardInterrupt  # Nobody needs the picture.

    monkeypatch.setattr(pixels, "differentiate_batches", lower)
    how, free = resolved(size=(16, 12), edges=edges), ["vitreous.ior", "vitreous.center"]
    target = np.random.default_rng(0).random((3, 12, 16))
    problem = posed_problem(assignment_scene(), target, free, how)
    with pytest.raises(KeyboardInterrupt):
        problem.picture(problem.start(), edges)
    assert most / 2 < programs[0] < most
