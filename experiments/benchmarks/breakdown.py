"""Where a render's time goes: `breakdown.py CACHE BITS ROUNDS` prints milliseconds by stage as JSON.

Each stage is a program of its own over the true arrays of all levels and all tiles, on one device. It reads its input
from main memory, which the whole program keeps in the cache, and stores all its results, which the whole program partly
fuses away: the stages need not add up to the whole. Their shares are what to look at.
"""

import functools
import json
import statistics
import sys

import jax
import jax.numpy as jnp
from programs import SCENE, SETTINGS, seconds, set_up

from raytrace_jax import load_scene, plan_render
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.geometry.intersection import intersect
from raytrace_jax.tracer.levels.level import trace_level
from raytrace_jax.tracer.levels.wavefront import Brought, blend_level, pack_rays
from raytrace_jax.tracer.programs.plan import tile_pixels
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit


def main() -> None:
    cache, bits, rounds = sys.argv[1:]
    set_up(cache, devices=1)
    with jax.enable_x64(bits == "64"):
        print(json.dumps(stage_milliseconds(int(rounds))))


def stage_milliseconds(rounds: int) -> dict[str, float]:
    """Median time of each stage and of the whole picture."""
    scene = load_scene(SCENE)
    plan = plan_render(scene, SETTINGS)
    levels = all_levels(scene, plan)

    def program(stage, *needs):
        """A program that runs one stage on all levels of all tiles."""

        @jit
        def run(scene, tiles):
            world = prepare_world(scene, SETTINGS)

            def of_tile(levels):
                return [stage(world, level) for level in levels]

            # Each tile's result takes the place of the one before: it stays in the cache, as in the whole program.
            nothing = jax.eval_shape(of_tile, jax.tree.map(lambda x: x[0], tiles))
            nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), nothing)
            return jax.lax.scan(lambda _, levels: (of_tile(levels), None), nothing, tiles)[0]

        given = [{key: level[key] for key in needs} for level in levels]
        return lambda: jax.block_until_ready(run(scene, given))

    whole = jit(lambda scene: render_planned(scene, SETTINGS, plan)[0].image)
    programs = {
        "intersect": program(intersect_rays, "rays", "live"),
        "intersect and shade": program(trace_rays, "rays", "live"),
        "compact": program(compact_rays, "traced", "packing"),
        "combine": program(combine_colors, "below", "traced", "packing"),
        "whole": lambda: jax.block_until_ready(whole(scene)),
    }
    for run in programs.values():
        run()
    turns = [{name: 1e3 * seconds(run) for name, run in programs.items()} for _ in range(rounds)]
    median = {name: statistics.median(turn[name] for turn in turns) for name in programs}
    median["shade"] = median.pop("intersect and shade") - median["intersect"]
    return median


def intersect_rays(world, level):
    return intersect(world.shapes, level["rays"], level["live"], world.unit, SETTINGS, world.clusters)


def trace_rays(world, level):
    return trace_level(world, level["rays"], level["live"], jnp.int32(0), SETTINGS)


def compact_rays(world, level):
    if level["packing"] is None:
        return None
    return pack_rays(level["traced"].children, level["packing"].candidate.shape[0])


def combine_colors(world, level):
    return blend_level(SETTINGS, level["below"], level["traced"], level["packing"], jnp.int32(0))


@functools.partial(jit, static_argnames="plan")
def all_levels(scene, plan):
    """What the stages of each level get, for every tile."""
    world = prepare_world(scene, SETTINGS)
    window = SETTINGS.window(scene.camera.pixeldim)

    def levels_of(tile):
        # Down, as in `wavefront.trace`, keeping everything.
        column, row, live = tile_pixels(tile, plan, window)
        dtype = scene.camera.viewpoint.dtype
        rays = camera_rays(scene.camera, SETTINGS, column.astype(dtype), row.astype(dtype))
        levels = []
        for capacity in (*plan.capacities[1:], None):
            level = {"rays": rays, "live": live, "packing": None}
            level["traced"] = trace_rays(world, level)
            if capacity is not None:
                rays, level["packing"] = pack_rays(level["traced"].children, capacity)
                live = level["packing"].live
            levels.append(level)

        # Up: each level gets the colours of the next.
        below = Brought(jnp.zeros_like(rays.o), jnp.zeros_like(rays.origin_shape), None)
        for level in reversed(levels):
            level["below"] = below
            below = combine_colors(world, level)
        return levels

    return jax.lax.map(levels_of, jnp.arange(plan.tiles, dtype=jnp.int32))


if __name__ == "__main__":
    main()
