"""Second derivatives: of points they are those of the first derivatives' differences, of areas they are refused."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from physical_scenes import Scene, write_images
from pictured_scenes import EYE, PAINTED

from raytrace_jax import RenderSettings, SettingsError, load_scene, parse_scene, render, set_parameters

ROOM = """camera eye { pixeldim 16 12 viewpoint 0.3 0.2 5 lookat 0 0 0 fov 35 distortion -0.05 0.01 }
light lamp { location 1 2 4 emissivity 20 18 16 }
light side { location -3 1 2 emissivity 9 10 12 }
plane floor { material ground point 0 -1.2 0 normal 0.02 1 0.1 }
rectangle board { material wall center 0.1 0 -2.5 right 3 0 0.3 up 0 3 0 }
sphere matt { material lit center -0.7 0.4 -0.5 radius 0.6 }
sphere ball { material glass center 0.5 -0.1 0.3 radius 0.8 }
"""
MODELS = {
    "physical": """settings main { model physical max_bounces 4 }
texture painted { kind image file board.exr }
material lit { diffuse .8 .6 .4 }
material wall { diffuse .5 .6 .7 emission 1 1 1 texture painted reflectivity .2 }
material ground { diffuse .5 .6 .7 reflectivity .2 }
material glass { transmission 1 ior 1.5 absorption .1 .2 .3 }
""",
    "additive": """settings main { model additive max_bounces 3 }
material lit { diffuse .8 .6 .4 specular .2 .2 .2 hardness 9 }
material wall { diffuse .5 .6 .7 reflectivity .2 }
material ground { diffuse .5 .6 .7 reflectivity .2 }
material glass { transmission .9 ior 1.5 fresnel 1 diffuse .1 .1 .1 }
""",
    "classic": """settings main { max_bounces 3 reflectance schlick }
material lit { diffuse .08 .06 .04 specular .02 .02 .02 }
material wall { diffuse .05 .06 .07 specular .1 .1 .1 }
material ground { diffuse .05 .06 .07 specular .1 .1 .1 }
material glass { alpha .9 ior 1.5 diffuse .01 .01 .01 }
""",
}
NAMES = [
    *("glass.ior", "ball.center.x", "ball.center.z", "ball.radius", "matt.center.y", "matt.radius"),
    *("floor.normal.x", "floor.point.y", "board.center.x", "board.center.z", "lamp.location.x", "side.emissivity.r"),
    *("eye.fov", "eye.viewpoint.x", "eye.lookat.y", "eye.distortion.k1"),
]
STEP = 1e-4
WEIGHTS = np.array([[1.0, 0.3], [2.0, 0.5], [3.0, 0.7]])


def of_numbers(function, scene, names):
    """A function of a scene as one of the numbers of these names, and the scene's own."""

    def at(values):
        return function(set_parameters(scene, dict(zip(names, values, strict=True))))

    return at, jnp.asarray([float(scene[name]) for name in names])


@pytest.mark.slow
@pytest.mark.parametrize("model", [*MODELS])
def test_those_of_points_are_differences(model, tmp_path):
    write_images(Scene(EYE, [PAINTED]), tmp_path)
    (tmp_path / "room.txt").write_text(MODELS[model] + ROOM)
    scene = load_scene(tmp_path / "room.txt")
    renderer = functools.partial(render, settings=RenderSettings(edges="point"))
    picture, start = of_numbers(lambda scene: renderer(scene).image, scene, NAMES)

    @jax.jit
    def both(values, one, other):
        """The derivative along one direction, and its derivative along another one."""
        return jax.jvp(lambda values: jax.jvp(picture, (values,), (one,))[1], (values,), (other,))

    mixed = np.random.default_rng(5).normal(size=len(NAMES)) / 4
    for name, axis in zip(NAMES, np.eye(len(NAMES)), strict=True):
        second = np.asarray(both(start, axis, mixed)[1])
        np.testing.assert_allclose(both(start, mixed, axis)[1], second, atol=1e-10 * np.abs(second).max())
        small, large = (
            np.asarray(both(start + h * mixed, axis, mixed)[0] - both(start - h * mixed, axis, mixed)[0]) / (2 * h)
            for h in (STEP, 2 * STEP)
        )
        differences = (4 * small - large) / 3
        # An edge crosses a few pixels between them.
        smooth = np.abs(small - large) <= 1e-3 * (0.01 + np.abs(small))
        assert smooth.mean() > 0.9 and np.abs(differences[smooth]).max() > 1e-3, name
        np.testing.assert_allclose(second[smooth], differences[smooth], rtol=1e-4, atol=1e-6, err_msg=name)


