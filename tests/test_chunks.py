"""Levels in chunks: the same pictures and derivatives, whatever the size of a chunk and wherever the live rays end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import plan_render, set_parameters
from raytrace_jax.tracer.levels.compaction import in_chunks
from raytrace_jax.tracer.programs.tiles import render_planned

SETTINGS = resolved(size=(24, 18), max_bounces=1, edges="aware")


@pytest.fixture
def small_chunks(monkeypatch):
    """Let a chunk hold 128 rays, so that small pictures have many."""
    monkeypatch.setattr("raytrace_jax.tracer.levels.compaction.CHUNK", 128)


def squares(rays, live):
    return {"one": jnp.where(live, rays["x"] ** 2, jnp.nan_to_num(jnp.inf)), "row": jnp.ones((3, 1))}


@pytest.mark.parametrize(("slots", "live"), [(64, 64), (128, 1), (320, 200), (300, 128), (300, 0)])
@pytest.mark.usefixtures("small_chunks")
def test_chunks_put_together_are_the_whole(slots, live):
    x, mask = jnp.arange(1.0, slots + 1), jnp.arange(slots) < live
    found = in_chunks(squares, {"x": x}, mask)
    assert found["row"].shape == (3, slots)
    np.testing.assert_array_equal(found["one"][:live], x[:live] ** 2)
    # A chunk without live rays is not computed at all.
    size = 64 * -(-slots // (64 * -(-slots // 128)))
    computed = min(slots, size * -(-live // size))
    np.testing.assert_array_equal(found["one"][computed:], 0)


def aware_picture(runs):
    """An edge-aware picture as a function of an index, with its levels in so many runs."""
    scene = assignment_scene()
    plan = plan_render(scene, SETTINGS, runs=runs)
    assert len(plan.stages) == runs and plan.stages[0].capacity > 256

    def image(index):
        return render_planned(set_parameters(scene, {"vitreous.ior": index}), SETTINGS, plan)[0].image

    return image


def forward(image):
    return jax.jit(lambda x: jax.jvp(image, (x,), (jnp.ones_like(x),)))(jnp.asarray(1.36))


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_edge_aware_pictures_and_derivatives_do_not_depend_on_chunks():
    for in_pieces, at_once in zip(forward(aware_picture(runs=1)), forward(aware_picture(runs=2)), strict=True):
        np.testing.assert_allclose(in_pieces, at_once, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_reverse_mode_through_chunks_is_forward_mode():
    image = aware_picture(runs=1)
    picture, derivative = forward(image)
    backward = jax.jit(jax.grad(lambda x: jnp.sum(image(x) ** 2)))(jnp.asarray(1.36))
    np.testing.assert_allclose(backward, 2 * jnp.sum(picture * derivative), rtol=1e-9)
