"""The physical model against the plain tracer, against POV-Ray, against laws; its derivatives; and never NaN."""

import dataclasses
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import numpy_physical
import physical_scenes
import pictured_scenes
import pytest
from awkward_physical import AWKWARD, both_modes, faults
from physical_scenes import Camera, Image, Light, Material, Rectangle, Scene, Sphere
from scenes import scaled_scene

import raytrace_jax as rj
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer.pixels import pixel_colors
from raytrace_jax.tracer.settings import ResolvedSettings, resolve_settings

PICTURES = Path(__file__).parents[1] / "physical_pictures"
EYE = Camera((24, 18), (0.3, 0.2, 5), (0, 0, 0), (0, 1, 0), 30)
GLASS = Material(transmission=1, ior=1.5)
PAINTED = Image(np.random.default_rng(3).uniform(0.1, 0.9, (5, 6, 3)).astype(np.float32))


@pytest.fixture
def as_scene(tmp_path):
    """From a plain description, by way of files, to a scene."""

    def read(description):
        physical_scenes.write_images(description, tmp_path)
        (tmp_path / "scene.txt").write_text(physical_scenes.scene_text(description))
        return rj.load_scene(tmp_path / "scene.txt", dtype=np.float64)

    return read


def assert_same(scene, description, most_pixels=0.005):
    """All pixels but a few, whose rays meet an edge to the last digit, are the plain tracer's to 1e-9."""
    difference = abs(np.asarray(rj.render(scene).image) - numpy_physical.picture(description)).max(axis=0)
    assert np.isfinite(difference).all()
    assert np.mean(difference > 1e-9) <= most_pixels, f"{np.sort(difference.ravel())[-20:]}"


@pytest.mark.parametrize(
    ("seed", "disperse"),
    [(0, False), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((1, False), (2, False), (0, True)))],
)
def test_random_scenes_are_the_plain_tracers(as_scene, seed, disperse):
    description = physical_scenes.random_scene(
        np.random.default_rng(seed), size=(24, 18), images=True, disperse=disperse, least_weight=0, max_bounces=4
    )
    assert_same(as_scene(description), description)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lights", "dispersion", "nested", "absorption", "sky"])
def test_foreign_scenes_match_plain_tracer(as_scene, name):
    description = dataclasses.replace(getattr(pictured_scenes, name)(), least_weight=0)
    assert_same(as_scene(description), description)


@pytest.mark.slow
def test_is_what_pov_ray_renders(as_scene):
    scene, pixels = as_scene(pictured_scenes.squares()), np.load(PICTURES / "pov_checker.npz")
    u, v = (pixels["x"] + 0.5) / 640, 1 - (pixels["y"] + 0.5) / 480
    seen = pixel_colors(map_scenes(lambda x: x[None], scene), np.stack([u, v]), resolve_settings(scene))[0]
    difference = abs(seen.T - pixels["radiance"]).max(axis=1)
    assert np.mean(difference > 2e-5) < 0.01
    assert np.mean(difference > 1e-3) < 0.003
    assert difference.max() < 0.05


def lit(*shapes, **more):
    """Shapes before a lit board, under a sky."""
    board = Rectangle(Material(emission=(1, 1, 1), texture=PAINTED), (0, 0, -2), (3, 0, 0), (0, 3, 0))
    return Scene(EYE, [board, *shapes], radiance=(0.2, 0.3, 0.4), **more)


def test_a_contradictory_file_is_refused():
    said = "settings main { model additive reflectance none least_weight 0.1 }\n"
    text = said + "camera eye { pixeldim 4 3 viewpoint 0 0 5 lookat 0 0 0 fov 40 }"
    scene = rj.parse_scene(text)
    with pytest.raises(ValueError, match=r"a meaning only in the (classic|physical) model"):
        resolve_settings(scene)
    with pytest.warns(rj.RaytraceWarning, match="loaded as additive and is rendered as classic"):
        assert resolve_settings(scene, rj.RenderSettings(model="classic")) == ResolvedSettings(reflectance="none")
    scene = rj.parse_scene(text, model="physical")
    assert resolve_settings(scene, rj.RenderSettings(samples=2)) == ResolvedSettings(
        model="physical", least_weight=0.1, samples=2
    )


