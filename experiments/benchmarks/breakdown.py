"""Where a render's time goes: `breakdown.py CACHE BITS ROUNDS` prints milliseconds by stage as JSON.

Each stage is a program of its own over the true arrays of all levels and all tiles, on one device. Alone it also reads
its input from memory and writes its output there, which the whole program keeps in the cache: the stages add up to
more than the whole. Their shares are what to look at.
"""

import json
import statistics
import sys

import jax
import jax.numpy as jnp
from programs import SCENE, SETTINGS, seconds, set_up

from raytrace_jax import load_scene, plan_render
from raytrace_jax._compile import jit
from raytrace_jax.compaction import unpack
from raytrace_jax.intersection import intersect
from raytrace_jax.plan import tile_pixels
from raytrace_jax.rays import camera_rays
from raytrace_jax.render import render_planned
from raytrace_jax.shading.classic import combine, shade
from raytrace_jax.wavefront import pack_children, prepare_world


def main() -> None:
    cache, bits, rounds = sys.argv[1:]
    set_up(cache, devices=1)
    with jax.enable_x64(bits == "64"):
        print(json.dumps(stage_milliseconds(int(rounds))))


def stage_milliseconds(rounds: int) -> dict[str, float]:
    """Median time of each stage and of the whole picture."""
    scene = load_scene(SCENE)
    plan = plan_render(scene, SETTINGS)
    window = SETTINGS.window(scene.camera.pixeldim)

    def intersect_rays(world, level):
        return intersect(world.shapes, level["rays"], level["live"], SETTINGS)

    def shade_hits(world, level):
        return shade(level["hits"], level["rays"], world.materials, world.lights, SETTINGS)

    def combine_colors(world, level):
        if "packing" not in level:
            return combine(level["surface"], level["color"], level["color"])
        return combine(level["surface"], *unpack(level["color"], level["packing"]))

    @jit
    def all_levels(scene):
        """What each stage of each level gets, for every tile."""
        world = prepare_world(scene)

        def levels_of(tile):
            column, row, live = tile_pixels(tile, plan, window)
            dtype = scene.camera.viewpoint.dtype
            rays = camera_rays(scene.camera, SETTINGS, column.astype(dtype), row.astype(dtype))
            levels = []
            for capacity in (*plan.capacities, None):
                level = {"rays": rays, "live": live}
                level["hits"] = intersect_rays(world, level)
                level["surface"], level["children"] = shade_hits(world, level)
                if capacity is not None:
                    rays, level["packing"] = pack_children(level["children"], capacity)
                    live = level["packing"].live
                levels.append(level)
            color = jnp.zeros_like(levels[-1]["surface"].local)
            for level in reversed(levels):
                level["color"] = color  # that of the level's children
                color = combine_colors(world, level)
            return levels

        return jax.lax.map(levels_of, jnp.arange(plan.tiles, dtype=jnp.int32))

    def over_all(stage, *needs):
        """A program that runs one stage on all levels of all tiles."""

        @jit
        def run(scene, levels):
            world = prepare_world(scene)
            return jax.lax.map(lambda tile: [stage(world, level) for level in tile], levels)

        reduced = [{key: level[key] for key in needs if key in level} for level in levels]
        return lambda: jax.block_until_ready(run(scene, reduced))

    def pack_rays(world, level):
        return pack_children(level["children"], level["packing"].candidate.shape[0]) if "packing" in level else ()

    levels = all_levels(scene)
    whole = jit(lambda scene: render_planned(scene, SETTINGS, plan)[0].image)
    programs = {
        "intersect": over_all(intersect_rays, "rays", "live"),
        "shade": over_all(shade_hits, "hits", "rays"),
        "compact": over_all(pack_rays, "children", "packing"),
        "combine": over_all(combine_colors, "surface", "color", "packing"),
        "whole": lambda: jax.block_until_ready(whole(scene)),
    }
    for program in programs.values():
        program()
    turns = [{name: 1e3 * seconds(program) for name, program in programs.items()} for _ in range(rounds)]
    return {name: statistics.median(turn[name] for turn in turns) for name in programs}


if __name__ == "__main__":
    main()
