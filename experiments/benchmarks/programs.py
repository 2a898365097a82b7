"""The programs that the benchmarks time: picture, Jacobian and gradient of the assignment's scene at its full size."""

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from raytrace_jax import load_scene, plan_render, set_parameters
from raytrace_jax.scene.parameters import get_parameter, scalar_names
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.compilation import jit

SCENE = Path(__file__).parents[2] / "data" / "vitreous.txt"
FREE = ("vitreous.ior", "vitreous.center")
SETTINGS = ResolvedSettings(edges="point")
"""640 x 480 pixels, points, Schlick's approximation, 5 bounces: what the native program does too."""

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
    """A program without arguments that runs to its end, in the precision in force.

    Args:
        name: one of
            `render`: the picture;
            `jacobian`: the picture and its derivatives by the glass ball's index and center, forward mode;
            `gradient`: half the squared error and its derivatives by the same four numbers, reverse mode;
            `scene_gradient`: the same by every number of the scene;
            `aware_render`, `aware_jacobian`: as the first two, with `edges="aware"`.
    """
    settings = dataclasses.replace(SETTINGS, edges="aware") if name.startswith("aware_") else SETTINGS
    scene = load_scene(SCENE)
    plan = plan_render(scene, settings)
    names = scalar_names(scene, FREE)
    values = jnp.stack([get_parameter(scene, name) for name in names])
    target = jnp.full((3, 480, 640), 0.5, values.dtype)

    def image(scene):
        film, _ = render_planned(scene, settings, plan)
        return film.image

    def at(values, scene):
        return set_parameters(scene, dict(zip(names, values, strict=True)))

    @jit
    def jacobian(values, scene):
        def derivative(direction):
            return jax.jvp(lambda values: image(at(values, scene)), (values,), (direction,))

        return jax.vmap(derivative, out_axes=(None, 0))(jnp.eye(len(names), dtype=values.dtype))

    def loss(scene, target):
        return 0.5 * jnp.sum((image(scene) - target) ** 2)

    @jit
    def gradient(values, scene, target):
        return jax.value_and_grad(lambda values: loss(at(values, scene), target))(values)

    function, *arguments = {
        "render": (jit(image), scene),
        "jacobian": (jacobian, values, scene),
        "gradient": (gradient, values, scene, target),
        "scene_gradient": (jit(jax.value_and_grad(loss)), scene, target),
    }[name.removeprefix("aware_")]
    return lambda: jax.block_until_ready(function(*arguments))


def seconds(program: Program) -> float:
    """How long a program takes once."""
    start = time.perf_counter()
    program()
    return time.perf_counter() - start
