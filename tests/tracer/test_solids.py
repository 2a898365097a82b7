"""Solids of several faces: where rays meet them against brute force, their derivatives, edges, media and shadows."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace_jax import RenderSettings, load_scene, parse_scene, picture_derivatives, render, set_parameters
from raytrace_jax.report.differences import correlation, finite_differences, relative_error
from raytrace_jax.tracer.geometry.intersection import intersect
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays
from raytrace_jax.tracer.geometry.shape_types import SHAPE_TYPES, face, scene_shapes
from raytrace_jax.tracer.geometry.shapes import hit_distance, surface_normal, surface_value
from raytrace_jax.tracer.geometry.solid import chord, is_inside
from raytrace_jax.tracer.settings import resolve_settings

HEAD = """settings main { model physical mapping center }
camera eye { pixeldim 40 30 viewpoint 1.1 0.8 4.6 lookat 0.1 -0.05 -0.3 fov 34 }
background sky { radiance 1 1 1 }
"""
BODIES = {
    "box": "center 0.1 -0.05 0.2 right 0.8 0.1 0.15 up -0.0787 0.6 0.0197 depth 0.5",
    "prism": "point 0.05 0.8 0.3 axis 0.2 0 -0.9 down 0 -1.2 0 apex 60",
    "cylinder": "center 0.05 0.1 0.3 axis 0.2 0.6 -.5 radius .7",
    "lens": "center 0.05 0.1 0.3 axis 0.2 0.1 -1 curvature1 0.5 curvature2 -0.35 thickness 0.7 diameter 2",
    "half ball": "center 0.1 -0.05 0.2 radius 1 cut 1 -.3 .4",
    "half disc": "center 0.05 0.1 0.3 axis 0.1 0.5 -.1 radius .9 cut 1 0.1 -.3",
    "flat lens": "center 0.05 0.1 0.3 axis 0.2 0.1 -1 curvature1 0.001 curvature2 -0.35 thickness 0.7 diameter 2",
}
KEYWORDS = {"half ball": "sphere", "half disc": "cylinder", "flat lens": "lens"}
VOLUMES = {
    "box": 8 * np.sqrt(0.6725) * np.linalg.norm([-0.0787, 0.6, 0.0197]) * 0.5,
    "prism": 2 * np.sqrt(0.85) * 1.2**2 * np.tan(np.pi / 6),
    "cylinder": 2 * np.pi * 0.49 * np.sqrt(0.65),
    "half ball": 2 / 3 * np.pi,
    "half disc": np.pi * 0.81 * np.sqrt(0.27),
}


def scene_of(name, material="emission .3 0 0", head=HEAD, more=""):
    keyword = KEYWORDS.get(name, name)
    return parse_scene(
        f"{head}material stuff {{ {material} }}\n{keyword} body {{ material stuff {BODIES[name]} }}\n{more}"
    )


SETTINGS = resolve_settings(scene_of("box"))


@functools.partial(jax.jit, static_argnames="settings")
def shoot(scene, o, d, origin, inside, settings):
    shapes = scene_shapes(scene, settings)
    rays = Rays(o, d, jnp.zeros_like(o[0]), origin, inside)
    return shapes, intersect(shapes, rays, jnp.ones_like(inside), jnp.ones(()))


def faces_of(shapes):
    return [face(shapes, k) for k in range(SHAPE_TYPES[shapes.types[0]].face_count)]


def rays_from(seed, count=300):
    random = np.random.default_rng(seed)
    o, d = random.normal(size=(2, 3, count))
    o *= random.uniform(0.2, 3, count)
    return jnp.asarray(o), jnp.asarray(d / np.linalg.norm(d, axis=0))


@pytest.mark.parametrize("name", BODIES)
@settings(max_examples=2)
@given(seed=st.integers(0, 2**32 - 1))
def test_rays_meet_a_solid_where_its_inside_begins_and_ends(name, seed):
    o, d = rays_from(seed)
    nowhere = jnp.full(o.shape[1], NO_SHAPE), jnp.zeros(o.shape[1], bool)
    shapes, hits = shoot(scene_of(name), o, d, *nowhere, SETTINGS)
    faces = faces_of(shapes)
    t = np.linspace(0, 12, 6001)[:, None]
    inside = np.asarray(is_inside(jnp.asarray(o[:, None] + t * d[:, None]), faces))
    changes = inside[1:] != inside[:-1]
    met = changes.any(axis=0)
    # What a brute search steps over is a corner.
    assert np.mean(met != np.asarray(hits.valid)) < 0.01
    both = met & np.asarray(hits.valid)
    first = t[:, 0][changes.argmax(axis=0)]
    assert np.all(((hits.t >= first - 1e-9) & (hits.t <= first + 0.002 + 1e-9))[both])
    # The hit lies on its face, whose normal has length one, and within all others.
    values = np.array(
        [surface_value(hits.p, face) for face in (jax.tree.map(lambda x: x[..., None], f) for f in faces)]
    )
    assert np.all(np.abs(np.take_along_axis(values, np.asarray(hits.shape)[None], 0))[0, both] < 1e-12)
    assert np.all(values.max(axis=0)[both] < 1e-12)
    np.testing.assert_allclose(np.linalg.norm(hits.n, axis=0)[both], 1, atol=1e-12)

    # From there on: inwards a ray ends at the other side, outwards it never comes back.
    inward = jnp.where(jnp.sum(d * hits.n, 0) < 0, d, -d)
    for direction, is_within in ((inward, True), (-inward, False)):
        again = shoot(scene_of(name), hits.p, direction, hits.shape, jnp.full(o.shape[1], is_within), SETTINGS)[1]
        assert np.all(np.asarray(again.valid)[both] == is_within)
        if is_within:
            middle = hits.p + again.t / 2 * direction
            assert np.all((np.asarray(is_inside(middle, faces)) | (np.asarray(again.t) < 1e-6))[both])


@pytest.mark.parametrize("edges", ["point", "aware"])
def test_a_loop_over_solids_makes_the_same_picture(edges, monkeypatch):
    """As it does where shapes are many; of each type there are two, and one lies in another."""
    text = (
        HEAD.replace("40 30", "12 9")
        + "material glass { transmission 1 ior 1.5 }\nmaterial air { transmission 1 ior 1 }\n"
    )
    for k, name in enumerate(("box", "cylinder", "half ball")):
        keyword, numbers = KEYWORDS.get(name, name), BODIES[name]
        text += f"{keyword} large{k} {{ material glass {numbers} }}\n"
    text += "cylinder hole { material air center 0.05 0.1 0.3 axis 0.02 0.06 -.05 radius .07 }\n"
    how = RenderSettings(edges=edges, max_bounces=4)
    straight = np.asarray(render(parse_scene(text), how).image)
    for unroll in ("tracer.geometry.shape_types.UNROLL", "tracer.geometry.rays.UNROLL"):
        monkeypatch.setattr(f"raytrace_jax.{unroll}", 0)
    # Another name is another scene, whose program is traced anew.
    looped = np.asarray(render(parse_scene(text.replace("hole", "bubble")), how).image)
    np.testing.assert_allclose(looped, straight, atol=1e-9)


@pytest.mark.parametrize("name", VOLUMES)
def test_its_size_is_that_of_a_ball_of_its_volume(name):
    size = float(scene_shapes(scene_of(name), SETTINGS).size[0])
    np.testing.assert_allclose(4 / 3 * np.pi * size**3, VOLUMES[name], rtol=1e-12)


def test_a_lens_has_the_volume_of_its_points():
    shapes = scene_shapes(scene_of("lens"), SETTINGS)
    points = np.random.default_rng(0).uniform(-1.4, 1.6, (3, 1_000_000))
    volume = np.mean(is_inside(jnp.asarray(points), faces_of(shapes))) * 27
    np.testing.assert_allclose(4 / 3 * np.pi * float(shapes.size[0]) ** 3, volume, rtol=0.01)


def test_a_lens_becomes_a_plane_without_a_jump():
    """Where its curvature is 0, 1e-12 or 1e-9 a face is met at the same place, and derivatives are finite."""
    o, d = rays_from(1)
    o = o + 2 * jnp.asarray([[0.2], [0.1], [-1]])

    def distance(curvature):
        scene = set_parameters(scene_of("flat lens"), {"body.curvature1": curvature})
        cap = face(scene_shapes(scene, SETTINGS), 1)
        near = jax.lax.stop_gradient(chord(o, d, cap, "cap").near)
        spread = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, o.shape[1])), cap)
        return jnp.where(jnp.isfinite(near) & (jnp.abs(near) < 1e3), hit_distance(near, o, d, spread), 0)

    flat = distance(0.0)
    few = np.abs(flat) < 5
    for curvature in (1e-12, 1e-9):
        np.testing.assert_allclose(distance(curvature)[few], flat[few], atol=1e3 * curvature)
    forward = jax.jvp(distance, (0.0,), (1.0,))[1]
    reverse = jax.vjp(distance, 0.0)[1](jnp.ones_like(flat))[0]
    assert np.all(np.isfinite(forward))
    np.testing.assert_allclose(reverse, jnp.sum(forward), rtol=1e-9)
    slope = (distance(1e-7) - flat) / 1e-7
    np.testing.assert_allclose(forward[few], slope[few], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", BODIES)
def test_hits_have_the_derivatives_of_their_numbers(name):
    """In both modes those of differences, by every number of the block."""
    given, count = scene_of(name), 60
    o, d = rays_from(3, count)
    d = (jnp.asarray([[0.05], [0.0], [0.25]]) - o) + 0.2 * d
    d = d / jnp.linalg.norm(d, axis=0)
    nowhere = jnp.full(count, NO_SHAPE), jnp.zeros(count, bool)
    group = scene_shapes(given, SETTINGS).types[0]
    numbers = {k: v for k, v in vars(getattr(given, group)).items() if isinstance(v, jax.Array)}

    @jax.jit
    def found(values):
        blocks = getattr(given, group)
        scene = jax.tree.map(lambda x: x, given)
        object.__setattr__(scene, group, type(blocks)(**{**vars(blocks), **values}))
        hits = shoot(scene, o, d, *nowhere, SETTINGS)[1]
        return jnp.where(hits.valid, jnp.concatenate([hits.t[None], hits.n]), 0), hits.shape

    value, faces = found(numbers)
    random = np.random.default_rng(0)
    change = {name: jnp.asarray(random.normal(size=x.shape)) for name, x in numbers.items()}
    step = 1e-6
    ends = [found({k: v + s * step * change[k] for k, v in numbers.items()}) for s in (1, -1)]
    same = np.asarray((ends[0][1] == faces) & (ends[1][1] == faces))
    difference = (ends[0][0] - ends[1][0]) / (2 * step)
    tangent = jax.jvp(lambda x: found(x)[0], (numbers,), (change,))[1]
    assert same.mean() > 0.9 and np.any(np.asarray(value) != 0)
    np.testing.assert_allclose(np.asarray(tangent)[:, same], np.asarray(difference)[:, same], rtol=2e-4, atol=2e-6)
    weight = jnp.asarray(random.normal(size=value.shape))
    (pulled,) = jax.vjp(lambda x: found(x)[0], numbers)[1](weight)
    total = sum(float(jnp.sum(pulled[k] * change[k])) for k in numbers)
    np.testing.assert_allclose(total, float(jnp.sum(weight * tangent)), rtol=1e-9)


FEW = [name if name in ("box", "cylinder") else pytest.param(name, marks=pytest.mark.slow) for name in BODIES]
"""All, of which two are looked at in every run: each is programs of its own."""


@pytest.mark.optimized
@pytest.mark.parametrize("name", FEW)
def test_an_aware_picture_of_a_solid_is_the_pixel_mean(name):
    scene = scene_of(name)
    aware, fine, point = (
        np.asarray(render(scene, RenderSettings(max_bounces=0, **how)).image)
        for how in ({"edges": "aware"}, {"samples": 24}, {})
    )
    assert np.sqrt(np.mean((aware - fine) ** 2)) < 0.13 * np.sqrt(np.mean((point - fine) ** 2))
    assert np.max(np.abs(aware - fine)) < 0.3


SHADOW = """settings main { model physical mapping center max_bounces 0 }
camera eye { pixeldim 48 36 viewpoint 0 6 2 lookat 0 -1 0 fov 44 }
light lamp { location 1 5 2 emissivity 100 100 100 }
material floor { diffuse .8 .8 .8 }
plane ground { material floor point 0 -1.5 0 normal 0 1 0 }
"""


@pytest.mark.optimized
@pytest.mark.parametrize("name", FEW)
def test_it_casts_the_shadow_of_its_points(name):
    scene = scene_of(name, "diffuse .5 .2 .2", SHADOW)
    point, aware, fine = (
        np.asarray(render(scene, RenderSettings(**how)).image) for how in ({}, {"edges": "aware"}, {"samples": 16})
    )
    # The face of the half disc that was cut is a strip narrower than a pixel, which one edge does not tell.
    assert np.sqrt(np.mean((aware - fine) ** 2)) < 0.3 * np.sqrt(np.mean((point - fine) ** 2))
    # Brute force: a point of the ground is dark where any point of its way to the lamp is inside.
    shapes = scene_shapes(scene, SETTINGS)
    u, v = np.meshgrid(np.linspace(-3, 3, 30), np.linspace(-3, 2, 30))
    o = jnp.asarray([u.ravel(), np.full(u.size, -1.5), v.ravel()])
    light = jnp.asarray([1.0, 5.0, 2.0])
    clear = SHAPE_TYPES[shapes.types[1 if shapes.types[0] == "planes" else 0]].clearance
    faces = [face(shapes, k) for k in range(len(shapes.size)) if np.isfinite(shapes.size[k])]
    found = np.asarray(clear(o, light, faces, jnp.ones(())))
    way = o[:, None] + np.linspace(0, 1, 2001)[:, None] * (light[:, None] - o)[:, None]
    blocked = np.asarray(is_inside(way, faces)).any(axis=0)
    assert np.mean((found < 0) != blocked) < 0.01 and 5 < blocked.sum() < 800


@pytest.mark.parametrize("name", BODIES)
def test_a_lamp_within_shines_on_what_is_within(name):
    shapes = scene_shapes(scene_of(name), SETTINGS)
    faces, clear = faces_of(shapes), SHAPE_TYPES[shapes.types[0]].clearance
    inner = np.mean([np.asarray(f.position - 0.3 * f.size * f.normal) for f in faces], axis=0)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 400))
    within = np.asarray(is_inside(jnp.asarray(points), faces))
    found = np.asarray(clear(jnp.asarray(points), jnp.asarray(inner), faces, jnp.ones(())))
    np.testing.assert_array_equal(found > 0, within)
    assert 5 < within.sum() < 395


GLASS = """settings main { model physical mapping center max_bounces 8 }
camera eye { pixeldim 32 24 viewpoint 1.1 0.8 4.6 lookat 0.1 -0.05 -0.3 up 0.4 1 0.02 fov 34 }
texture squares { kind checker color1 0.1 0.15 0.25 color2 0.9 0.85 0.8 square 1.1 offset 0.13 0.07 }
material board { emission 1 1 1 texture squares }
rectangle backdrop { material board center 0 0 -2.6 right 6 0 0 up 0 6 0 }
"""
NUMBERS = {
    "box": ("center.x", "right.z", "depth", "ior"),
    "prism": ("point.y", "axis.x", "apex", "ior"),
    "cylinder": ("center.z", "axis.y", "radius", "ior"),
    "lens": ("center.x", "curvature1", "thickness", "diameter", "ior"),
    "half ball": ("radius", "cut.x", "ior"),
}


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("name", NUMBERS)
def test_derivatives_of_glass_solids_are_differences(name):
    scene = scene_of(name, "transmission 1 ior 1.5", GLASS)
    names = [f"body.{number}" for number in NUMBERS[name]]
    found = picture_derivatives(scene, names, RenderSettings(edges="aware"))
    for own, values in zip(names, found.values, strict=True):
        # No edge is parallel to the pixels' sides: each crosses several samples on its way.
        step = 0.1 if own.endswith("apex") else 0.005
        reference = finite_differences(scene, [own], RenderSettings(), step=step, samples=48)[0]
        assert correlation(values, reference) > 0.95, own
        assert relative_error(values, reference) < 0.33, own


@pytest.mark.optimized
def test_a_corner_has_no_ghost_beside_it():
    """Pixels with a corner in them are looked at in parts: three faces meet there, and no single edge cuts them."""
    head = GLASS.replace("32 24", "48 36").replace("fov 34", "fov 37")
    scene = scene_of("box", "transmission 1 ior 1.5", head)
    aware, fine, point = (
        np.asarray(render(scene, RenderSettings(**how)).image) for how in ({"edges": "aware"}, {"samples": 16}, {})
    )
    assert np.sqrt(np.mean((aware - fine) ** 2)) < 0.025 * np.sqrt(np.mean((point - fine) ** 2))
    assert np.max(np.abs(aware - fine)) < 0.04


@pytest.mark.slow
@pytest.mark.optimized
def test_a_face_seen_along_itself_is_met_nowhere_far_away():
    """Of this scene's liquid a footprint sees a flat end from above at its middle and along itself at its part's."""
    settings = RenderSettings(size=(896, 504), edges="aware", crop=(694, 369, 8, 8))
    assert np.all(np.isfinite(render(load_scene("bench"), settings).image))


def test_no_derivative_of_a_solid_is_nan():
    """Where it is seen along its faces, edges and axis, in both modes and both dtypes."""
    for name in ("box", "cylinder", "flat lens"):
        for eye in ("0.05 0.1 5", "5 0.1 0.3", "0.05 5 0.3"):
            head = HEAD.replace("1.1 0.8 4.6", eye).replace("0.1 -0.05 -0.3", "0.05 0.1 0.3").replace("40 30", "9 9")
            head = head.replace("fov", "up 0.3 0.2 0.7 fov")
            scene = scene_of(name, "transmission 1 ior 1.5", head)
            straight = {"axis": [0, 0, 1.0]} if name != "box" else {"right": [0.8, 0, 0], "up": [0, 0.6, 0]}
            scene = set_parameters(scene, {f"body.{k}": v for k, v in straight.items()})
            found = picture_derivatives(
                scene, ["body.center", "body.ior"], RenderSettings(edges="aware", max_bounces=4)
            )
            assert np.all(np.isfinite(found.values)), (name, eye)


def test_surface_normals_are_the_gradient_of_f():
    for name in BODIES:
        for f in faces_of(scene_shapes(scene_of(name), SETTINGS)):
            p = jnp.asarray([0.3, -0.2, 0.7])
            np.testing.assert_allclose(surface_normal(p, f), jax.grad(surface_value)(p, f), atol=1e-14)
