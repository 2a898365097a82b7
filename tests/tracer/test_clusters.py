"""Bounds around clusters of shapes: what is found with them is what all shapes say, and they hold what is in them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import numbers, resolved
from test_geometry import find_nearest, scene_shapes

from raytrace_jax import make_renderer, parse_scene, set_parameters
from raytrace_jax.tracer.geometry import intersection as clusters
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays

COUNT = 40
HEAD = "camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 } light l { location 1 9 2 emissivity 3 3 3 } "
HEAD += (
    "material m { ambient 4 3 2 diffuse 1 2 1 ior 1.5 alpha .3 } plane wall { material m normal 0 0 1 point 0 0 -8 }"
)


def crowd(seed, dtype=jnp.float64):
    """A wall, and as many balls and rectangles as make clusters, some of them one inside of another, one far away."""
    random = np.random.default_rng(seed)
    text = HEAD
    for k in range(COUNT):
        center = random.uniform([0, 0, -7], [8, 6, -1]) + (k == 7) * np.array([300, 0, 0])
        text += f"sphere s{k} {{ material m center {numbers(center)} radius {random.uniform(0.02, 0.9)!r} }} "
        center = random.uniform([0, 0, -7], [8, 6, -1])
        right, up = np.linalg.qr(random.normal(size=(3, 3)))[0][:2] * random.uniform(0.05, 0.8, (2, 1))
        text += f"rectangle r{k} {{ material m center {numbers(center)} right {numbers(right)} up {numbers(up)} }} "
    return parse_scene(text, dtype=dtype)


def rays_in(shapes, seed, count):
    """Rays from anywhere among the shapes to anywhere; half of them start on a ball, inwards or outwards."""
    random = np.random.default_rng(seed)
    o = random.uniform([0, 0, -8], [8, 6, 6], (count, 3))
    d = random.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    balls = np.flatnonzero(np.asarray(shapes.radius) > 0)
    own = np.where(np.arange(count) % 2, NO_SHAPE, random.choice(balls, count))
    on = own != NO_SHAPE
    out = random.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    surface = np.asarray(shapes.position).T[own] + np.asarray(shapes.radius)[own][:, None] * out
    o = np.where(on[:, None], surface, o)
    inside = jnp.asarray(on & (np.sum(out * d, axis=1) < 0))
    dtype = shapes.position.dtype
    return Rays(
        jnp.asarray(o.T, dtype), jnp.asarray(d.T, dtype), jnp.zeros(count, dtype), jnp.asarray(own, jnp.int32), inside
    )


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize("second_root", [True, False])
def test_bounds_change_no_hit(dtype, second_root):
    how = resolved(second_root=second_root)
    with_bounds = jax.jit(lambda shapes, rays: find_nearest(shapes, rays, clusters.make_clusters(shapes), settings=how))
    without = jax.jit(lambda *both: find_nearest(*both, settings=how))
    for seed in range(4):
        shapes = scene_shapes(crowd(seed, dtype))
        rays = rays_in(shapes, seed, 150)  # Not a multiple of a packet.
        t, index = with_bounds(shapes, rays)
        expected_t, expected_index = without(shapes, rays)
        np.testing.assert_array_equal(index, expected_index)
        np.testing.assert_allclose(t, expected_t, rtol=1e-12 if dtype == jnp.float64 else 1e-5)
        assert np.sum(np.isfinite(t)) > 60 and len(np.unique(index)) > 20


@pytest.mark.slow
def test_derivatives_pass_by_the_bounds(monkeypatch):
    scene, how = crowd(3), resolved(max_bounces=1)
    renderer = make_renderer(scene, how, slack=1.5)

    def image(ior):
        return renderer(set_parameters(scene, {"m.ior": ior})).image

    def both(ior):
        weights = jnp.sin(jnp.arange(3.0 * 18 * 24)).reshape(3, 18, 24)
        value, forward = jax.jvp(image, (ior,), (jnp.ones(()),))
        backward = jax.grad(lambda ior: jnp.vdot(weights, image(ior)))(ior)
        return value, jnp.vdot(weights, forward), backward

    value, forward, backward = jax.jit(both)(jnp.asarray(1.5))
    np.testing.assert_allclose(backward, forward, rtol=1e-9)
    assert forward != 0
    few = functools.partial(clusters.make_clusters, fewest=1000)
    monkeypatch.setattr("raytrace_jax.tracer.world.make_clusters", few)
    jax.clear_caches()  # The number is not an argument.
    np.testing.assert_allclose(value, jax.jit(image)(jnp.asarray(1.5)), atol=1e-12)


def test_the_first_coincident_shape_is_hit():
    balls = "".join(f"sphere s{k} {{ material m center 4 3 -3 radius 1 }} " for k in range(COUNT))
    shapes = scene_shapes(parse_scene(HEAD + balls))
    forward = jnp.broadcast_to(jnp.asarray([[0.0], [0], [-1]]), (3, 70))
    start = jnp.broadcast_to(jnp.asarray([[4.0], [3], [6]]), (3, 70))
    rays = Rays(start, forward, jnp.zeros(70), jnp.full(70, NO_SHAPE, jnp.int32), jnp.full(70, False))
    with_bounds = jax.jit(lambda shapes, rays: find_nearest(shapes, rays, clusters.make_clusters(shapes)))
    t, index = with_bounds(shapes, rays)
    np.testing.assert_array_equal(t, 8)
    np.testing.assert_array_equal(index, shapes.types.index("sphere"))
