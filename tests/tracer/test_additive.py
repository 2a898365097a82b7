"""The additive model against a plain recursive restatement of it, and its derivatives, with those of shadow edges."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy_additive import NumpyAdditive
from scenes import DATA, numbers, random_ball, random_plane, sphere

import raytrace_jax as rj
from raytrace_jax.report.differences import correlation, finite_differences, relative_error
from raytrace_jax.tracer.settings import ResolvedSettings

SIZE = (24, 18)
HOW = rj.RenderSettings(size=SIZE, model="additive", edges="point")
BALL = """
camera eye { pixeldim 48 36 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 2.5 5.5 1 emissivity 1 .9 .8 energy 25 }
material matt { diffuse .7 .6 .5 specular 0 0 0 }
material ball { diffuse .2 .3 .6 hardness 40 reflectivity .3 }
plane ground { material matt normal 0 1 0 point 0 0 0 }
sphere ball { material ball center 4.2 2.1 -2 radius 1.1 }
"""


def checkpoints():
    return rj.load_scene(DATA / "checkpoints.txt", model="additive")


def random_scene(seed, planes=2, spheres=3):
    """Shapes of every kind of surface; one light may stand inside of a sphere."""
    random = np.random.default_rng(seed)
    camera = np.array([4, 3, 6]) + random.uniform(-1, 1, 3)
    blocks = [f"camera eye {{ pixeldim {SIZE[0]} {SIZE[1]} worlddim 8 6 viewpoint {numbers(camera)} }}"]
    shapes = [random_plane(random, i) for i in range(planes)]
    for i in range(planes, planes + spheres):
        center, radius = random_ball(random)
        shapes.append(sphere(i, center, radius))
    for i in range(2):
        location = center + random.normal(size=3) * 0.1 if i == 1 else random.uniform([-2, 0, -6], [10, 6, 4])
        emissivity, energy = random.uniform(0, 1, 3), random.uniform(0, 20, 1)
        blocks.append(
            f"light l{i} {{ location {numbers(location)} emissivity {numbers(emissivity)} energy {numbers(energy)} }}"
        )
    for i in range(planes + spheres):
        ambient, diffuse, specular = random.uniform(0, 1, (3, 3))
        reflectivity, transmission = random.uniform(0, 1, 2) * random.integers(0, 2, 2)
        ior, hardness = random.choice([random.uniform(0.6, 2.4), 1.0]), random.uniform(0, 300)
        blocks.append(
            f"material m{i} {{ ambient {numbers(ambient)} diffuse {numbers(diffuse)} specular {numbers(specular)}"
            f" ior {numbers([ior])} hardness {numbers([hardness])} reflectivity {numbers([reflectivity])}"
            f" fresnel {random.integers(0, 2)} transmission {numbers([transmission])} }}"
        )
    return rj.parse_scene("\n".join([*blocks, *shapes]), model="additive")


def assert_same_picture(scene, depth, most_ties):
    """Both tracers agree to rounding, except in the few pixels where a tie is decided by it."""
    how = rj.RenderSettings(size=SIZE, model="additive", max_bounces=depth, edges="point")
    found = np.asarray(rj.render(scene, how).image)
    error = np.abs(found - NumpyAdditive(scene, depth).image(*SIZE)).max(0)
    assert np.sum(error > 1e-9) <= most_ties, f"{np.sum(error > 1e-9)} pixels differ, by up to {error.max():.3g}"
    return found


def test_the_scene_of_the_checkpoints():
    found = assert_same_picture(checkpoints(), 4, most_ties=0)
    assert found.max() > 1e-2 and ResolvedSettings(model="additive").max_bounces == 2


@pytest.mark.slow
@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), depth=st.sampled_from([1, 3]))
@example(seed=1, depth=3)
def test_random_scenes(seed, depth):
    assert_same_picture(random_scene(seed), depth, most_ties=3)


def test_omitted_numbers_have_model_defaults():
    text = "camera c { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"
    text += " light l { location 0 0 0 emissivity 1 1 1 } material m { }"
    scene, classic = rj.parse_scene(text, model="additive"), rj.parse_scene(text)
    expected = {"diffuse": 0.78, "specular": 0.2, "ambient": 0.05, "ior": 1.45}
    for name, value in expected.items():
        np.testing.assert_allclose(scene[f"m.{name}"], value)
        assert np.all(np.asarray(classic[f"m.{name}"]) == (name == "ior"))
    own = {"hardness": 1000, "reflectivity": 0, "fresnel": 0, "transmission": 0}
    for read in (scene, classic):
        assert all(float(read[f"m.{name}"]) == value for name, value in own.items())
        assert float(read["l.energy"]) == 10
    assert "diffuse" not in rj.format_scene(scene, model="additive") and "0.78" in rj.format_scene(scene)
    again = rj.parse_scene(rj.format_scene(scene), model="additive")
    assert rj.format_scene(again) == rj.format_scene(scene)


@pytest.mark.slow
def test_the_switch_of_the_mirror_ray():
    scene = checkpoints()
    without = rj.render(scene, rj.RenderSettings(size=SIZE, model="additive", reflection=False)).image
    dull = {f"{name}.{what}": 0.0 for name in scene.materials.names for what in ("reflectivity", "fresnel")}
    lit = rj.render(rj.set_parameters(scene, dull), HOW).image
    assert np.abs(np.asarray(rj.render(scene, HOW).image - without)).max() > 0.05
    # Glass lets more through where it reflects nothing.
    assert np.all(np.asarray(lit - without) >= -1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("edges", ["point", pytest.param("aware", marks=pytest.mark.slow)])
def test_derivatives_agree_in_both_modes(edges):
    scene = rj.parse_scene(BALL.replace("reflectivity .3", "fresnel 1 transmission .6"), model="additive")
    how = rj.RenderSettings(size=SIZE, model="additive", max_bounces=1, edges=edges)
    renderer = functools.partial(rj.render, settings=how)

    def loss(scene):
        return jnp.sum(renderer(scene).image ** 2)

    @jax.jit
    def both(scene, tangent):
        return jax.jvp(loss, (scene,), (tangent,))[1], jax.grad(loss)(scene)

    tangent = jax.tree.map(lambda x: jnp.ones_like(x), scene)
    forward, gradient = both(scene, tangent)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    products = [float(jnp.vdot(a, b)) for a, b in zip(*map(jax.tree.leaves, (gradient, tangent)), strict=True)]
    assert sum(products) == pytest.approx(float(forward), rel=1e-9, abs=1e-9 * sum(map(abs, products)))


SMOOTH = (
    "glass.ior", "glass.transmission", "floor.reflectivity", "lacquer.ior", "lacquer.fresnel", "mirror.hardness",
    "mirror.reflectivity", "floor.diffuse.r", "wall.ambient.g", "mirror.specular.b", "lamp.energy",
    "window.emissivity.r",
)  # fmt: skip


@pytest.mark.slow
def test_point_derivatives_are_differences():
    scene = rj.set_parameters(checkpoints(), {"lacquer.fresnel": 0.9})  # differences need room on both sides
    found = np.asarray(rj.picture_derivatives(scene, SMOOTH, HOW).values)
    step = 1e-5
    for name, derivative in zip(SMOOTH, found, strict=True):
        at = float(scene[name])
        ends = [rj.render(rj.set_parameters(scene, {name: at + sign * step}), HOW).image for sign in (-0.5, 0.5)]
        difference = np.asarray(ends[1] - ends[0]) / step
        # Refracted edges may cross a sample; nothing else may differ.
        wrong = np.abs(difference - derivative).max(0) > 1e-5 * (1 + np.abs(difference).max(0))
        assert wrong.sum() <= (3 if name == "glass.ior" else 0), name
        assert np.abs(derivative).max() > 0, name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lamp.location.x", "ball.center.x", "ball.radius"])
def test_derivatives_see_shadow_edges(name):
    scene = rj.parse_scene(BALL, model="additive")
    how = rj.RenderSettings(model="additive", edges="aware", max_bounces=1)
    found = rj.picture_derivatives(scene, [name], how).values[0]
    expected = finite_differences(scene, [name], how, 0.02, 16)[0]
    blind = rj.picture_derivatives(scene, [name], dataclasses.replace(how, edges="point")).values[0]
    assert relative_error(found, expected) < 0.15 and correlation(found, expected) > 0.98
    assert relative_error(blind, expected) > 0.3
