"""The programs that the benchmarks time: picture, Jacobian and gradient of the assignment's scene at its full size."""

import functools
import os
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from raytrace_jax import RenderSettings, load_scene, picture_derivatives, render, set_parameters
from raytrace_jax.scene.parameters import scalar_names

SCENE = Path(__file__).parents[2] / "data" / "vitreous.txt"
FREE = ("vitreous.ior", "vitreous.center")
SETTINGS = RenderSettings(size=(640, 480), edges="point")
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
            `render`: the picture, by `render`;
            `jacobian`: the picture and its derivatives by the glass ball's index and center, by `picture_derivatives`;
            `gradient`: half the squared error and its derivatives by the same four, by `jax.grad` of a renderer;
            `scene_gradient`: the same by every number of the scene;
            `aware_render`, `aware_jacobian`: as the first two, with `edges="aware"`.
    """
    scene, kind = load_scene(SCENE), name.removeprefix("aware_")
    settings = RenderSettings(size=(640, 480), edges="aware") if kind != name else SETTINGS
    if kind == "render":
        return lambda: jax.block_until_ready(render(scene, settings).image)
    if kind == "jacobian":
        return lambda: jax.block_until_ready(picture_derivatives(scene, FREE, settings).values)

    renderer, names = functools.partial(render, settings=settings), scalar_names(scene, FREE)
    values = jnp.stack([scene[name] for name in names])
    target = jnp.full((3, 480, 640), 0.5, values.dtype)

    def loss(scene, target):
        return 0.5 * jnp.sum((renderer(scene).image - target) ** 2)

    def loss_at(values, scene, target):
        return loss(set_parameters(scene, dict(zip(names, values, strict=True))), target)

    if kind == "gradient":
        gradient = jax.jit(jax.value_and_grad(loss_at))
        return lambda: jax.block_until_ready(gradient(values, scene, target))
    scene_gradient = jax.jit(jax.value_and_grad(loss))
    return lambda: jax.block_until_ready(scene_gradient(scene, target))


def seconds(program: Program) -> float:
    """How long a program takes once."""
    start = time.perf_counter()
    program()
    return time.perf_counter() - start
