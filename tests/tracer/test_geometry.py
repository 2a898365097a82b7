"""Which surface a ray meets first, where, and what belongs to it: against brute force; and derivatives of that."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_tracer import NumpyTracer
from scenes import random_scene, resolved

from raytrace_jax import parse_scene
from raytrace_jax.scene.scene import least_distance
from raytrace_jax.tracer.geometry import intersection, shape_types
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays, take, unpacked
from raytrace_jax.tracer.geometry.shape_types import scene_shapes as shapes_of
from raytrace_jax.tracer.integrator import compact, running_count
from raytrace_jax.tracer.level import point_level
from raytrace_jax.tracer.world import prepare_world

SETTINGS = resolved()
SEEDS = st.integers(0, 2**32 - 1)
COUNT = 256
ONE = jnp.ones(())

intersect_compiled = jax.jit(intersection.intersect)
scene_shapes = jax.jit(functools.partial(shapes_of, settings=SETTINGS))


def find_nearest(shapes, rays):
    return intersection.find_nearest(shapes, rays, jnp.ones_like(rays.inside), ONE.astype(rays.o.dtype))


def nearest(shapes, rays):
    t, index = find_nearest(shapes, rays)
    return t, index, take(shapes, index).radius


@jax.jit
def children_of(scene, rays):
    """The rays that all hits of `rays` send on."""
    level = point_level(prepare_world(scene, SETTINGS), rays, jnp.ones(COUNT, bool))
    rays, slot, count = compact(level.children, jnp.ones(COUNT, jnp.int32))
    return unpacked(rays), jnp.arange(slot.size, dtype=jnp.int32) < count


def free_rays(o, d, dtype=jnp.float64):
    """Rays from free space; `o` and `d` are "3 rays" or one vector."""
    o, d = (np.reshape(np.asarray(v, np.float64).T, (-1, 3)).T for v in (o, d))
    o, d = np.broadcast_arrays(o, d / np.linalg.norm(d, axis=0))
    count = o.shape[1]
    return Rays(
        o=jnp.asarray(o, dtype),
        d=jnp.asarray(d, dtype),
        path_length=jnp.zeros(count, dtype),
        origin_shape=jnp.full(count, NO_SHAPE, jnp.int32),
        inside=jnp.zeros(count, bool),
    )


def random_rays(seed, dtype=jnp.float64):
    random = np.random.default_rng(seed)
    return free_rays(
        random.uniform([[0], [0], [-6]], [[8], [6], [6]], (3, COUNT)), random.normal(size=(3, COUNT)), dtype
    )


def shoot(scene, rays):
    return intersect_compiled(scene_shapes(scene), rays, jnp.ones(rays.o.shape[1], bool), ONE)


def scene_of(*shapes):
    text = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 } material m { alpha 1 ior 1.5 ambient 1 1 1 } "
    return parse_scene(text + " ".join(shapes))


def sphere(name, center, radius):
    return f"sphere {name} {{ material m center {center} radius {radius} }}"


def plane(name, normal, point):
    return f"plane {name} {{ material m normal {normal} point {point} }}"


@settings(max_examples=30)
@given(seed=SEEDS)
def test_the_nearest_hit_matches_brute_force(seed):
    scene, rays = random_scene(seed), random_rays(seed)
    hits = shoot(scene, rays)
    reference = NumpyTracer(scene, SETTINGS)
    t, nearest = reference.nearest_hit(np.asarray(rays.o).T, np.asarray(rays.d).T)
    np.testing.assert_array_equal(hits.valid, t <= SETTINGS.path_limit)
    some = np.asarray(hits.valid)
    np.testing.assert_array_equal(np.asarray(hits.shape)[some], nearest[some])
    np.testing.assert_allclose(np.asarray(hits.t)[some], t[some], atol=1e-9)

    for index, shape in enumerate(reference.shapes):
        mine = some & (nearest == index)
        p, n = np.asarray(hits.p).T[mine], np.asarray(hits.n).T[mine]
        from_point = p - shape.point
        if shape.radius is None:
            np.testing.assert_allclose(from_point @ shape.normal, 0, atol=1e-9)
            np.testing.assert_allclose(n, np.broadcast_to(shape.normal, n.shape), atol=1e-14)
        else:
            np.testing.assert_allclose(np.linalg.norm(from_point, axis=1), shape.radius, atol=1e-9)
            np.testing.assert_allclose(n, from_point / shape.radius, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@settings(max_examples=15)
@given(seed=SEEDS)
def test_a_spawned_ray_misses_its_origin(dtype, seed):
    """A child of a sphere meets that sphere again only at the end of its chord, a child of a plane that plane never."""
    scene = random_scene(seed, dtype=dtype)
    rays, live = children_of(scene, random_rays(seed, dtype))
    hits = intersect_compiled(scene_shapes(scene), rays, live, jnp.ones((), dtype))
    again = np.asarray(hits.valid & (hits.shape == rays.origin_shape))
    is_sphere = np.asarray([kind == "spheres" for kind in scene_shapes(scene).types])
    assert np.all(is_sphere[np.asarray(hits.shape)[again]])
    assert np.all(np.asarray(rays.inside)[again])
    assert np.all(np.asarray(hits.t)[np.asarray(hits.valid)] > float(least_distance(jnp.ones((), dtype))))
    # The chord is 2 r cos(theta), theta the angle between the ray and the normal at its origin.
    shapes = scene_shapes(scene)
    index = np.asarray(rays.origin_shape)
    from_center = np.asarray(rays.o) - np.asarray(shapes.position)[:, index]
    chord = -2 * np.sum(from_center * np.asarray(rays.d), axis=0)
    tolerance = 100 * float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(np.asarray(hits.t)[again], chord[again], atol=tolerance * 8)
    np.testing.assert_allclose(
        np.linalg.norm(from_center, axis=0)[again], np.asarray(shapes.radius)[index][again], atol=tolerance * 8
    )


def test_a_ray_crosses_touching_spheres():
    scene = scene_of(sphere("first", "0 0 -2", 1), sphere("second", "0 0 -4", 1))
    rays = free_rays([0, 0, -1], [0, 0, -1])
    inside_first = Rays(rays.o, rays.d, rays.path_length, jnp.zeros(1, jnp.int32), jnp.ones(1, bool))
    hits = shoot(scene, inside_first)
    assert hits.t[0] == 2 and hits.shape[0] == 0  # both are at distance 2: the first of the file wins
    # On the way out of the first, the second begins at distance 0: the ray is taken to be inside of it.
    out_of_first = Rays(hits.p, rays.d, hits.path_length, hits.shape, jnp.zeros(1, bool))
    hits = shoot(scene, out_of_first)
    assert hits.t[0] == 2 and hits.shape[0] == 1


TOUCHING = sphere("ball", "0 0 -3", 1), plane("wall", "0 0 1", "0 0 -2")


@pytest.mark.parametrize("most", [12, 0])
@pytest.mark.parametrize(
    "both",
    [
        *(TOUCHING, TOUCHING[::-1]),
        *([sphere(name, "0 0 -3", 1) for name in names] for names in ("ab", "ba")),
        *([plane(name, "0 1 2", "0 0 -2") for name in names] for names in ("ab", "ba")),
        [f"rectangle {name} {{ material m center 0 0 -2 right 1 0 0 up 0 1 0 }}" for name in "ab"],
    ],
)
def test_the_first_of_equal_distance_is_hit(both, most, unroll):
    unroll(most)
    shapes = scene_shapes(scene_of(plane("far", "0 0 1", "0 0 -9"), *both))
    t, index, _ = jax.jit(lambda *which: nearest(*which))(shapes, free_rays([0, 0, 0], [0, 0, -1]))
    assert t[0] == 2 and index[0] == 1


def test_parallel_planes_are_missed():
    floor = scene_of(plane("floor", "0 1 0", "0 0 0"))
    assert not shoot(floor, free_rays([0, 1e-9, 0], [0, -1e-7, -1])).valid[0]
    assert shoot(floor, free_rays([0, 1e-4, 0], [0, -1e-5, -1])).valid[0]


@pytest.mark.parametrize("length", [1e-200, 1e-150, 1.0, 1e150, 1e300])
def test_a_plane_normal_has_any_length(length):
    scene = scene_of(plane("p", f"{1 * length!r} {-2 * length!r} {2 * length!r}", "0 0 -2"))
    np.testing.assert_allclose(scene_shapes(scene).normal[:, 0], [1 / 3, -2 / 3, 2 / 3], rtol=1e-15)

    def normal(direction):
        return shapes_of(eqx.tree_at(lambda s: s.planes.normal, scene, direction), SETTINGS).normal

    # Turned towards x: the change is what is perpendicular to the normal.
    _, forward = jax.jit(lambda *x: jax.jvp(normal, x[:1], x[1:]))(
        scene.planes.normal, jnp.asarray([[length], [0], [0]])
    )
    np.testing.assert_allclose(forward[:, 0] * 27, [8, 2, -2], rtol=1e-13)


# Two programs of one function: each is traced where the test has set how many shapes are unrolled.
straight_line, loop = (jax.jit(lambda *which: nearest(*which)) for _ in range(2))


@settings(max_examples=10)
@given(seed=SEEDS)
def test_the_loop_finds_the_unrolled_hits(seed):
    shapes, rays = scene_shapes(random_scene(seed)), random_rays(seed)
    straight = straight_line(shapes, rays)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shape_types, "UNROLL", 0)
        patch.setattr("raytrace_jax.tracer.geometry.rays.UNROLL", 0)
        looped = loop(shapes, rays)
    np.testing.assert_array_equal(looped[2], np.asarray(shapes.radius)[looped[1]])
    np.testing.assert_array_equal(looped[1], straight[1])
    np.testing.assert_allclose(looped[0], straight[0], atol=1e-12)


def test_a_miss_has_bounded_numbers():
    """The 32nd power of an overlong normal overflows, and reverse mode multiplies that infinity by zero."""
    scene = scene_of(sphere("tiny", "0 0 -5", 0.001), plane("floor", "0 1 0", "0 0 0"))
    # Past both; at the floor, but farther than 100; a hit, but not of a live ray.
    rays = free_rays([0, 1, 0], np.transpose([[0, 1, 0], [0, -1e-5, -1], [0, -1, -1]]))
    hits = intersect_compiled(scene_shapes(scene), rays, jnp.asarray([True, True, False]), ONE)
    assert not hits.valid.any()
    np.testing.assert_array_equal(hits.t, 1)
    assert np.all(np.linalg.norm(hits.n, axis=0) <= 1 + 1e-14)


def test_the_running_count_of_many_is_exact():
    wanted = np.random.default_rng(0).random(1 << 18) < 0.9
    np.testing.assert_array_equal(jax.jit(running_count)(jnp.asarray(wanted)), np.cumsum(wanted))


@pytest.mark.parametrize(("count", "share"), [(3, 0.5), (64, 0), (100, 1), (150, 0.3)])
def test_wanted_rays_are_packed_in_order(count, share):
    wanted, rays = np.random.default_rng(0).random((2, count)) < share, free_rays(np.zeros((3, count)), [0, 0, -1])
    lengths = np.arange(2.0 * count).reshape(2, count)
    kinds = [
        (jnp.asarray(some), eqx.tree_at(lambda r: r.path_length, rays, x))
        for some, x in zip(wanted, lengths, strict=True)
    ]
    packed, slot, total = jax.jit(compact)(kinds, jnp.ones(count, jnp.int32))
    total = int(total)
    assert total == wanted.sum()
    np.testing.assert_array_equal(unpacked(packed).path_length[:total], lengths[wanted])
    np.testing.assert_array_equal(np.asarray(slot)[wanted], np.arange(total))
    np.testing.assert_array_equal(np.asarray(slot)[~wanted], 2 * count)
