"""One series of sizes: `growing.py SERIES DEVICES [COUNT]` prints a JSON line for each size.

Each line has milliseconds and more; with a COUNT there are only the first so many sizes.
"""

import itertools
import json
import sys
from collections.abc import Callable, Iterator

import jax
import numpy as np
from fresh import peak_megabytes
from programs import SCENE, Program, seconds, set_up

from raytrace_jax import RenderSettings, Scene, load_scene, picture_derivatives, render
from raytrace_jax.scene.reader import parse_scene
from raytrace_jax.scene.writer import format_scene

PIXELS = ((160, 120), (320, 240), (640, 480), (1280, 960), (2560, 1920), (3840, 2880))
SHAPES = (4, 16, 64, 256, 1024)
PARAMETERS = (1, 2, 4, 8, 16, 32)
BOUNCES = (0, 1, 2, 4, 8, 16)
SMALL = (320, 240)
LEAST_RUNS, LEAST_SECONDS = 3, 1.0
"""A program runs at least so often and so long; its least time counts."""


def picture(scene: Scene, settings: RenderSettings) -> Program:
    """The picture."""
    return lambda: jax.block_until_ready(render(scene, settings).image)


def jacobian(scene: Scene, settings: RenderSettings, names: list[str]) -> Program:
    """The picture and its derivatives by some numbers, in forward mode."""
    return lambda: jax.block_until_ready(picture_derivatives(scene, names, settings).values)


def with_spheres(scene: Scene, count: int) -> Scene:
    """The scene with a cube of small opaque balls in place of its own, `count` of them."""
    text = format_scene(scene)
    kept = text[: text.index("sphere ")]
    side = round(count ** (1 / 3) + 0.499)
    places = np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3)[:count]
    centers = [1, 1, -6] + places * ([6, 4, 4] / np.maximum(side - 1, 1))
    balls = (
        f"sphere s{k} {{ material {('red', 'blue', 'yellow')[k % 3]} center {x} {y} {z} radius {1 / side} }}\n"
        for k, (x, y, z) in enumerate(centers)
    )
    return parse_scene(kept + "".join(balls), dtype=scene.camera.viewpoint.dtype)


def by_pixels(scene: Scene) -> Iterator[tuple[int, Program]]:
    """Pictures of more and more pixels."""
    for size in PIXELS:
        yield size[0] * size[1], picture(scene, RenderSettings(size=size))


def by_shapes(scene: Scene) -> Iterator[tuple[int, Program]]:
    """Scenes of more and more balls."""
    for count in SHAPES:
        yield count, picture(with_spheres(scene, count), RenderSettings(size=SMALL))


def by_parameters(scene: Scene) -> Iterator[tuple[int, Program]]:
    """Derivatives by more and more numbers: those of the balls, lights and walls."""
    names = ["vitreous.ior", "vitreous.radius", *(f"vitreous.center.{axis}" for axis in "xyz")]
    for block in ("centerback", "backleft", "topright"):
        names += [f"{block}.{vector}.{axis}" for vector, axes in (("location", "xyz"), ("emissivity", "rgb"))
                  for axis in axes]  # fmt: skip
    names += [f"{material}.{what}.{axis}" for material in ("green", "red", "blue") for what in ("ambient",)
              for axis in "rgb"]  # fmt: skip
    for count in PARAMETERS:
        yield count, jacobian(scene, RenderSettings(size=SMALL), names[:count])


def by_bounces(scene: Scene) -> Iterator[tuple[int, Program]]:
    """Paths of more and more bounces."""
    for bounces in BOUNCES:
        yield bounces, picture(scene, RenderSettings(size=SMALL, max_bounces=bounces))


SERIES: dict[str, Callable[[Scene], Iterator[tuple[int, Program]]]] = {
    "pixels": by_pixels,
    "shapes": by_shapes,
    "parameters": by_parameters,
    "bounces": by_bounces,
}


def main() -> None:
    name, devices, *count = sys.argv[1:]
    set_up(devices=int(devices))
    with jax.enable_x64(True):
        programs = SERIES[name](load_scene(SCENE))
        for size, program in itertools.islice(programs, int(count[0]) if count else None):
            first = seconds(program)
            runs = [seconds(program)]
            while len(runs) < LEAST_RUNS or sum(runs) < LEAST_SECONDS:
                runs.append(seconds(program))
            found = {"size": size, "ms": 1e3 * min(runs), "first_s": first, "peak_mb": peak_megabytes()}
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
