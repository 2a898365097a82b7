"""The residual for loops of one's own: its derivatives, room for its rays, and loops as users write them."""

import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import user_loops
from scenes import assignment_scene

from raytrace_jax import ParameterError, RenderSettings, SettingsError, make_residual, render, set_parameters

ROOT = Path(__file__).parents[2]
SETTINGS = RenderSettings(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=2)
"""Without the first and the last column, in which rounding decides which wall is seen."""
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


@pytest.mark.slow
def test_it_starts_as_picture_minus_target(problem, scene, target):
    found = problem.residual(problem.start)
    tied = set_parameters(scene, {"red.diffuse": [float(x) for x in scene["yellow.diffuse"]]})
    np.testing.assert_allclose(found, render(tied, SETTINGS).image - target, atol=1e-12)


def jacobian_of(transformation, residual, y):
    """The residual's Jacobian, "pixels parameters", as a caller's transformation gets it."""
    eye = jnp.eye(len(y))
    if transformation == "linearize":
        return jax.vmap(jax.linearize(residual, y)[1], out_axes=1)(eye)
    if transformation == "vjp":
        (found,) = jax.vmap(jax.vjp(residual, y)[1])(jnp.eye(residual(y).size))
        return found
    if transformation == "checkpoint":
        return jax.jacrev(jax.checkpoint(residual))(y)
    if transformation == "vmap":
        return jax.vmap(jax.jacfwd(residual))(jnp.stack([y, y + 0.1]))[0]
    return getattr(jax, transformation)(residual)(y)


@pytest.fixture(scope="module", params=["aware", "point"])
def colored(request):
    """A residual by two colours and an opacity, whose values and derivatives belong together, and its differences."""
    scene = user_loops.setup()[0]
    settings = dataclasses.replace(user_loops.SETTINGS, edges=request.param)
    free = ["board.diffuse.r", "glass.diffuse.g", "glass.alpha"]
    target = np.full((3, 6, 8), 0.3) * np.array([1, 1.2, 0.9])[:, None, None] + np.eye(6, 8) / 4
    picture = make_residual(scene, target, free, settings)

    def residual(y):
        return picture.residual(y, 0.6).ravel()

    compiled, step = jax.jit(residual), 1e-6
    differences = [(compiled(picture.start + step * e) - compiled(picture.start - step * e)) for e in np.eye(3)]
    return residual, picture.start, np.stack(differences, axis=1) / (2 * step)


@pytest.mark.slow
@pytest.mark.parametrize("transformation", ["linearize", "jacfwd", "jacrev", "vjp", "checkpoint", "vmap"])
def test_every_transform_has_the_jacobian(colored, transformation):
    residual, y, differences = colored
    found = jax.jit(functools.partial(jacobian_of, transformation, residual))(y)
    np.testing.assert_allclose(found, differences, atol=1e-8)


@pytest.mark.slow
def test_second_derivatives_match_or_refuse(colored, request):
    residual, y, _ = colored

    def cost(y):
        return 0.5 * jnp.sum(residual(y) ** 2)

    if request.node.callspec.params["colored"] == "aware":
        with pytest.raises(SettingsError, match="no second derivative"):
            jax.hessian(cost)(y)
        return
    gradient, step = jax.jit(jax.grad(cost)), 1e-5
    differences = [(gradient(y + step * e) - gradient(y - step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(jax.jit(jax.hessian(cost))(y), differences, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(jax.jit(jax.jacrev(jax.grad(cost)))(y), differences, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_scene_derivatives_are_a_renderers():
    """Its own scene is a part of the pytree, and moves with what a user adds to it."""
    _, picture, renderer = user_loops.setup()

    def mean(red, film):
        scene = set_parameters(picture.scene, {"glass.diffuse.r": red})
        image = film(scene)
        return jnp.mean(image * jnp.linspace(0, 1, 8))

    def of_residual(scene):
        return dataclasses.replace(picture, scene=scene).residual(picture.start) + picture.observation.target

    red = jnp.asarray(0.4)
    wanted = jax.jit(jax.grad(functools.partial(mean, film=lambda scene: renderer(scene).image)))(red)
    np.testing.assert_allclose(jax.jit(jax.grad(functools.partial(mean, film=of_residual)))(red), wanted, rtol=1e-9)


@pytest.mark.slow
def test_rays_without_room_are_an_error(scene):
    glass = RenderSettings(size=(48, 36), crop=(18, 12, 16, 16), rays_per_pixel=1)
    tight = make_residual(scene, np.linspace(0, 1, 768).reshape(3, 16, 16), FREE, glass)
    for function in (tight.residual, jax.jacfwd(tight.residual)):
        with pytest.raises(Exception, match="rays of a picture found no room"):
            jax.block_until_ready(jax.jit(lambda y, function=function: function(y))(tight.start))


def test_what_makes_no_sense_is_refused(scene, target):
    with pytest.raises(ParameterError, match="iro"):
        make_residual(scene, target, ["vitreous.iro"], SETTINGS)


HERE = Path(__file__).parents[1]


def in_a_process(devices, names):
    """What each loop ends at in a process with so many devices."""
    # With XLA's effort as here, and where the suite keeps its compiled programs, so that the second run finds them.
    variables = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    }
    command = [sys.executable, str(HERE / "user_loops.py"), str(devices), *names]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables, check=False)
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    return {name: [float.fromhex(number) for number in numbers] for name, *numbers in rows}


@functools.cache
def here(name):
    """What a loop ends at in this process."""
    with jax.numpy_dtype_promotion("standard"):  # optax relies on it.
        return np.ravel(user_loops.LOOPS[name]())


def assert_same(name, found, wanted):
    # Adam divides by the size of the gradient, which rounding is near the end.
    np.testing.assert_allclose(found, wanted, rtol=1e-3 if name == "optax_adam" else 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["steps_by_hand", "optax_adam", "optimistix_levenberg_marquardt", "scan_over_steps"])
def test_a_minimising_loop_finds_the_truth(name):
    _, residual, _ = user_loops.setup()
    found = residual.parameters(jnp.array(here(name)))["board.diffuse.r"]
    assert float(found) == pytest.approx(user_loops.TRUTH["board.diffuse.r"], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 2])
def test_loops_agree_on_one_and_two_devices(devices):
    found = in_a_process(devices, user_loops.LOOPS)
    assert found.keys() == user_loops.LOOPS.keys()
    for name, numbers in found.items():
        assert_same(name, numbers, here(name))
