"""Points in batches: how few of their rays find room, and what is rendered beside them, changes no picture."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import render, set_parameters
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer import run
from raytrace_jax.tracer.pixels import picture_pixels, pixel_colors

SETTINGS = resolved(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=2, edges="point")
"""Without the first and the last column, in which rounding decides which wall is seen."""


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edges", ["point", "aware"])
def test_a_picture_is_the_same_where_its_rays_find_little_room(edges, monkeypatch):
    scene = assignment_scene()
    points, step = picture_pixels(scene, SETTINGS)
    pictures = []
    for rays in (8192, 256):
        monkeypatch.setattr(run, "NEEDS", {})
        monkeypatch.setattr(run, "RAYS", {"point": rays, "aware": rays})
        stacked = map_scenes(lambda x: np.asarray(x)[None], scene)
        pictures.append(pixel_colors(stacked, points, SETTINGS, None if edges == "point" else step)[0])
    np.testing.assert_allclose(*pictures, atol=1e-12)
    if edges == "point":
        np.testing.assert_allclose(pictures[0], np.asarray(render(scene, SETTINGS).image).reshape(3, -1), atol=1e-12)


def test_a_picture_does_not_depend_on_what_was_rendered_before_or_is_beside_it(monkeypatch):
    monkeypatch.setattr(run, "NEEDS", {})
    scenes = [set_parameters(assignment_scene(), {"vitreous.radius": radius}) for radius in (1.0, 2.0)]
    first = [np.asarray(render(scene, SETTINGS).image) for scene in scenes]
    with ThreadPoolExecutor(4) as threads:
        again = list(threads.map(lambda scene: np.asarray(render(scene, SETTINGS).image), 4 * scenes))
    for number, image in enumerate(again):
        np.testing.assert_array_equal(image, first[number % 2])
