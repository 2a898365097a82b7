"""Many pictures: `throughput.py CACHE ROUNDS [COUNT]` prints JSON about renders of 320 x 240 with changing index.

There are 200 of them, or COUNT. On one core, as a batch computes them. Four ways take turns: `trace`, the tracer
alone on scenes made before; `render`, the library's function in a loop, which also sets the parameter and hands
out the picture; `write`, that and writing an EXR and a PNG; and `batch`, the machinery of the command, which writes
records besides.
"""

import json
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from programs import SCENE, seconds, set_up

from raytrace_jax import load_scene, render, set_parameters
from raytrace_jax.batch.jobs import expand
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import run_and_record
from raytrace_jax.images.png import write_png
from raytrace_jax.report.films import write_film
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer.pixels import picture_pixels, pixel_colors
from raytrace_jax.tracer.settings import ResolvedSettings

COUNT = 200
SETTINGS = ResolvedSettings(size=(320, 240))
PLAN = """scenes = ['{scene}']
[settings]
size = [320, 240]
[grid]
vitreous.ior = {{ start = 1.0, stop = 2.4, count = {count} }}
[render]
"""


def main() -> None:
    cache, rounds, *more = sys.argv[1:]
    count = int(more[0]) if more else COUNT
    set_up(cache, devices=1)
    with jax.enable_x64(True):
        compiles = []

        def listen(event: str, duration_secs: float, **_: str | int) -> None:
            if "backend_compile" in event:
                compiles.append(event)

        jax.monitoring.register_event_duration_secs_listener(listen)
        ways = build(count)
        for run in ways.values():
            run()
        before = len(compiles)
        turns = [{name: 1e3 * seconds(run) / count for name, run in ways.items()} for _ in range(int(rounds))]
    print(json.dumps({"turns": turns, "compiles": len(compiles) - before}))


def build(count: int):
    """The ways, each a function without arguments that makes all of so many pictures."""
    scene, indices = load_scene(SCENE), np.linspace(1.0, 2.4, count).tolist()
    stacks = [map_scenes(lambda x: np.asarray(x)[None], set_parameters(scene, {"vitreous.ior": n})) for n in indices]
    points = picture_pixels(scene, SETTINGS).points

    def trace():
        for moved in stacks:
            pixel_colors(moved, points, SETTINGS)

    def render_all():
        for ior in indices:
            np.asarray(render(set_parameters(scene, {"vitreous.ior": ior}), SETTINGS).image)

    def write():
        with tempfile.TemporaryDirectory() as folder:
            for number, ior in enumerate(indices):
                moved = set_parameters(scene, {"vitreous.ior": ior})
                film = render(moved, SETTINGS)
                write_film(Path(folder) / f"{number}.exr", film, moved, SETTINGS, half=False)
                write_png(Path(folder) / f"{number}.png", np.asarray(film.image))

    def batch():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "plan.toml").write_text(PLAN.format(scene=SCENE.as_posix(), count=count))
            for job in expand(read_plan(folder / "plan.toml")):
                run_and_record(job, folder)

    return {"trace": trace, "render": render_all, "write": write, "batch": batch}


if __name__ == "__main__":
    main()
