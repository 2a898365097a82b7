"""What a scan tries: positions that the camera sees, and indices; a ball that the target does not show has neither."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from linear_pictures import state_at
from physical_scenes import Camera, Scene, scene_text
from posing import posed_problem
from scenes import assignment_scene, scaled_scene
from test_fits_of_glass import BALL, BOARD

from raytrace_jax import RenderSettings, fit, load_scene, parse_scene, render, set_parameters
from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.solve.candidates import (
    BUBBLE_INDICES,
    FAR,
    FAR_INDICES,
    INDICES,
    MOST_TRIED,
    across_picture,
    groups,
    size,
    table,
    unseen_balls,
)
from raytrace_jax.tracer.geometry.camera import ray

SPREAD = (np.arange(FAR) + 0.5) / FAR
ALL_FREE = {0: 0, 1: 1, 2: 2}


def lab_scene(camera="viewpoint 1 2 5 lookat .5 0 -1 up 0 1 .2 fov 50", ior="1.5", more=""):
    return parse_scene(
        f"""
        {more}
        camera eye {{ pixeldim 40 30 {camera} }}
        material glass {{ ior {ior} }}
        material board {{ ior 0.8 }}
        rectangle backdrop {{ material board center 0 0 -2 right 6 0 0 up 0 4 0 }}
        sphere ball {{ material glass center .5 .2 -1 radius .5 }}
        """,
        dtype=jnp.float64,
    )


def problem_of(scene, free, priors=None):
    width, height = scene.camera.pixeldim
    target = np.random.default_rng(0).uniform(size=(3, height, width))
    return posed_problem(scene, target, free, edges="point", priors=priors or {})


def seen_from(camera, points):
    """The shares u and v of the picture at which points are seen."""
    origin, direction = (np.asarray(x) for x in ray(camera, jnp.array([0.0, 1, 0]), jnp.array([0.0, 0, 1])))
    origin, corner = origin[:, 0], direction[:, 0]
    right, up = direction[:, 1] - corner, direction[:, 2] - corner
    return np.array([np.linalg.solve(np.stack([right, up, -(p - origin)], 1), -corner)[:2] for p in points])


@pytest.mark.parametrize(
    ("looking", "axes"), [((), ALL_FREE), (("viewpoint 0 0 5 lookat 2 1 0 fov 50",), {0: 4, 1: 7})]
)
def test_a_camera_sees_all_places_tried(looking, axes):
    camera, center = lab_scene(*looking).camera, np.array([0.5, 0.2, -1])
    choice = across_picture(camera, center, axes)
    assert choice.places == tuple(axes.values())
    points = np.tile(center, (FAR * FAR, 1))
    points[:, list(axes)] = choice.values.reshape(-1, len(axes))
    if len(axes) == 3:
        np.testing.assert_allclose((points - center) @ np.asarray(camera.lookat - camera.viewpoint), 0, atol=1e-12)
    seen = seen_from(camera, points).reshape(FAR, FAR, 2)
    np.testing.assert_allclose(seen[:, 3, 0], SPREAD, atol=1e-12)
    assert len(axes) == 2 or np.allclose(seen[2, :, 1], SPREAD, atol=1e-12)


def test_a_camera_in_its_plane_has_no_places():
    scene = set_parameters(assignment_scene(), {"cam1.viewpoint": (4, 3, 0)})
    assert across_picture(scene.camera, np.array([4.0, 3, -1]), ALL_FREE) is None


def test_unreachable_places_keep_the_centre():
    """The plane across z through the ball is seen by the lower part of a picture that looks up steeply."""
    scene = lab_scene("viewpoint 0 0 5 lookat 0 4 4.9 up 0 0 1 fov 120")
    center = np.array([0.5, 7, 0.2])
    choice = across_picture(scene.camera, center, {0: 0, 2: 1})
    points = np.insert(choice.values, 1, 7, axis=-1)
    assert np.all(np.isfinite(points))
    origin = np.asarray(scene.camera.viewpoint)
    forward = np.asarray(scene.camera.lookat) - origin
    assert np.all((points - origin) @ forward > 0)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize("make", [assignment_scene, lab_scene])
def test_a_scaled_scene_scans_scaled_places(make, factor):
    scene = make()
    free = ["vitreous.center", "vitreous.ior"] if make is assignment_scene else ["ball.center", "ball.ior"]
    by = np.array([factor, factor, factor, 1])
    for one, other in zip(*(groups(problem_of(s, free)) for s in (scene, scaled_scene(scene, factor))), strict=True):
        for ours, theirs in zip(one, other, strict=True):
            rows = [table(np.zeros(4), grid) for grid in (ours, theirs)]
            np.testing.assert_allclose(rows[1], rows[0] * by, rtol=1e-9, atol=1e-12 * factor)


def test_unmoving_indices_are_scanned_alone():
    scene = lab_scene()
    ((grid,),) = groups(problem_of(scene, ["board.ior", "backdrop.center", "ball.radius"]))
    (choice,) = grid
    np.testing.assert_array_equal(choice.values[:, 0], BUBBLE_INDICES)
    assert choice.places == (0,)
    assert groups(problem_of(scene, ["ball.ior"], {"ball.ior": (1.5, 0.1)})) == []


def test_indices_of_a_material_are_one_scan():
    """One a channel: three numbers do not make a grid of three dimensions."""
    scene = lab_scene(ior="1.61 1.62 1.63 transmission 1", more="settings main { model physical }")
    ((near, far),) = groups(problem_of(scene, ["glass.ior", "ball.center"]))
    assert near[0].places == far[0].places == (0, 1, 2)
    np.testing.assert_array_equal(near[0].values, np.tile(np.array(INDICES)[:, None], 3))


def test_a_scan_has_a_bound():
    """Of two balls every other value of the longest axes is left out, never the first."""
    scene = lab_scene(more="material dense { ior 1.8 } sphere other { material dense center -.5 .2 -1 radius .5 }")
    found = groups(problem_of(scene, ["glass.ior", "ball.center", "dense.ior", "other.center"]))
    sizes = [size(grid) for grids in found for grid in grids]
    assert len(sizes) == 4 and min(sizes) > 20 and MOST_TRIED / 3 < sum(sizes) <= MOST_TRIED
    assert all(grid[0].values[0, 0] in (INDICES[0], FAR_INDICES[0]) for grids in found for grid in grids)


EYE = Camera((24, 18), (0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
FREE = ("m1.ior", "s1.center.x", "s1.center.y", "s1.center.z")


def solution(index, shown, free=FREE):
    """That a solver came to an index, of a target with a ball of that index or with none."""
    described = Scene(EYE, [BOARD, BALL], radiance=(0.05, 0.06, 0.08), max_bounces=4)
    scene = set_parameters(parse_scene(scene_text(described)), {"m1.ior": index})
    without = parse_scene(scene_text(dataclasses.replace(described, shapes=[BOARD])))
    target = np.asarray(render(scene if shown else without).image)
    target = target + np.random.default_rng(0).normal(0, 1e-5, target.shape)
    problem = posed_problem(scene, target, free, edges="point")
    return state_at(problem)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("index", "shown", "free", "unseen"),
    [
        (1.0001, False, FREE, {"s1": FREE}),
        (1.0001, True, FREE, {}),
        (1.0001, False, FREE[1:], {}),
        (1.0001, False, FREE[:1], {}),
        (1.2, False, FREE, {}),
    ],
)
def test_an_unseen_ball_is_open(index, shown, free, unseen):
    found = solution(index, shown, free)
    assert unseen_balls(found) == unseen
    sure = quantify_uncertainty(found, None).opened(free, free[:2])
    assert sure.undetermined[:2] == free[:2] and np.all(np.isinf(sure.standard_error[:2]))


@pytest.mark.slow
@pytest.mark.optimized
def test_a_small_picture_finds_its_start():
    """In 32 x 24 pixels of this one no place looks like the truth, from which five starts led elsewhere."""
    scene, settings = load_scene("ball"), RenderSettings(size=(64, 48))
    truth = set_parameters(scene, {"glass.ior": 1.4, "ball.center": (0.1, 0.1, 0)})
    target = render(truth, settings).image
    found = fit(scene, target, ["glass.ior", "ball.center"], settings)
    assert found.status == "converged", found.message
    np.testing.assert_allclose(found.value, [1.4, 0.1, 0.1, 0], atol=1e-6)
