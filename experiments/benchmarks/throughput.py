"""Many pictures: `throughput.py CACHE ROUNDS` prints JSON about 200 renders of 320 x 240 pixels with changing index.

On one core, as a batch computes them. Four ways take turns: `trace`, the compiled program alone on scenes made before;
`render`, the library's function in a loop, which also sets the parameter and hands out the picture; `write`, that and
writing an EXR and a PNG; and `batch`, the machinery of the command, which writes records besides.
"""

import json
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from programs import SCENE, seconds, set_up

from raytrace_jax import RenderSettings, load_scene, plan_render, render, set_parameters
from raytrace_jax.batch.jobs import expand
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.runner import chunks, run_chunk
from raytrace_jax.images.png import write_png
from raytrace_jax.report.films import write_film
from raytrace_jax.tracer.programs.plan_cache import plan_ahead
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.util.compilation import jit

COUNT = 200
SETTINGS = RenderSettings(size=(320, 240))
INDICES = np.linspace(1.0, 2.4, COUNT).tolist()
PLAN = f"""scenes = ['{SCENE.as_posix()}']
[settings]
size = [320, 240]
[grid]
vitreous.ior = {{ start = 1.0, stop = 2.4, count = {COUNT} }}
[render]
"""


def main() -> None:
    cache, rounds = sys.argv[1:]
    set_up(cache, devices=1)
    with jax.enable_x64(True):
        compiles = []
        jax.monitoring.register_event_duration_secs_listener(
            lambda event, duration, **_: compiles.append(event) if "backend_compile" in event else None
        )
        ways = build()
        for run in ways.values():
            run()
        before = len(compiles)
        turns = [{name: 1e3 * seconds(run) / COUNT for name, run in ways.items()} for _ in range(int(rounds))]
    print(json.dumps({"turns": turns, "compiles": len(compiles) - before}))


def build():
    """The ways, each a function without arguments that makes all pictures."""
    scene = load_scene(SCENE)
    scenes = [set_parameters(scene, {"vitreous.ior": ior}) for ior in INDICES]
    plan = plan_render(scenes[0], SETTINGS, others=scenes[1 :: COUNT // 16])
    plan_ahead(scenes, SETTINGS)
    traced = jit(lambda scene: render_planned(scene, SETTINGS, plan)[0].image)

    def trace():
        for moved in scenes:
            jax.block_until_ready(traced(moved))

    def render_all():
        for ior in INDICES:
            np.asarray(render(set_parameters(scene, {"vitreous.ior": ior}), SETTINGS).image)

    def write():
        with tempfile.TemporaryDirectory() as folder:
            for number, ior in enumerate(INDICES):
                moved = set_parameters(scene, {"vitreous.ior": ior})
                film = render(moved, SETTINGS)
                write_film(Path(folder) / f"{number}.exr", film, moved, SETTINGS, half=False)
                write_png(Path(folder) / f"{number}.png", np.asarray(film.image))

    def batch():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "plan.toml").write_text(PLAN)
            for chunk in chunks(expand(read_plan(folder / "plan.toml")), folder):
                run_chunk(chunk, folder)

    return {"trace": trace, "render": render_all, "write": write, "batch": batch}


if __name__ == "__main__":
    main()
