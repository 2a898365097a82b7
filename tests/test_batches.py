"""Points in batches: each is traced once, however many rays it sends on and however few find room."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from scenes import assignment_scene, resolved

from raytrace_jax import render
from raytrace_jax.scene.stacked import map_scenes
from raytrace_jax.tracer.geometry.camera import picture_place
from raytrace_jax.tracer.points import render_points
from raytrace_jax.tracer.programs import batches
from raytrace_jax.tracer.programs.plan import Wanted

SETTINGS = resolved(size=(24, 18), max_bounces=2)


def traced(rays, kind):
    """The number of each point of each picture, as a program finds it whose points send on so many rays."""
    pictures, count = rays.shape
    found, calls = np.full((pictures, count), -1), []

    def trace(slots, plan):
        calls.append(slots)
        is_live = np.arange(slots.points.shape[1]) < slots.live[:, None]
        wanted = np.sum(np.where(is_live, rays[slots.picture[:, None], slots.points], 0), axis=1)
        return (slots.points + count * slots.picture[:, None],), Wanted(np.array([wanted.max()]))

    for batch, (numbers,) in batches.in_batches(pictures, count, kind, SETTINGS, trace):
        assert np.all(found[batch.picture, batch.points] == -1)
        found[batch.picture, batch.points] = numbers
    return found, calls


@settings(max_examples=30)
@given(st.integers(1, 3), st.integers(0, 5000), st.sampled_from([0.0, 0.4, 3.0, 1e4]), st.integers(0, 9))
def test_each_point_is_traced_once_however_many_rays_it_sends_on(pictures, count, most, seed):
    rays = np.random.default_rng(seed).uniform(0, most, (pictures, count))
    found, _ = traced(rays, "some")
    np.testing.assert_array_equal(found, np.arange(pictures * count).reshape(pictures, count))


def test_what_found_room_is_remembered_and_forgotten_where_less_is_wanted():
    heavy, light = np.full((1, 4000), 3.0), np.full((1, 4000), 0.1)
    sizes = [traced(rays, "remembered")[1][-1].live.max() for rays in (light, heavy, light, light)]
    assert sizes[0] == sizes[3] > 2 * sizes[1]
    assert len(traced(heavy, "remembered")[1]) == 2 and len(traced(heavy, "remembered")[1]) == 1


def test_a_point_that_wants_more_than_all_room_gets_a_larger_plan():
    before = batches.filling_of("one", SETTINGS).plan
    traced(np.full((1, 2), 5000.0), "one")
    assert batches.FILLINGS["one"].plan.stages[0].capacity > 5000 > before.stages[0].capacity


@given(st.integers(0, 3000))
def test_any_piece_of_the_order_is_spread_over_all_points(count):
    order = batches.spread_out(count)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    if count >= 100:
        for first in (0, count // 3, count - 30):
            gaps = np.diff(np.sort(order[first : first + 30]), prepend=0, append=count)
            assert gaps.max() <= 3 * count / 30


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edges", ["point", "aware"])
def test_a_picture_is_the_same_where_its_rays_find_little_room(edges, monkeypatch):
    scene = assignment_scene()
    column, row = np.meshgrid(np.arange(24.0), np.arange(18.0))
    points = np.stack(picture_place(scene.camera, SETTINGS, column, row)).reshape(2, -1)
    step = None if edges == "point" else np.array([1 / 23, -1 / 17])
    pictures = []
    for rays in (8192, 128):
        monkeypatch.setattr(batches, "FILLINGS", {})
        monkeypatch.setattr(batches, "BATCH", rays)
        pictures.append(render_points(map_scenes(lambda x: np.asarray(x)[None], scene), points, SETTINGS, step)[0])
    np.testing.assert_allclose(*pictures, atol=1e-12)
    if edges == "point":
        image = np.asarray(render(scene, SETTINGS).image).reshape(3, -1)
        inside = (column % 23 > 0).reshape(-1)  # In the others rounding decides which wall is seen.
        np.testing.assert_allclose(pictures[0][:, inside], image[:, inside], atol=1e-12)
