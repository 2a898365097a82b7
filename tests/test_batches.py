"""Points in batches: each is found once, however many rays it sends on and however few find room."""

from concurrent.futures import ThreadPoolExecutor

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from scenes import assignment_scene, resolved

from raytrace_jax import render, set_parameters
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer import run
from raytrace_jax.tracer.pixels import picture_pixels, pixel_colors

SETTINGS = resolved(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=2, edges="point")
"""Without the first and the last column, in which rounding decides which wall is seen."""


def traced(rays, key):
    """The number of each point of each picture, as a program finds it whose points send on so many rays."""
    pictures, count = rays.shape
    calls = []

    def trace(batches):
        number = batches.points[:, 0].astype(int)
        slot = np.arange(len(number)) % run.BATCHES
        filled, pixels = np.repeat(batches.counts, run.BATCHES, axis=0).T[..., None]
        live = (slot[:, None] < filled) & (np.arange(number.shape[1]) < pixels)
        wanted = np.sum(np.where(live, 1 + rays[batches.picture[:, None], number], 0), axis=1)
        calls.append(batches.counts[0, 1])
        return (np.where(live, number + count * batches.picture[:, None], -1),), wanted

    points = np.stack([np.arange(float(count)), np.zeros(count)])
    with pytest.MonkeyPatch.context() as patch:
        # Of few small batches each, so that some calls find room and later ones of the same picture do not.
        patch.setattr(run, "RAYS", 512)
        patch.setattr(run, "BATCHES", 2)
        (found,) = run.in_batches(pictures, points, None, key, SETTINGS, trace)
    return found, calls


@settings(max_examples=15)
@given(st.integers(1, 3), st.integers(1, 5000), st.sampled_from([0.0, 0.4, 3.0, 1e4]), st.integers(0, 9))
def test_each_point_is_found_however_many_rays_it_sends_on(pictures, count, most, seed):
    rays = np.random.default_rng(seed).uniform(0, most, (pictures, count))
    found, _ = traced(rays, "some")
    np.testing.assert_array_equal(found, np.arange(pictures * count).reshape(pictures, count))


def test_what_found_room_is_remembered_and_forgotten_where_less_is_wanted():
    heavy, light = np.full((1, 20_000), 9.0), np.full((1, 20_000), 1.0)
    sizes = [traced(rays, "remembered")[1][-1] for rays in (light, light, heavy, light, light)]
    assert sizes[1] == sizes[4] > 2 * sizes[3]
    calls = [len(traced(heavy, "remembered")[1]) for _ in range(2)]
    assert calls[0] > calls[1]  # At first some were traced in vain.


def test_points_that_want_more_than_all_room_get_more():
    traced(np.full((1, 2), 50_000.0), "one")
    assert run.capacity_for(run.NEEDS["one"]).rays > 50_000 > run.RAYS


@given(st.integers(1, 3000))
def test_any_piece_of_the_order_is_spread_over_all_points(count):
    order, places = run.spread_out(count)
    np.testing.assert_array_equal(order[places], np.arange(count))
    if count >= 100:
        for first in (0, count // 3, count - 30):
            gaps = np.diff(np.sort(order[first : first + 30]), prepend=0, append=count)
            assert gaps.max() <= 3 * count / 30


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edges", ["point", "aware"])
def test_a_picture_is_the_same_where_its_rays_find_little_room(edges, monkeypatch):
    scene = assignment_scene()
    points, step = picture_pixels(scene, SETTINGS)
    pictures = []
    for rays in (8192, 256):
        monkeypatch.setattr(run, "NEEDS", {})
        monkeypatch.setattr(run, "RAYS", rays)
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
