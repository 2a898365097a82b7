"""The programs that the benchmarks time: picture, Jacobian and gradient of the assignment's scene at its full size."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from raytrace_jax import RenderSettings, Scene, load_scene, plan_render, set_parameters
from raytrace_jax._compile import jit
from raytrace_jax.parameters import get_parameter, scalar_names
from raytrace_jax.render import render_planned

SCENE = Path(__file__).parents[2] / "data" / "vitreous.txt"
FREE = ("vitreous.ior", "vitreous.center")
SETTINGS = RenderSettings()
"""640 x 480 pixels, Schlick's approximation, 5 bounces: what the native program does too."""

Program = Callable[[], object]


def set_up(cache: str | None = None, devices: int | None = None) -> None:
    """Start JAX as the command line does: every core a device, compiled programs kept in a folder if one is named."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    jax.config.update("jax_num_cpu_devices", devices or min(cores, 8))
    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def build(name: str) -> Program:
    """A program without arguments that runs to its end: `render`, `jacobian` or `gradient`, in the precision in force.

    The Jacobian is the picture's, forward mode, for the index and the three coordinates of the glass ball, and comes
    with the picture. The gradient is that of half the squared error, reverse mode, for every number of the scene.
    """
    scene = load_scene(SCENE)
    plan = plan_render(scene, SETTINGS)

    def image(scene: Scene):
        film, _ = render_planned(scene, SETTINGS, plan)
        return film.image

    @jit
    def render_image(scene):
        return image(scene)

    names = scalar_names(scene, FREE)
    values = jnp.stack([get_parameter(scene, name) for name in names])

    @jit
    def jacobian(values, scene):
        def image_at(values):
            return image(set_parameters(scene, dict(zip(names, values, strict=True))))

        def derivative(direction):
            return jax.jvp(image_at, (values,), (direction,))

        return jax.vmap(derivative, out_axes=(None, 0))(jnp.eye(len(names), dtype=values.dtype))

    @jit
    def gradient(scene, target):
        return jax.value_and_grad(lambda scene: 0.5 * jnp.sum((image(scene) - target) ** 2))(scene)

    def target():
        return jnp.full((3, 480, 640), 0.5, values.dtype)

    arguments = {
        "render": lambda: (render_image, scene),
        "jacobian": lambda: (jacobian, values, scene),
        "gradient": lambda: (gradient, scene, target()),
    }
    function, *rest = arguments[name]()
    return lambda: jax.block_until_ready(function(*rest))


def seconds(program: Program) -> float:
    """How long a program takes once."""
    start = time.perf_counter()
    program()
    return time.perf_counter() - start