@pytest.mark.slow
def test_a_white_furnace_is_white(as_scene):
    balls = [Sphere(GLASS, (0, 0, 0), 1), Sphere(Material(transmission=1, ior=1.8), (0.2, 0.1, 0.3), 0.4)]
    scene = as_scene(Scene(EYE, balls, radiance=(1, 1, 1), max_bounces=16))
    seen = np.asarray(rj.render(scene).image)
    assert seen.max() < 1 + 1e-12
    assert np.median(1 - seen) < 1e-6
    # Paths that hardly count are left out, and no more is missing than they count for.
    few = np.asarray(rj.render(scene, rj.RenderSettings(least_weight=1e-3)).image)
    assert 1e-6 < (seen - few).max() < 0.02
    assert (seen - few).min() >= 0


BEFORE_A_BOARD = """camera eye { pixeldim 16 12 viewpoint 0 0 5 lookat 0.1 0.2 0 fov 30 }
texture squares { kind checker color1 0.1 0.2 0.3 color2 0.9 0.8 0.7 square 0.5 }
material board { emission 1 1 1 texture squares } rectangle wall { material board center 0 0 -3 right 4 0 0 up 0 4 0 }
material crown { transmission 1 ior 1.5 } material water { transmission 1 ior 1.3 }
material air { transmission 1 ior 1 }
"""
BALL = "sphere ball { material crown center 0.1 -0.1 0.2 radius 1 }"
COPY = "sphere copy { material water center 0.1 -0.1 0.2 radius 1 }"
LAKE = "plane lake { material water normal 0.1 0.2 1 point 0 0 0 }"


@pytest.mark.parametrize(
    ("shapes", "same"),
    [
        # Oil that touches the lake, and oil that would fill it, were the lake not the first.
        ("plane oil { material crown normal -0.1 -0.2 -1 point 0.2 -0.1 0 }", ("0.2 -0.1 0 }", "0 0 -99 }")),
        # Oil of the lake's own surface, and oil far beneath it.
        ("plane oil { material crown normal 0.2 0.4 2 point 0.2 -0.1 0 }", ("0.2 -0.1 0 }", "0 0 -99 }")),
        # The same ball twice, and a second one behind the wall.
        (COPY + BALL, (BALL, BALL.replace("0.2 radius", "-9 radius"))),
        # A wall of glass that is too thin to be seen, and one of air.
        (COPY.replace("water", "air").replace("radius 1", "radius 0.99999999") + BALL, ("crown", "air")),
    ],
)
def test_coincident_surfaces_cross_together(shapes, same):
    lake = "" if "ball" in shapes else LAKE
    pictures = [
        rj.render(rj.parse_scene(BEFORE_A_BOARD + lake + some, model="physical")).image
        for some in (shapes, shapes.replace(*same))
    ]
    np.testing.assert_allclose(*pictures, rtol=1e-5)


