"""Plans are remembered within a bound, and are a matter of room only."""

import itertools

import hypothesis.strategies as st
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from scenes import assignment_scene, plan_of, resolved

from raytrace_jax import plan_render, render, set_parameters
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.programs.plan import Wanted, best_runs
from raytrace_jax.tracer.programs.plan_cache import PlanCache, enlarge

SETTINGS = resolved(size=(24, 18), max_bounces=2, edges="point")


def some_plan(rays):
    return plan_of(1, rays, (rays, 1))


def test_the_plan_that_was_not_used_for_longest_is_forgotten():
    cache = PlanCache(most=2)
    cache.keep("first", some_plan(64))
    cache.keep("second", some_plan(128))
    assert cache.get("first") == some_plan(64)
    cache.keep("third", some_plan(192))
    assert cache.get("second") is None
    assert (cache.get("first"), cache.get("third")) == (some_plan(64), some_plan(192))


def test_a_remembered_plan_is_used_and_the_one_that_serves_is_kept():
    cache, tried = PlanCache(), []

    def program(plan):
        tried.append(plan)
        return "picture", Wanted(jnp.zeros(0, jnp.int32))

    def make_plan():
        return some_plan(64)

    assert cache.run(program, "kind", make_plan, SETTINGS) == "picture"
    assert cache.run(program, "kind", lambda: some_plan(128), SETTINGS) == "picture"
    assert tried == [some_plan(64)] * 2


@pytest.fixture
def new_plans(monkeypatch):
    """Let `render` forget all plans: the new cache."""

    def renew():
        cache = PlanCache()
        monkeypatch.setattr("raytrace_jax.tracer.rendering.PLANS", cache)
        return cache

    return renew


def test_a_picture_does_not_depend_on_what_was_rendered_before(new_plans):
    scene = assignment_scene()
    large = set_parameters(scene, {"vitreous.radius": 2.0})
    pictures = []
    for before in ([], [large]):
        new_plans()
        for other in before:
            render(other, SETTINGS)
        pictures.append(np.asarray(render(scene, SETTINGS).image))
    np.testing.assert_array_equal(*pictures)


@pytest.mark.slow
def test_a_plan_given_by_the_caller_is_not_remembered(new_plans):
    cache = new_plans()
    scene = assignment_scene()
    render(scene, SETTINGS, plan_render(scene, SETTINGS, slack=2.0, runs=1))
    assert not cache.plans


@pytest.mark.slow
@pytest.mark.parametrize("edges", ["point", pytest.param("aware", marks=pytest.mark.slow)])
def test_the_number_of_runs_decides_the_time_not_the_picture(edges: EdgeMode):
    scene, settings = assignment_scene(), resolved(size=(24, 18), max_bounces=2, edges=edges)
    plans = {runs: plan_render(scene, settings, runs=runs) for runs in (1, 2, None)}
    assert [len(plans[runs].stages) for runs in (1, 2)] == [1, 2]
    assert len(plans[None].stages) == (3 if edges == "point" else 2)
    one, *others = (np.asarray(render(scene, settings, plan).image) for plan in plans.values())
    for other in others:
        # In the first and the last column rounding decides which wall is seen.
        np.testing.assert_allclose(one[..., 1:-1], other[..., 1:-1], atol=1e-10)


def test_a_plan_that_grows_keeps_its_number_of_runs():
    plan = plan_render(assignment_scene(), SETTINGS, runs=1)
    grown = enlarge(plan, Wanted(2 * jnp.asarray(plan.capacities[1:], jnp.int32)), SETTINGS)
    assert (grown.runs, len(grown.stages)) == (1, 1)
    assert grown.stages[0].capacity > plan.stages[0].capacity
    assert grown.tile_size == plan.tile_size


@given(st.lists(st.integers(1, 40), min_size=1, max_size=8), st.integers(1, 8))
def test_levels_are_cut_into_the_runs_with_the_fewest_slots(sizes, runs):
    """As a search of all cuts finds them; every level finds room, and so do those after a loop."""
    runs = min(runs, len(sizes))
    stages = best_runs(tuple(sizes), runs)
    levels = [stage.capacity for stage in stages for _ in range(stage.levels)]
    assert len(stages) == runs
    assert all(room >= size for room, size in zip(levels, sizes, strict=True))

    def slots(cuts):
        pieces = itertools.pairwise((0, *cuts, len(sizes)))
        return sum((j - i) * max(sizes[i : j if j - i == 1 else None]) for i, j in pieces)

    assert sum(levels) == min(map(slots, itertools.combinations(range(1, len(sizes)), runs - 1)))
