"""`render` inside of JAX's transformations: its values, its derivatives, by default those of areas, and its errors."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiles import counted_compiles
from jax.sharding import PartitionSpec
from scenes import assignment_scene

import raytrace_jax as rj
from raytrace_jax import RenderSettings, SettingsError, render, set_parameters
from raytrace_jax.report.differences import finite_differences, relative_error

SETTINGS = RenderSettings(size=(16, 12), crop=(1, 0, 14, 12), max_bounces=1)
"""Without the first and the last column, in which rounding decides which wall is seen."""

AT = jnp.asarray([1.5, 4.0])


SCENE = assignment_scene()  # It must not be made while JAX traces.


def scene_at(x):
    """The course's scene with another index and another place of the glass ball."""
    return set_parameters(SCENE, {"vitreous.ior": x[0], "vitreous.center.x": x[1]})


def sharded(function, x):
    """The function in each of two shards, of one and the same argument."""
    mesh = jax.make_mesh((2,), ("x",), axis_types=(jax.sharding.AxisType.Auto,))
    share = PartitionSpec("x")

    def each(x):
        return jax.tree.map(lambda y: y[None], function(x[0]))

    return jax.shard_map(each, mesh=mesh, in_specs=share, out_specs=share, check_vma=False)(jnp.stack([x, x]))


VALUES = {
    "jit": lambda image: jax.jit(image)(AT),
    "vmap": lambda image: jax.vmap(image)(jnp.stack([AT + 0.2, AT]))[1],
    "lax.map": lambda image: jax.lax.map(image, jnp.stack([AT, AT + 0.2]))[0],
    "scan": lambda image: jax.lax.scan(lambda x, _: (x, image(x)), AT, length=2)[1][1],
    "cond": lambda image: jax.lax.cond(AT[0] > 1, image, lambda x: 0 * image(x), AT),
    "checkpoint": lambda image: jax.checkpoint(image)(AT),
    "shard_map": lambda image: sharded(image, AT)[1],
    "value_and_grad": lambda image: jax.value_and_grad(lambda x: image(x).mean())(AT)[0],
}
"""A picture under a transformation; the last one has its mean."""


@pytest.mark.slow
@pytest.mark.parametrize("transformation", VALUES)
@pytest.mark.parametrize("edges", ["point", "aware"])
def test_a_picture_is_the_same_under_each(transformation, edges):
    how = dataclasses.replace(SETTINGS, edges=edges)
    if transformation == "shard_map" and jax.device_count() < 2:
        pytest.skip("wants two devices")
    wanted = np.asarray(render(scene_at(AT), how).image)

    def image(x):
        return render(scene_at(x), how).image

    found = VALUES[transformation](jax.jit(image))
    np.testing.assert_allclose(found, wanted if np.ndim(found) else wanted.mean(), atol=1e-12)


def columns(image, x):
    return jax.vmap(lambda e: jax.jvp(image, (x,), (e,))[1], out_axes=-1)(jnp.eye(2))


JACOBIANS = {
    "jvp": columns,
    "linearize": lambda image, x: jax.vmap(jax.linearize(image, x)[1], out_axes=-1)(jnp.eye(2)),
    "jacfwd": lambda image, x: jax.jacfwd(image)(x),
    "jacrev": lambda image, x: jax.jacrev(image)(x),
    "vjp": lambda image, x: jax.vmap(lambda e: jax.vjp(image, x)[1](e)[0])(jnp.eye(2)),
    "grad": lambda image, x: jnp.stack([jax.grad(lambda x, k=k: image(x)[k])(x) for k in range(2)]),
    "checkpoint": lambda image, x: jax.jacrev(jax.checkpoint(image))(x),
    "vmap of jacrev": lambda image, x: jax.vmap(jax.jacrev(image))(jnp.stack([x + 0.1, x]))[1],
    "vmap of jacfwd": lambda image, x: jax.vmap(jax.jacfwd(image))(jnp.stack([x + 0.1, x]))[1],
    "scan": lambda image, x: jax.lax.scan(lambda x, _: (x, jax.jacrev(image)(x)), x, length=2)[1][1],
    "shard_map": lambda image, x: sharded(jax.jacrev(image), x)[1],
}
"""The Jacobian of two weighted sums of a picture, as a transformation has it."""


def weighted(how, x):
    image = render(scene_at(x), how).image
    return jnp.sum(weights_of(image) * image, axis=(1, 2, 3))


def weights_of(image):
    return np.sin(np.arange(2.0 * image.size)).reshape(2, *image.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edges", "transformation"),
    [*itertools.product([None, "point"], JACOBIANS), ("aware", "jacfwd"), ("aware", "vmap of jacrev")],
)
def test_its_derivative_is_the_same_under_each(transformation, edges):
    how = dataclasses.replace(SETTINGS, edges=edges)
    if transformation == "shard_map" and jax.device_count() < 2:
        pytest.skip("wants two devices")
    found = jax.jit(lambda x: JACOBIANS[transformation](functools.partial(weighted, how), x))(AT)
    by_pixel = rj.picture_derivatives(scene_at(AT), ["vitreous.ior", "vitreous.center.x"], how).values
    np.testing.assert_allclose(
        found, np.einsum("kchw,pchw->kp", weights_of(by_pixel[0]), by_pixel), rtol=1e-8, atol=1e-9
    )


