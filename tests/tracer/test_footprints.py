"""Footprints: thirds that make up the whole, light averaged over them, shares from their nodes against counting."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import assignment_scene, camera_rays, resolved

from raytrace_jax import RenderSettings, optics, parse_scene, render, set_parameters
from raytrace_jax.scene.scene import least_distance
from raytrace_jax.tracer.geometry.footprints import mean, positive_fractions, transport
from raytrace_jax.tracer.geometry.intersection import intersect
from raytrace_jax.tracer.geometry.rays import take
from raytrace_jax.tracer.visibility.look import find_two_nearest
from raytrace_jax.tracer.world import prepare_world

AWARE = resolved(size=(40, 30), edges="aware")


def some_rays():
    column, row = np.random.default_rng(0).uniform([[2], [2]], [[37], [27]], (2, 50))
    camera = assignment_scene().camera
    return jax.jit(camera_rays, static_argnums=1)(camera, AWARE, jnp.asarray(column), jnp.asarray(row))


def some_world():
    return jax.jit(prepare_world, static_argnums=1)(assignment_scene(), AWARE)


def test_the_loop_finds_the_two_nearest(unroll):
    world, rays, live = some_world(), some_rays(), jnp.full(50, True)
    found = []
    for most in (12, 0):
        unroll(most)
        two_nearest = jax.jit(
            lambda world, rays: find_two_nearest(world.shapes, rays, live, live, least_distance(world.unit))
        )
        found.append(two_nearest(world, rays))
    for straight, looped in zip(*found, strict=True):
        np.testing.assert_array_equal(looped.code, straight.code)
        np.testing.assert_allclose(looped.t, straight.t, rtol=1e-12)
    nearest, second = found[0]
    assert np.any(np.isfinite(second.t)) and np.all(nearest.t <= second.t)


def test_hits_move_as_the_camera_rays_do():
    world, rays = some_world(), some_rays()
    live = jnp.full(50, True)
    hits = jax.jit(lambda world, rays: intersect(world.shapes, rays, live, world.unit))(world, rays)
    shape = take(world.shapes, hits.shape)
    p_axes, d_axes = transport(rays, hits, shape, lambda d, n: (optics.reflect(d, n),))
    step = 1e-6
    for k in range(2):
        ends = []
        for sign in (1, -1):
            d = rays.d + sign * step * rays.footprint.d[k]
            hit = intersect(world.shapes, eqx.tree_at(lambda r: r.d, rays, d), live, world.unit)
            ends.append((hit.shape, hit.p, optics.reflect(d, hit.n)))
        smooth = np.asarray((ends[0][0] == hits.shape) & (ends[1][0] == hits.shape) & hits.valid)
        assert smooth.sum() > 30
        for axes, ahead, behind in ((p_axes, ends[0][1], ends[1][1]), (d_axes, ends[0][2], ends[1][2])):
            expected = np.asarray(ahead - behind) / (2 * step)
            np.testing.assert_allclose(axes[k][:, smooth], expected[:, smooth], atol=1e-5 * np.abs(expected).max())


TWO_BALLS = """
settings main { model physical mapping center max_bounces 24 }
camera eye { pixeldim 480 360 viewpoint 1.1 0.8 4.6 lookat 0.1 -0.05 -0.3 up 0.05 1 0.02 fov 37 }
background sky { radiance 0.05 0.06 0.08 }
texture squares { kind checker color1 0.1 0.15 0.25 color2 0.9 0.85 0.8 square 0.7 offset 0.05 0.23 }
material board { emission 1 1 1 texture squares }
material glass0 { transmission 1 ior 1.3 }
material glass1 { transmission 1 ior 1.85 }
rectangle backdrop { material board center 0 0 -2.6 right 6 0 0 up 0 6 0 }
sphere ball0 { material glass0 center -0.5 0.14 0.345 radius 0.7 }
sphere ball1 { material glass1 center 0.7 -0.1 -0.4 radius 0.8 }
"""


@pytest.mark.slow
def test_trapped_light_stays_finite():
    """After some twenty bounces footprints are as wide as 1e200 there, of indices a few in ten thousand apart."""
    scene = parse_scene(TWO_BALLS, dtype=jnp.float64)
    # Light that is trapped splits again and again: six of the nine pixels want more than 640 rays.
    settings = RenderSettings(size=(240, 180), crop=(220, 83, 3, 3), edges="aware", rays_per_pixel=1000)

    def image(ior):
        return render(set_parameters(scene, {"ball0.ior": ior}), settings).image

    forward = jax.jit(lambda ior: jax.jvp(image, (ior,), (jnp.ones(()),))[1])
    backward = jax.jit(jax.grad(lambda ior: image(ior).sum()))
    for ior in 1.3 + np.linspace(0, 1e-3, 8):
        columns = forward(jnp.asarray(ior))
        assert np.isfinite(columns).all()
        # So wide footprints multiply roundings, of which each code generator of XLA's and each processor makes others:
        # 3e-8 was seen on one, 2.4e-6 on another.
        np.testing.assert_allclose(backward(jnp.asarray(ior)), columns.sum(), rtol=1e-5)


CORNERS = [(u / 12**0.5, v / 12**0.5) for u in (-1, 1) for v in (-1, 1)]
GRID = (np.arange(200) + 0.5) / 200 - 0.5


@jax.jit
def share(middle, along_u, along_v):
    values = jnp.stack([middle + u * along_u + v * along_v for u, v in CORNERS])
    return mean(positive_fractions(values[:, None]))[0]


slope_of_share = jax.jit(jax.vmap(jax.grad(share), (0, None, None)))


@given(st.floats(-1, 1), st.floats(0.1, 2), st.booleans())
def test_an_edge_along_a_side_is_exact(middle, slope, second):
    slopes = (0.0, slope) if second else (slope, 0.0)
    expected = np.clip(0.5 + middle / slope, 0, 1)
    assert float(share(middle, *slopes)) == pytest.approx(expected, abs=1e-9)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.05, 1))
def test_any_edge_is_near_the_counted_area(middle, along_u, along_v):
    expected = np.mean(middle + along_u * GRID[:, None] + along_v * GRID > 0)
    assert float(share(middle, along_u, along_v)) == pytest.approx(expected, abs=0.08)


@given(st.floats(-1, 1), st.floats(0.2, 1))
def test_an_edge_in_a_footprint_counts_once(along_u, along_v):
    middles = np.linspace(-1.5, 1.5, 6001)
    slopes = np.asarray(slope_of_share(jnp.asarray(middles), along_u, along_v))
    assert slopes.sum() * (middles[1] - middles[0]) == pytest.approx(1, abs=2e-2)
