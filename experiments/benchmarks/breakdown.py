"""Where a render's time goes: `breakdown.py CACHE BITS ROUNDS` prints milliseconds by stage as JSON.

Programs run over the rays of the whole picture, cut into chunks as the tracer's queue cuts them, on one device. Each
does one stage more than the one before it, and the whole picture does the rest: a stage is the difference of two.
"""

import functools
import itertools
import json
import statistics
import sys

import jax
import jax.numpy as jnp
import numpy as np
from programs import SCENE, SETTINGS, seconds, set_up

from raytrace_jax import load_scene, render
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.geometry.intersection import intersect
from raytrace_jax.tracer.geometry.rays import packed, unpacked
from raytrace_jax.tracer.integrator import compact
from raytrace_jax.tracer.level import trace_level
from raytrace_jax.tracer.pixels import picture_pixels
from raytrace_jax.tracer.settings import resolve_settings
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit

CHUNK = 512
"""As many rays as `integrator.trace` takes at a time."""


def main() -> None:
    cache, bits, rounds = sys.argv[1:]
    set_up(cache, devices=1)
    with jax.enable_x64(bits == "64"):
        print(json.dumps(stage_milliseconds(int(rounds))))


def stage_milliseconds(rounds: int) -> dict[str, float]:
    """Median time of each stage and of the whole picture."""
    scene = load_scene(SCENE)
    settings = resolve_settings(scene, SETTINGS).of_rays
    chunks = all_chunks(scene, resolve_settings(scene, SETTINGS))

    def intersected(world, rays, live, _):
        return intersect(world.shapes, rays, live, world.unit)

    def shaded(world, rays, live, number):
        return trace_level(world, rays, live, number)

    def sent_on(world, rays, live, number):
        level = shaded(world, rays, live, number)
        return level, compact([(wanted & live, child) for wanted, child in level.children], number + 1)

    def program(stage):
        @jit
        def run(scene, chunks):
            world = prepare_world(scene, settings)

            def of_chunk(chunk):
                waiting, live = chunk
                return stage(world, unpacked(waiting), live, waiting.number)

            # Each chunk's result takes the place of the one before: it stays in the cache, as in the whole program.
            nothing = jax.eval_shape(of_chunk, jax.tree.map(lambda x: x[0], chunks))
            nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), nothing)
            return jax.lax.scan(lambda _, chunk: (of_chunk(chunk), None), nothing, chunks)[0]

        return lambda: jax.block_until_ready(run(scene, chunks))

    programs = {
        "intersect": program(intersected),
        "shade": program(shaded),
        "pack": program(sent_on),
        "queue and blend": lambda: jax.block_until_ready(render(scene, SETTINGS).image),
    }
    for run in programs.values():
        run()
    turns = [[1e3 * seconds(run) for run in programs.values()] for _ in range(rounds)]
    median = [statistics.median(each) for each in zip(*turns, strict=True)]
    steps = (after - before for before, after in itertools.pairwise([0.0, *median]))
    return {**dict(zip(programs, steps, strict=True)), "whole": median[-1]}


def all_chunks(scene, settings):
    """The rays of a picture and all that they send on, generation by generation, in chunks: packed, and live."""

    @functools.partial(jit, static_argnames="count")
    def cut(waiting, count):
        def pieces(x):
            padded = jnp.pad(x[..., :count], [(0, 0)] * (x.ndim - 1) + [(0, -count % CHUNK)])
            return jnp.moveaxis(padded.reshape(*x.shape[:-1], -1, CHUNK), -2, 0)

        live = pieces(jnp.ones(count, bool))
        return jax.tree.map(pieces, waiting), live

    @jit
    def next_generation(scene, waiting, live):
        world = prepare_world(scene, settings.of_rays)

        def children(chunk):
            rays, live = chunk
            level = trace_level(world, unpacked(rays), live, rays.number)
            return compact([(wanted & live, child) for wanted, child in level.children], rays.number + 1)

        found, _, count = jax.lax.map(children, (waiting, live))
        return found, jnp.arange(found.moving.shape[-1], dtype=jnp.int32) < count[:, None]

    (points, step), chunks = picture_pixels(scene, settings), []
    u, v = jnp.asarray(points)
    first, count = rays_through(scene.camera, settings, u, v, jnp.asarray(step)), points.shape[1]
    waiting = packed(first, jnp.zeros(count, jnp.int32))
    for _ in range(settings.levels + 1):
        chunks.append(cut(waiting, count))
        children, used = next_generation(scene, *chunks[-1])
        kept = np.flatnonzero(used)
        if not len(kept):
            break
        flat = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1), children)
        waiting, count = jax.tree.map(lambda x, kept=kept: x[..., kept], flat), len(kept)
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *chunks)


if __name__ == "__main__":
    main()
