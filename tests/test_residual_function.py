"""The residual for loops of one's own: its derivatives, an optimisation with optimistix, and room for its rays."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from scenes import assignment_scene

from raytrace_jax import RenderSettings, make_residual, render, set_parameters
from raytrace_jax.errors import ParameterError

SETTINGS = RenderSettings(size=(24, 18), max_bounces=2)
FREE = ["yellow.diffuse", "vitreous.alpha"]
ANSWER = {"yellow.diffuse": (0.3, 0.6, 0.8), "vitreous.alpha": 0.7}


@pytest.fixture(scope="module")
def scene():
    return assignment_scene()


@pytest.fixture(scope="module")
def target(scene):
    return np.asarray(render(set_parameters(scene, ANSWER), SETTINGS).image)


@pytest.fixture(scope="module")
def problem(scene, target):
    return make_residual(scene, target, FREE, SETTINGS, ties={"red.diffuse": "yellow.diffuse"})


def test_it_is_the_picture_minus_the_target_where_it_starts(problem, scene, target):
    found, overflow = problem.residual(problem.start)
    tied = set_parameters(scene, {"red.diffuse": [float(x) for x in scene_value(scene, "yellow.diffuse")]})
    np.testing.assert_allclose(found, render(tied, SETTINGS).image - target, atol=1e-12)
    assert int(overflow) == 0


def scene_value(scene, name):
    from raytrace_jax import get_parameter

    return get_parameter(scene, name)


def test_parameters_have_their_names_and_the_scene_has_their_values(problem, scene):
    values = problem.parameters(problem.start)
    assert list(values) == ["yellow.diffuse.r", "yellow.diffuse.g", "yellow.diffuse.b", "vitreous.alpha"]
    for name, value in values.items():
        assert float(value) == pytest.approx(float(scene_value(scene, name)), rel=1e-9)
        assert float(scene_value(problem.scene_at(problem.start), name)) == pytest.approx(float(value))


def test_both_modes_derivatives_are_the_limit_of_differences(problem):
    """No edge moves with a colour or with how much glass lets through."""

    def cost(y, blur):
        return 0.5 * jnp.sum(problem.residual(y, blur)[0] ** 2)

    y, step = problem.start, 1e-5
    for blur in (None, jnp.asarray(1.5)):
        gradient = np.asarray(jax.jit(jax.grad(cost))(y, blur))
        forward = np.asarray(jax.jit(jax.jacfwd(cost))(y, blur))
        value = jax.jit(cost)
        differences = [float(value(y + step * e, blur) - value(y - step * e, blur)) / (2 * step) for e in np.eye(4)]
        np.testing.assert_allclose(gradient, differences, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(forward, gradient, rtol=1e-9)


def test_optimistix_finds_what_the_picture_was_made_with(scene, target):
    """The example of the documentation."""
    problem = make_residual(scene, target, ["vitreous.alpha"], SETTINGS)
    start = set_parameters(scene, {"yellow.diffuse": ANSWER["yellow.diffuse"]})
    problem = make_residual(start, target, ["vitreous.alpha"], SETTINGS)
    solver = optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    solution = optimistix.least_squares(problem.residual, solver, problem.start, has_aux=True, max_steps=30)
    assert int(solution.aux) == 0
    assert float(problem.parameters(solution.value)["vitreous.alpha"]) == pytest.approx(0.7, abs=1e-8)


def test_rays_without_room_are_said_and_given_room(problem):
    stages = tuple(
        dataclasses.replace(stage, capacity=128) if k else stage for k, stage in enumerate(problem.plan.stages)
    )
    narrow = dataclasses.replace(problem, plan=dataclasses.replace(problem.plan, stages=stages))
    assert int(narrow.residual(narrow.start)[1]) > 0
    assert int(narrow.with_room(narrow.start).residual(narrow.start)[1]) == 0


def test_what_makes_no_sense_is_refused(scene, target):
    with pytest.raises(ParameterError, match="iro"):
        make_residual(scene, target, ["vitreous.iro"], SETTINGS)