@pytest.mark.slow
def test_a_copied_ball_has_own_derivatives():
    """An edge between two surfaces that coincide would be anywhere."""
    settings, names = rj.RenderSettings(edges="aware"), ["ball.ior", "ball.center"]
    one, two = (
        rj.picture_derivatives(rj.parse_scene(BEFORE_A_BOARD + some, model="physical"), names, settings)
        for some in (BALL, BALL + COPY)
    )
    np.testing.assert_allclose(two.image, one.image, rtol=1e-5)
    np.testing.assert_allclose(two.values, one.values, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_glass_of_index_one_is_not_there(as_scene):
    """Abbe's number says nothing of it either; it is traced channel by channel."""
    with_ball = as_scene(lit(Sphere(Material(transmission=1, ior=1, abbe=50.0), (0, 0, 0), 1)))
    np.testing.assert_allclose(rj.render(with_ball).image, rj.render(as_scene(lit())).image, rtol=1e-12)


@pytest.mark.slow
def test_a_scaled_scene_has_the_same_picture(as_scene):
    ball = Sphere(Material(transmission=1, ior=1.5, absorption=(0.1, 0.2, 0.3)), (0, 0, 0), 1)
    matt = Sphere(Material(diffuse=(0.5, 0.6, 0.7), reflectivity=0.3), (1, -0.8, 1.2), 0.4)
    scene = as_scene(lit(ball, matt, lights=[Light((2, 3, 3), (9, 8, 7))], max_bounces=4))
    expected = np.asarray(rj.render(scene).image)
    for factor in (1e-3, 1e3):
        off = abs(np.asarray(rj.render(scaled_scene(scene, factor, "physical")).image) - expected).max(axis=0)
        assert np.mean(off > 1e-9) < 0.01, (factor, off.max())


NUMBERS = dict.fromkeys(
    ("m1.ior", "m1.absorption.g", "s1.center.x", "s1.center.z", "s1.radius", "s0.center.z"), 1e-6
) | dict.fromkeys(("l0.location.y", "eye.fov"), 1e-5)
COLOURS = ("m2.diffuse.r", "m2.reflectivity", "m2.transmission", "l0.emissivity.b", "sky.radiance.r")
NUMBERS |= dict.fromkeys(COLOURS, 1e-4)
"""How far each moves to either side."""


@pytest.mark.slow
def test_derivatives_are_differences(as_scene):
    """In all pixels but those that see an edge within the step; the rim of the ball is among the others."""
    ball = Sphere(Material(transmission=1, ior=1.5, absorption=(0.1, 0.2, 0.3)), (0.1, 0, 0), 1)
    matt = Sphere(Material(diffuse=(0.5, 0.6, 0.7), reflectivity=0.3, transmission=0.2, ior=1.3), (1, -0.8, 1.2), 0.4)
    scene = as_scene(lit(ball, matt, lights=[Light((2, 3, 3), (9, 8, 7))], max_bounces=4))
    names = list(NUMBERS)
    points = rj.RenderSettings(edges="point")
    found = np.asarray(rj.picture_derivatives(scene, names, points).values)
    assert np.isfinite(found).all()
    for name, derivative in zip(names, found, strict=True):
        value, step = float(scene[name]), NUMBERS[name]
        ahead, behind = (
            np.asarray(rj.render(rj.set_parameters(scene, {name: value + side * step})).image) for side in (1, -1)
        )
        difference = (ahead - behind) / (2 * step)
        error = abs(derivative - difference).max(axis=0) / (1 + abs(difference).max(axis=0))
        assert np.mean(error > 1e-4) < 0.02, name
        assert abs(difference).max() > 1e-3, f"{name} changes nothing, so that the test says nothing"

    # Backwards the derivative of a weighted sum is the sum of these.
    renderer = functools.partial(rj.render, settings=points)
    weights = np.random.default_rng(0).normal(size=found.shape[1:])

    def weighted(values):
        moved = rj.set_parameters(scene, dict(zip(names, values, strict=True)))
        return jnp.sum(weights * renderer(moved).image)

    values = jnp.asarray([float(scene[name]) for name in names])
    backwards = jax.jit(jax.grad(weighted))(values)
    np.testing.assert_allclose(backwards, np.sum(found * weights, axis=(1, 2, 3)), rtol=1e-8, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("ior", [3.0, 0.6])
def test_dense_and_thin_glass_is_finite(as_scene, ior):
    description = lit(Sphere(Material(transmission=1, ior=ior, absorption=(0.1, 0.2, 0.3)), (0, 0, 0), 1))
    camera = dataclasses.replace(EYE, viewpoint=(0, 0, 5), lookat=(0, 0, -1), fov=60)
    scene = as_scene(dataclasses.replace(description, camera=camera, max_bounces=8))
    found = rj.picture_derivatives(scene, ["m1.ior", "s1.center", "s1.radius", "m1.absorption", "eye.fov"])
    assert np.isfinite(found.image).all() and np.isfinite(found.values).all()
    assert abs(np.asarray(found.values)).max() > 0


SEEDS = range(len(AWKWARD), len(AWKWARD) + 20)
"""`experiments/physical/fuzz.py` has hundreds."""


@pytest.fixture(scope="module")
def aware():
    return both_modes("aware")


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_pictures_with_edges_are_finite(aware, seed):
    assert faults(aware, seed, AWKWARD[seed % len(AWKWARD)]) == []


@pytest.mark.slow
def test_pictures_of_points_are_finite():
    program = both_modes("point")
    assert [faults(program, seed, AWKWARD[seed % len(AWKWARD)]) for seed in SEEDS] == [[]] * len(SEEDS)