@pytest.mark.slow
def test_points_have_second_derivatives():
    smooth = RenderSettings(size=(8, 6), crop=(3, 2, 2, 2), max_bounces=1, edges="point")

    def brightness(x):
        return render(scene_at(x), smooth).image.sum()

    hessian = jax.jit(jax.hessian(brightness))(AT)
    gradient, step = jax.jit(jax.grad(brightness)), 1e-5
    differences = [(gradient(AT + step * e) - gradient(AT - step * e)) / (2 * step) for e in np.eye(2)]
    np.testing.assert_allclose(hessian, np.stack(differences), rtol=1e-5, atol=1e-6)
    for edges in (None, "aware"):
        how = dataclasses.replace(smooth, edges=edges)
        with pytest.raises(SettingsError, match="no second derivative"):
            jax.hessian(lambda x, how=how: render(scene_at(x), how).image.sum())(AT)


@pytest.mark.slow
def test_float32_has_the_derivatives_of_float64():
    how = dataclasses.replace(SETTINGS, edges="aware")
    found = [
        jax.jit(jax.grad(lambda scene: render(scene, how).image.mean()))(assignment_scene(dtype))["vitreous.center"]
        for dtype in (np.float32, np.float64)
    ]
    assert found[0].dtype == np.float32
    np.testing.assert_allclose(*found, rtol=2e-3, atol=1e-5)


