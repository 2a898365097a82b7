"""What it saves to trace only those pixels edge-aware that see an edge: `edge_pixels.py SCENE NAME ...`.

Prints a Markdown table of a scene: point-sampled, edge-aware in all pixels, and in those that see an edge; the picture,
and its derivatives by some numbers in forward mode, in milliseconds and as multiples of the point-sampled picture, and
how long they compile. `-o FILE` draws the pixels that see an edge.
"""

import argparse
import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from programs import seconds, set_up

from raytrace_jax import RenderSettings, Scene, load_scene, plan_render, set_parameters
from raytrace_jax.images.png import write_png
from raytrace_jax.scene.parameters import get_parameter, scalar_names
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.programs import planning
from raytrace_jax.tracer.programs.edge_pixels import trace_pixels
from raytrace_jax.tracer.programs.plan import Plan, tile_pixels
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit

RUNS = 3
"""The least time of so many counts."""


def measure(label: str, scene: Scene, names: tuple[str, ...], settings: ResolvedSettings, plan: Plan, unit: float):
    """Print a row of the table; returns the milliseconds of the picture."""
    values = jnp.stack([jnp.asarray(get_parameter(scene, name)) for name in names])

    def image(values):
        moved = set_parameters(scene, {name: values[k] for k, name in enumerate(names)})
        return render_planned(moved, settings, plan)[0].image

    def along(direction):
        return jax.jvp(image, (values,), (direction,))

    picture = jit(image)
    jacobian = jit(lambda _: jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(names), dtype=values.dtype)))
    cells = []
    for program in (picture, jacobian):

        def run(program: Callable = program):
            return jax.block_until_ready(program(values))

        first = seconds(run)
        least = 1e3 * min(seconds(run) for _ in range(RUNS))
        unit = unit or least
        cells += [f"{least:.0f}", f"{least / unit:.1f}", f"{first - least / 1e3:.1f}"]
    print("|", " | ".join([label, *cells]), "|", flush=True)
    return unit


def seen_edges(scene: Scene, settings: ResolvedSettings, plan: Plan):
    """Which pixels see an edge, as a picture."""
    window = settings.window(scene.camera.pixeldim)
    _, _, width, height = window
    found = np.zeros(width * height, bool)

    @jit
    def look(tile):
        column, row, live = tile_pixels(tile, plan, window)
        dtype = scene.camera.viewpoint.dtype
        rays = camera_rays(scene.camera, settings, column.astype(dtype), row.astype(dtype))
        trace, _ = trace_pixels(prepare_world(scene, settings), rays, live, plan, settings)
        return column, row, live, trace.sees_edge

    for tile in range(plan.tiles):
        column, row, live, sees = (np.asarray(x) for x in look(jnp.int32(tile)))
        found[(row * width + column)[live]] = sees[live]
    return found.reshape(height, width)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("names", nargs="+", help="numbers to differentiate by")
    parser.add_argument("--size", nargs=2, type=int, default=(640, 480))
    parser.add_argument("--float32", action="store_true")
    parser.add_argument("-o", "--output", type=Path, help="a PNG of the pixels that see an edge")
    asked = parser.parse_args()
    set_up(devices=1)
    with jax.enable_x64(True):
        scene = load_scene(asked.scene, dtype=jnp.float32 if asked.float32 else jnp.float64)
        names = scalar_names(scene, asked.names)
        aware = resolve_settings(scene, RenderSettings(size=tuple(asked.size), edges="aware"))
        point = dataclasses.replace(aware, edges="point")
        print("| | picture, ms | points | compiles, s | derivatives, ms | points | compiles, s |")
        print("|---" * 7 + "|")
        unit = measure("points", scene, names, point, plan_render(scene, point, runs=1), 0)
        planning.LEAST_LISTED = math.inf
        measure("all pixels edge-aware", scene, names, aware, plan_render(scene, aware, runs=1), unit)
        planning.LEAST_LISTED, planning.MOST_LISTED = 0, 1.0
        plan = plan_render(scene, aware, runs=1)
        measure("those that see an edge", scene, names, aware, plan, unit)
        found = seen_edges(scene, aware, plan)
        print(f"\n{found.mean():.1%} of the pixels see an edge.")
        if asked.output:
            write_png(asked.output, np.broadcast_to(found, (3, *found.shape)).astype(np.float32))


if __name__ == "__main__":
    main()
