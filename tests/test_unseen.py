"""A ball that the target does not show has no position, whatever a solver ends at."""

import dataclasses

import numpy as np
import pytest
from linear_pictures import state_at
from physical_scenes import Camera, Scene, scene_text
from posing import posed_problem
from test_fits_of_glass import BALL, BOARD

from raytrace_jax import parse_scene, render, set_parameters
from raytrace_jax.inverse.candidates import unseen_balls, with_open
from raytrace_jax.inverse.uncertainty import quantify_uncertainty

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
def test_a_ball_without_which_the_picture_is_as_good_is_not_seen(index, shown, free, unseen):
    assert unseen_balls(solution(index, shown, free)) == unseen


@pytest.mark.slow
def test_its_index_and_position_are_open():
    found = solution(1.0001, shown=False)
    sure = with_open(quantify_uncertainty(found, None), FREE, FREE[:3])
    assert sure.undetermined == FREE[:3]
    assert np.array_equal(np.isinf(sure.standard_error), [True, True, True, False])