TIGHT = RenderSettings(size=(48, 36), crop=(18, 12, 16, 16), rays_per_pixel=1)
"""Glass alone, whose pixels want more rays than the four that there is always room for."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edges", "transformation"),
    [
        *itertools.product(["point"], [*VALUES, *JACOBIANS]),
        *itertools.product([None], ["jvp", "grad"]),
        ("aware", "jit"),
    ],
)
def test_overflow_raises_under_each(transformation, edges):
    how = dataclasses.replace(TIGHT, edges=edges)
    if transformation == "shard_map" and jax.device_count() < 2:
        pytest.skip("wants two devices")
    with pytest.raises(Exception, match=r"rays of a picture found no room.*state RenderSettings\(rays_per_pixel="):
        if transformation in VALUES:
            jax.block_until_ready(VALUES[transformation](jax.jit(lambda x: render(scene_at(x), how).image)))
        else:
            image = functools.partial(weighted, how)
            jax.block_until_ready(jax.jit(lambda x: JACOBIANS[transformation](image, x))(AT))


@pytest.mark.parametrize("edges", ["point", "aware"])
def test_who_obeys_the_error_comes_to_an_end(edges):
    how = dataclasses.replace(TIGHT, edges=edges)
    wanted = np.asarray(render(scene_at(AT), how).image)  # Outside of a transformation there is room for all.
    for _ in range(4):
        try:
            found = jax.block_until_ready(jax.jit(lambda x, how=how: render(scene_at(x), how).image)(AT))
            break
        except Exception as error:
            number = float(str(error).split("(rays_per_pixel=")[1].split(")")[0])
            assert number >= 2 * how.rays_per_pixel
            how = dataclasses.replace(how, rays_per_pixel=number)
    assert how.rays_per_pixel > 1
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_overflow_raises_where_only_a_depth_is_used():
    how = dataclasses.replace(TIGHT, edges="point", aov=("depth",))
    with pytest.raises(Exception, match="rays of a picture found no room"):
        jax.block_until_ready(jax.jit(lambda x: render(scene_at(x), how).aov["depth"])(AT))


def test_overflow_is_counted_where_it_may_be():
    how = dataclasses.replace(TIGHT, edges="point", throw=False)
    film = jax.jit(lambda x: render(scene_at(x), how))(AT)
    wanted = render(scene_at(AT), how)
    wrong = np.any(np.abs(film.image - wanted.image) > 1e-12, axis=0)
    assert wanted.overflow == 0 and 0 < wrong.sum() <= int(film.overflow) < wrong.size


def test_a_crop_has_room_for_more_than_the_mean():
    """All of its pixels see both faces of the glass ball, and want more rays than the picture on the mean."""
    how = RenderSettings(size=(64, 48), crop=(24, 16, 4, 4), edges="aware")
    tight = dataclasses.replace(how, rays_per_pixel=46, throw=False)
    assert jax.jit(lambda x: render(scene_at(x), tight).overflow)(AT) > 0
    np.testing.assert_allclose(jax.jit(lambda x: render(scene_at(x), how).image)(AT), render(scene_at(AT), how).image)


@pytest.mark.slow
def test_an_unjitted_gradient_compiles_once():
    gradient = jax.grad(lambda x: render(scene_at(x), SETTINGS).image.mean())
    with counted_compiles() as compiles:
        first = gradient(AT)
    # Forward and back, and small ones for what stands around the picture; thousands if its operations were programs.
    assert compiles.count("jit(pure_picture)") == 2 and len(compiles) < 50
    with counted_compiles() as compiles:
        second = gradient(AT + 0.1)
    assert not compiles and not np.array_equal(first, second)


@pytest.mark.slow
def test_several_scenes_take_as_many_steps():
    """Conditions stay conditions: a program of several scenes is about as long as that of one."""
    how = dataclasses.replace(SETTINGS, edges="aware")

    def operations(function, x):
        return str(jax.make_jaxpr(function)(x)).count("\n")

    one, many = (lambda x: render(scene_at(x), how).image), jnp.stack([AT, AT])
    assert operations(jax.vmap(one), many) < 1.5 * operations(one, AT)


def test_a_crop_outside_is_refused_when_traced():
    with pytest.raises(ValueError, match=r"crop \(10, 10, 10, 10\).*16 x 12"):
        jax.jit(lambda x: render(scene_at(x), dataclasses.replace(SETTINGS, crop=(10, 10, 10, 10))).image)(AT)


DISC = """camera eye { pixeldim 24 18 worlddim 8 6 viewpoint 4 3 6 } material white { ambient 4 3 2 }
light lamp { location 4 3 3 emissivity 1 1 1 } sphere ball { material white center 4 3 -2 radius 2 }"""
NAMES = ("ball.radius", "ball.center.x")
FLAT = rj.RenderSettings(max_bounces=0)
SHADE = np.linspace(0.2, 1, 24)
"""Weights of columns, so that a disc that moves aside changes their sum."""


def at(scene, values):
    return rj.set_parameters(scene, dict(zip(NAMES, values, strict=True)))


@pytest.mark.slow
def test_both_modes_contain_moving_edges():
    scene = rj.parse_scene(DISC)
    start = jnp.asarray([2.0, 4.0])

    def brightness(values):
        return jnp.mean(rj.render(at(scene, values), FLAT).image * jnp.asarray(SHADE))

    value, reverse = jax.jit(jax.value_and_grad(brightness))(start)
    forward = jax.jit(jax.jacfwd(brightness))(start)
    points = rj.render(scene, dataclasses.replace(FLAT, edges="point")).image
    np.testing.assert_allclose(value, np.mean(np.asarray(points) * SHADE), rtol=1e-12)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    differences = finite_differences(scene, NAMES, FLAT, step=0.03, samples=32)
    np.testing.assert_allclose(forward, np.mean(differences * SHADE, axis=(1, 2, 3)), rtol=0.02)
    found = rj.picture_derivatives(scene, NAMES, FLAT)
    assert all(relative_error(*both) < 0.3 for both in zip(found.values, differences, strict=True))
    np.testing.assert_allclose(found.image, points, atol=1e-12)
    np.testing.assert_allclose(np.mean(found.values * SHADE, axis=(1, 2, 3)), forward, rtol=1e-9)

    # Who asks for points gets the derivative of points: a disc of one colour that grows changes nothing.
    blind = rj.picture_derivatives(scene, NAMES, dataclasses.replace(FLAT, edges="point"))
    assert np.abs(np.mean(blind.values[0])) < 0.3 * np.abs(np.mean(found.values[0]))


@pytest.mark.slow
def test_aovs_are_differentiated_as_points():
    scene = rj.parse_scene(DISC)
    settings = dataclasses.replace(FLAT, aov=("depth",))
    found = []
    for how in (settings, dataclasses.replace(settings, edges="point")):

        def depth(values, how=how):
            found = rj.render(at(scene, values), how).aov["depth"]
            return jnp.sum(jnp.where(found < 100, found, 0))

        found.append(jax.jit(jax.grad(depth))(jnp.asarray([2.0, 4.0])))
    assert np.abs(found[0]).max() > 1
    np.testing.assert_allclose(*found, rtol=1e-9)


@pytest.mark.slow
def test_the_readmes_derivative_is_right():
    scene = rj.load_scene("vitreous")
    settings = rj.RenderSettings(size=(160, 120))
    found = jax.jit(jax.grad(lambda scene: rj.render(scene, settings).image.mean()))(scene)["vitreous.center"]
    names = [f"vitreous.center.{axis}" for axis in "xyz"]
    differences = finite_differences(scene, names, settings, samples=16).mean(axis=(1, 2, 3))
    # Points say (-0.0138, +0.0022, +0.0017), the wrong sign at last.
    np.testing.assert_allclose(differences, [-0.0134, 0.0074, -0.0104], atol=2e-4)
    np.testing.assert_allclose(found, differences, atol=6e-4)
