"""Rectangles: where rays meet them, their borders as edges, and their shadows."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_geometry import SETTINGS, random_rays, shoot

from raytrace_jax import RenderSettings, parse_scene, picture_derivatives, render, set_parameters
from raytrace_jax.report.differences import correlation, finite_differences, relative_error

HEAD = "camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 } material m { ambient 4 3 2 } "
BOARD = HEAD + (
    "material back { ambient 2 4 6 } plane wall { material back normal 0 0 1 point 0 0 -6 } "
    "rectangle board { material m center 4.1 2.9 -2 right 2.6 0 0 up 0 1.9 -0.5 }"
)
LAMP = "light lamp { location 4 5 -1 emissivity 1 1 1 energy 60 } material m { } "
SHADOW = LAMP + (
    "plane floor { material m normal 0 1 0 point 0 0 0 } "
    "rectangle lid { material m center 4 2.5 -2 right 1 0 0 up 0 0 -0.8 } "
    "camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 9 4 }"
)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_rectangle_is_hit_within_its_sides(seed):
    random = np.random.default_rng(seed)
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0][:2] * random.uniform(0.5, 3, (2, 1))
    center = random.uniform([0, 0, -6], [8, 6, 3])  # Also before the image plane, which planes have to lie behind.
    words = [" ".join(f"{x!r}" for x in vector.tolist()) for vector in (center, *axes)]
    scene = parse_scene(HEAD + f"rectangle r {{ material m center {words[0]} right {words[1]} up {words[2]} }}")
    rays = random_rays(seed)
    hits = shoot(scene, rays)
    o, d, normal = np.asarray(rays.o).T, np.asarray(rays.d).T, np.cross(*axes) / np.linalg.norm(np.cross(*axes))
    t = ((center - o) @ normal) / (d @ normal)
    inside = np.abs((o + t[:, None] * d - center) @ axes.T / np.sum(axes**2, axis=1)) <= 1
    expected = (t > 0) & inside.all(axis=1) & (t <= SETTINGS.path_limit)
    np.testing.assert_array_equal(hits.valid, expected)
    np.testing.assert_allclose(np.asarray(hits.t)[expected], t[expected], atol=1e-9)
    np.testing.assert_allclose(np.asarray(hits.n).T[expected], np.broadcast_to(normal, (expected.sum(), 3)), atol=1e-12)


@pytest.mark.slow
def test_an_aware_picture_is_the_pixel_mean():
    scene = parse_scene(BOARD)
    aware = np.asarray(render(scene, RenderSettings(edges="aware", max_bounces=0)).image)
    fine = np.asarray(render(scene, RenderSettings(samples=24, max_bounces=0)).image)
    point = np.asarray(render(scene, RenderSettings(max_bounces=0)).image)
    # At the four corners, which two borders cut, one straight edge is not all that there is.
    assert np.sqrt(np.mean((aware - fine) ** 2)) < 0.15 * np.sqrt(np.mean((point - fine) ** 2))


AWARE = RenderSettings(edges="aware", max_bounces=0)
NAMES = ("board.center", "board.right.x", "board.up.y")


@pytest.mark.slow
def test_borders_match_supersampling():
    found = picture_derivatives(parse_scene(BOARD), NAMES, AWARE)
    differences = finite_differences(parse_scene(BOARD), NAMES, AWARE, step=0.03, samples=32)
    for k, name in enumerate(found.names):
        assert correlation(found.values[k], differences[k]) > 0.95, name
        # The four corners are a twelfth of the border.
        assert relative_error(found.values[k], differences[k]) < 0.35, name


@pytest.mark.slow
def test_it_casts_a_shadow_with_its_outline():
    scene = parse_scene(SHADOW, model="additive")
    settings = RenderSettings(model="additive", max_bounces=0, mapping="center")
    point, aware, fine = (
        np.asarray(render(scene, dataclasses.replace(settings, **more)).image)
        for more in ({}, {"edges": "aware"}, {"samples": 24})
    )
    lit = render(set_parameters(scene, {"lid.center": [4, 40, -2]}), settings).image
    in_shadow = (np.asarray(lit) - point).min(axis=0) > 0.3
    assert 5 < in_shadow.sum() < 200
    size = [float(np.sqrt(np.mean((image - fine) ** 2))) for image in (aware, point)]
    assert size[0] < 0.35 * size[1]
