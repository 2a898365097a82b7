"""Edge-aware tracing of the pixels that see an edge only: the picture and its derivatives are those of all pixels."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import AWKWARD, assignment_scene, awkward_scene, plan_of, random_scene, resolved

from raytrace_jax import get_parameter, plan_render, set_parameters
from raytrace_jax.tracer.levels import level
from raytrace_jax.tracer.programs.plan import too_many
from raytrace_jax.tracer.programs.plan_cache import run_with_room
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.rendering import render_compiled

SIZE = (32, 24)
SETTINGS = resolved(size=SIZE, max_bounces=2, edges="aware")
PIXELS = 384
"""In each of two tiles."""

ALL = plan_of(2, PIXELS, (9 * PIXELS, 7), runs=1)
"""Every pixel edge-aware, with room for the rays of any scene below."""

LISTED = plan_of(2, PIXELS, (4 * PIXELS, 3), runs=1, edges=[(9 * PIXELS, 7)])
"""Those that see an edge listed."""

MOVED = {"s2.center": [0.3, -0.2, 0.4], "s2.radius": 0.2, "m2.ior": 0.1, "p0.point": [0.1, 0.3, -0.2]}
"""A direction in the space of a random scene's numbers."""


@pytest.fixture(scope="module")
def pictures():
    """Film and rays wanted of a random scene, with each of the two plans."""

    def picture(scene, plan):
        return render_planned(scene, SETTINGS, plan)

    with every_edge_counts():
        yield jax.jit(picture, static_argnames="plan")


@pytest.fixture(scope="module")
def derivatives():
    """The change of the picture along `MOVED`, in the same way."""

    def change(scene, plan):
        def image(step):
            moved = {name: get_parameter(scene, name) + step * jnp.asarray(by) for name, by in MOVED.items()}
            return render_planned(set_parameters(scene, moved), SETTINGS, plan)[0].image

        return jax.jvp(image, (jnp.zeros(()),), (jnp.ones(()),))[1]

    with every_edge_counts():
        yield jax.jit(change, static_argnames="plan")


@contextlib.contextmanager
def every_edge_counts():
    """However little its ray does, so that both plans are the same picture; for programs traced meanwhile."""
    least, level.LEAST_EDGE_WEIGHT = level.LEAST_EDGE_WEIGHT, 0.0
    jax.clear_caches()
    yield
    level.LEAST_EDGE_WEIGHT = least
    jax.clear_caches()


SCENES = [
    *(pytest.param(lambda seed=seed: random_scene(seed, size=SIZE), id=str(seed)) for seed in range(6)),
    *(pytest.param(lambda what=what: awkward_scene(3, what, SIZE), id=what) for what in AWKWARD),
]


@pytest.mark.slow
@pytest.mark.parametrize("make_scene", SCENES)
def test_pictures_are_those_of_all_pixels(pictures, make_scene):
    """The list is shorter than the picture, but not empty."""
    scene = make_scene()
    (film, wanted), (listed_film, listed_wanted) = (pictures(scene, plan) for plan in (ALL, LISTED))
    assert not too_many(ALL, wanted) and not too_many(LISTED, listed_wanted)
    np.testing.assert_allclose(listed_film.image, film.image, atol=1e-9, rtol=0)
    assert 0 < listed_wanted.edges[0] <= PIXELS


@pytest.mark.slow
@pytest.mark.parametrize("make_scene", SCENES)
def test_derivatives_are_those_of_all_pixels(derivatives, make_scene):
    scene = make_scene()
    change, listed_change = (derivatives(scene, plan) for plan in (ALL, LISTED))
    np.testing.assert_allclose(listed_change, change, atol=1e-7 * max(1, float(jnp.abs(change).max())), rtol=0)


@pytest.mark.slow
def test_a_list_that_is_too_short_is_noticed_and_grows():
    scene = assignment_scene()
    short = plan_of(2, PIXELS, (4 * PIXELS, 3), runs=1, edges=[(64, 7)])
    overflows = []

    def program(plan):
        film, wanted = render_compiled(scene, SETTINGS, plan)
        overflows.append((int(film.overflow), int(wanted.edges[0])))
        return film, wanted

    _, plan = run_with_room(program, short, SETTINGS)
    (overflow, listed), *_, (none, _) = overflows
    assert overflow >= listed - 64 > 0 and none == 0
    assert plan.edges is not None and plan.edges[0].capacity >= listed


@pytest.mark.slow
def test_reverse_mode_is_forward_mode():
    scene, random = assignment_scene(), np.random.default_rng(0)
    weights = jnp.asarray(random.normal(size=(3, SIZE[1], SIZE[0])))

    def loss(ior):
        film, _ = render_planned(set_parameters(scene, {"vitreous.ior": ior}), SETTINGS, LISTED)
        return jnp.sum(weights * film.image)

    forward, reverse = jax.jit(lambda x: (jax.jvp(loss, (x,), (jnp.ones_like(x),))[1], jax.grad(loss)(x)))(
        jnp.asarray(1.36)
    )
    assert abs(forward) > 1e-3
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(("size", "are_listed"), [((320, 240), False), ((64, 48), False), ((640, 480), True)])
def test_large_pictures_with_few_edges_have_a_list(size, are_listed):
    plan = plan_render(assignment_scene(), dataclasses.replace(SETTINGS, size=size, max_bounces=5), runs=1)
    assert (plan.edges is not None) == are_listed
    if plan.edges is not None:
        assert plan.edges[0].capacity < plan.tile_size / 2
        assert len(plan.capacities) <= 6
