"""Parameters that run to their bounds: the others then are where least squares within the bounds have them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_fit import linear_problem
from linear_pictures import COLUMNS, POINT, picture, white
from posing import posed_problem
from scenes import assignment_scene
from scipy.optimize import lsq_linear

from raytrace_jax import RenderSettings
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.unknowns import Transform
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.solvers import (
    GaussNewton,
    LevenbergMarquardt,
    bounds_reached,
    is_possible,
    levenberg_marquardt,
    minimise,
    shorten_step,
)

EXACT = LevenbergMarquardt(relative=1e-10, decrease=1e-12)
TRANSFORMS = (Transform(0.0), Transform(0.0, 1.0), Transform())
LOWER, UPPER = np.array([0, 0, -np.inf]), np.array([np.inf, 1, np.inf])


def solved(truth, start, noise=0.0):
    """The problem, and where a solver ends."""
    problem = linear_problem(COLUMNS, picture(truth) + noise, start=start, transforms=TRANSFORMS)
    return problem, levenberg_marquardt(problem, problem.start(), POINT, method=EXACT)


def best(truth, noise=0.0):
    rows, target = COLUMNS.reshape(3, -1).T, (picture(truth) + noise).reshape(-1)
    return lsq_linear(rows, target, (LOWER, UPPER), tol=1e-14).x


@pytest.mark.parametrize(
    "truth, reached",
    [
        ((0.0, 0.5, -0.2), None),  # Nothing pushes it to the bound that it is at: rounding decides.
        ((-0.4, 0.5, 0.7), {"a.center.x": 0.0}),
        ((0.3, 1.2, 0.7), {"b.center.x": 1.0}),
        ((-0.3, -0.2, 0.7), {"a.center.x": 0.0, "b.center.x": 0.0}),
        ((0.3, 0.6, 0.7), {}),
    ],
)
@pytest.mark.parametrize("start", [(0.5, 0.5, 0.0), (0.0, 1.0, 0.0), (1e-12, 0.0, 1.0)])
def test_bounded_least_squares_are_solved(truth, reached, start):
    problem, state = solved(np.array(truth), np.array(start))
    assert state.settled
    np.testing.assert_allclose(problem.values(state.y), best(np.array(truth)), atol=2e-6)
    assert reached is None or dict(bounds_reached(state.y, problem.unknowns)) == reached


def test_a_bounded_answer_keeps_its_error():
    noise = white()
    problem, state = solved(np.array([0, 0.5, 0.7]), np.array([0.3, 0.3, 0.0]), noise)
    ended = minimise(
        GaussNewton(), state, lambda y: FitState.at(problem, y, state.stage), Progress(problem).of_level(0, 0)
    )
    assert ended.settled and np.all(np.isfinite(ended.y))
    np.testing.assert_allclose(problem.values(ended.y), best(np.array([0, 0.5, 0.7]), noise), atol=2e-6)


@given(st.sampled_from(TRANSFORMS[:2]), st.floats(-100, 100))
def test_values_beyond_the_reach_are_clamped(transform, y):
    value = float(transform.to_value(jnp.asarray(y)))
    assert transform.lower <= value and value <= transform.upper
    for end in transform.reach:
        if np.isfinite(end):
            assert float(jax.grad(transform.to_value)(jnp.asarray(end))) == transform.width


@pytest.mark.parametrize("share", [0.5, 1.0, 1.3])
def test_a_step_over_the_camera_is_shortened(share):
    scene = assignment_scene()
    target = np.random.default_rng(0).random((3, 6, 8))
    problem = posed_problem(scene, target, ["vitreous.center"], RenderSettings(size=(8, 6)))
    origin = problem.start()
    center, viewpoint = (np.asarray(part) for part in (scene.spheres.center[:, 2], scene.camera.viewpoint))
    tried = problem.array(problem.unknowns.unknowns(center + share * (viewpoint - center)))
    place = shorten_step(problem, origin, tried)
    assert is_possible(problem, problem.array(place))
    direction = place - np.asarray(origin)
    assert np.linalg.norm(np.cross(direction, tried - origin)) < 1e-9, "it is on the way"
    assert is_possible(problem, tried) == np.allclose(place, tried) == (share == 0.5)