def test_a_hessian_holds_at_normal_incidence():
    scene = parse_scene("""settings main { model physical max_bounces 2 }
        camera eye { pixeldim 3 3 viewpoint 0 0 5 lookat 0 0 0 fov 10 distortion -0.5 0.1 }
        background sky { radiance .2 .3 .4 }
        light lamp { location 1 2 -1 emissivity 20 18 16 } material wall { diffuse 1 .9 .8 }
        material glass { transmission 1 ior 1.5 } plane back { material wall point 0 0 -2 normal 0 0 1 }
        sphere ball { material glass center 0 0 0 radius 1 }""")
    renderer = functools.partial(render, settings=RenderSettings(edges="point"))
    names = ["ball.center.x", "ball.radius", "glass.ior", "eye.fov", "eye.distortion.k1"]
    row, start = of_numbers(lambda scene: jnp.sum(renderer(scene).image[:, 1, :2] * WEIGHTS), scene, names)

    @jax.jit
    def both(values):
        """The Hessian and the gradient."""
        return jax.jacfwd(lambda values: (jax.grad(row)(values),) * 2, has_aux=True)(values)

    hessian = both(start)[0]
    differences = [(both(start + step)[1] - both(start - step)[1]) / 2e-4 for step in 1e-4 * np.eye(5)]
    np.testing.assert_allclose(hessian, differences, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9, atol=1e-9)


DISC = """camera eye { pixeldim 8 6 worlddim 8 6 viewpoint 4 3 6 } material white { ambient 4 3 2 }
light lamp { location 4 3 3 emissivity 1 1 1 } sphere ball { material white center 4 3 -2 radius 2 }"""


def disc(edges):
    """The image and its squared distance from a target, as functions of numbers, and the numbers."""
    scene = parse_scene(DISC)
    renderer = functools.partial(render, settings=RenderSettings(max_bounces=0, edges=edges))
    image, start = of_numbers(lambda scene: renderer(scene).image, scene, ["ball.radius", "white.ambient.r"])
    return image, lambda values, target=0.3: jnp.sum((image(values) - target) ** 2), start


SECOND = {
    "hessian": lambda image, loss: jax.hessian(loss),
    "forward": lambda image, loss: jax.jacfwd(jax.jacfwd(image)),
    "reverse": lambda image, loss: jax.grad(lambda values: jnp.sum(jax.grad(loss)(values))),
    "compiled": lambda image, loss: lambda values: jax.jvp(jax.jit(jax.grad(loss)), (values,), (values,)),
}
FIRST = {
    "J^T J": lambda image, loss: lambda values: jax.vjp(image, values)[1](jax.jvp(image, (values,), (values,))[1]),
    "direction": lambda image, loss: lambda values: jax.grad(lambda v: jax.jvp(loss, (values,), (v,))[1])(values),
    "transposed": lambda image, loss: lambda y: jax.linear_transpose(jax.linearize(image, y)[1], y)(image(y)),
    "target": lambda image, loss: lambda y: jax.jacfwd(lambda t: jax.grad(loss)(y, t))(jnp.asarray(0.3)),
}


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("edges", ["aware", None])
@pytest.mark.parametrize("how", [*SECOND])
def test_those_of_areas_are_refused(how, edges):
    image, loss, start = disc(edges)
    with pytest.raises(SettingsError, match=r"no second derivative; RenderSettings.edges='point'. has one"):
        jax.make_jaxpr(SECOND[how](image, loss))(start)


@pytest.mark.slow
@pytest.mark.parametrize("how", [*FIRST])
@pytest.mark.parametrize("edges", ["aware", None])
def test_first_ones_of_areas_are_not(how, edges):
    image, loss, start = disc(edges)
    jax.make_jaxpr(FIRST[how](image, loss))(start)
