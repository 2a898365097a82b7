"""Renders ten scenes with a ball of glass by POV-Ray: the light that `chain.py` photographs.

    python experiments/camera/pictures.py [FOLDER] [NAME ...]

Needs the program `povray` (Debian package `povray`). For each scene the folder (`output/photos` without one) gets
`NAME.exr`, linear, each pixel the mean of 12 x 12 samples on a regular grid; `NAME_truth.txt`, the scene; and
`NAME_guess.txt`, the same with `ball0.ior` off by .05 and `ball0.center` by .1. No light
exceeds .88: nothing saturates.

The tests' picture is `python experiments/camera/pictures.py tests/physical_pictures photographed_ball`.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from raytrace_jax import write_exr

SIZE = (320, 240)
SAMPLES = 12
INDEX_OFF, CENTER_OFF = 0.05, 0.1
PAINT, SKY = "paint.exr", "soft_sky.exr"

BACKDROP = "rectangle backdrop {{ material board center {0} right 5 0 0 up 0 4 0 }}"
FLOOR = "rectangle floor {{ material board center {0} right 6 0 0 up 0 0 -6 }}"
LEVEL = "plane floor {{ material board normal 0 1 0 point {0} }}"
TILTED = "rectangle backdrop {{ material board center {0} right 4 0 1.2 up 0.6 3.6 -2 }}"


def numbers(values):
    """As a scene's file has them."""
    return " ".join(f"{value:.6g}" for value in values)


def checker(first, second, square, offset=(0.13, 0.07)):
    """The texture of a board."""
    return f"kind checker color1 {numbers(first)} color2 {numbers(second)} square {square} offset {numbers(offset)}"


PAINTED = f"kind image file {PAINT}"
BLUE = checker((0.08, 0.12, 0.22), (0.82, 0.78, 0.72), 0.4)
RED = checker((0.35, 0.06, 0.05), (0.75, 0.72, 0.66), 0.5)
GREEN = checker((0.05, 0.22, 0.10), (0.60, 0.64, 0.50), 0.45, (0.3, 0.2))
GREY = checker((0.10, 0.10, 0.10), (0.70, 0.70, 0.70), 0.4)


class View(NamedTuple):
    """A ball of glass, what is around it, and the camera.

    Args:
        ior: the ball's index of refraction.
        center: of the ball.
        radius: of the ball.
        eye: where the camera is.
        lookat: where it looks.
        fov: its horizontal field of view, in degrees.
        texture: of the board.
        board: the rectangle or plane that shows it.
        place: of that.
        more: other lines of the scene.
        sky: radiance of the background, times the soft sky unless `plain`.
        plain: whether the background has one colour.
        size: of the picture, in pixels.
    """

    ior: float
    center: tuple[float, float, float]
    radius: float = 1.0
    eye: tuple[float, float, float] = (0.0, 0.0, 5.0)
    lookat: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov: float = 40.0
    texture: str = BLUE
    board: str = BACKDROP
    place: tuple[float, float, float] = (0.0, 0.0, -2.5)
    more: tuple[str, ...] = ()
    sky: tuple[float, float, float] = (1.0, 1.0, 1.0)
    plain: bool = False
    size: tuple[int, int] = SIZE


ABOVE = {"eye": (0.4, 2.2, 5.4), "lookat": (0.0, -0.3, -0.2), "place": (0.0, -1.2, 0.0)}
DIM = {"sky": (0.05, 0.06, 0.08), "plain": True}
STEEL = "material steel { reflectivity 0.9 }", "sphere ball1 { material steel center 1.5 -0.4 -1.2 radius 0.6 }"
FLINT = "material ball1 { transmission 1 ior 1.7 }", "sphere ball1 { material ball1 center -1.1 0.6 -0.7 radius 0.5 }"

VIEWS = {
    "water": View(1.333, (0.10, -0.05, 0.10), eye=(0.4, 0.3, 4.9))._replace(**DIM),
    "fused_silica": View(1.4585, (-0.15, 0.00, 0.00), texture=RED, board=FLOOR)._replace(**ABOVE),
    "acrylic": View(1.491, (0.05, 0.12, -0.20), texture=PAINTED, eye=(0.6, 0.5, 4.8))._replace(**DIM),
    "crown": View(1.5168, (0.12, -0.07, 0.15), eye=(-0.7, 0.4, 4.8), texture=GREEN, board=TILTED),
    "polycarbonate": View(1.585, (0.30, -0.20, 0.30), 0.8, texture=PAINTED, board=FLOOR)._replace(**ABOVE),
    "light_flint": View(1.62, (-0.25, 0.10, 0.00), 0.9, texture=GREY, fov=36, more=STEEL),
    "flint": View(1.6727, (0.20, -0.10, 0.40), 0.8, eye=(0.5, 0.9, 4.9), more=FLINT, texture=RED),
    "sapphire": View(1.76, (0.00, -0.15, 0.20), 0.85, texture=GREEN, board=LEVEL, more=STEEL)._replace(**ABOVE),
    "heavy_flint": View(1.8052, (-0.10, 0.05, 0.10), texture=PAINTED, board=TILTED),
    "lanthanum": View(1.9, (0.15, 0.08, -0.30), 1.1, texture=GREY, eye=(0.2, -0.5, 5.2))._replace(**DIM),
}
BRIGHT = {"sky": (0.25, 0.3, 0.4), "plain": True}
SMALL = {
    "photographed_ball": View(1.5168, (0.12, -0.07, 0.15), texture=RED, board=FLOOR, size=(160, 120))._replace(
        **ABOVE, **BRIGHT
    )
}


def scene_text(view, what):
    """A scene's file.

    Args:
        view: what it shows.
        what: its first line, a comment.
    """
    width, height = view.size
    return "\n".join(
        [
            f"# {what}",
            "settings main { model physical mapping center max_bounces 12 least_weight 1e-6 }",
            f"camera eye {{ pixeldim {width} {height} viewpoint {numbers(view.eye)} lookat {numbers(view.lookat)}"
            f" up 0 1 0 fov {view.fov:g} }}",
            f"background sky {{ radiance {numbers(view.sky)}{'' if view.plain else ' texture soft'} }}",
            *([] if view.plain else [f"texture soft {{ kind image file {SKY} wrap repeat }}"]),
            f"texture board {{ {view.texture} }}",
            "material board { emission 1 1 1 texture board }",
            f"material ball0 {{ transmission 1 ior {view.ior:.6g} }}",
            view.board.format(numbers(view.place)),
            f"sphere ball0 {{ material ball0 center {numbers(view.center)} radius {view.radius:g} }}",
            *view.more,
            "",
        ]
    )


def guess(view, seed):
    """The view with a wrong index and a wrong centre."""
    random = np.random.default_rng(seed)
    away = random.normal(size=3)
    center = np.add(view.center, CENTER_OFF * away / np.linalg.norm(away)).round(3)
    return view._replace(ior=round(view.ior + random.choice([-1, 1]) * INDEX_OFF, 4), center=tuple(center.tolist()))


def paint():
    """A picture for boards, (3, 192, 240): soft spots of colour under a grid of darker lines, from .05 to .85."""
    random = np.random.default_rng(7)
    fine, coarse = (
        ndimage.gaussian_filter(random.normal(size=(3, 192, 240)), (0, sigma, sigma), mode="wrap") for sigma in (4, 12)
    )
    spots = np.clip(0.5 + 0.15 * fine / fine.std() + 0.2 * coarse / coarse.std(), 0.15, 1)
    row, column = np.mgrid[:192, :240]
    lines = np.where((row % 24 < 3) | (column % 24 < 3), 0.3, 1.0)
    return 0.05 + 0.8 * spots * lines


def soft_sky():
    """A sky all around, (3, 64, 128): from dark ground to a bright horizon to blue, brighter to the right; up to .6."""
    down, across = np.mgrid[:64, :128]
    up, side = np.pi * (0.5 - (down + 0.5) / 64), 2 * np.pi * ((across + 0.5) / 128 - 0.5)
    ground, horizon, zenith = (
        np.reshape(c, (3, 1, 1)) for c in ((0.06, 0.05, 0.05), (0.5, 0.48, 0.45), (0.1, 0.2, 0.4))
    )
    above = np.clip(up / 1.3, 0, 1)
    light = np.where(up > 0, horizon + (zenith - horizon) * above, ground + (horizon - ground) * np.exp(up / 0.1))
    return light * (1 + 0.2 * np.sin(side))


def render(scene, size):
    """(3, height, width): what POV-Ray makes of a scene's file, linear, from 0 to 1; the mean of each pixel's grid."""
    width, height = size
    with tempfile.TemporaryDirectory() as folder:
        export = [
            sys.executable,
            "-m",
            "raytrace_jax",
            "export",
            str(scene),
            "--to",
            "pov",
            "-o",
            f"{folder}/scene.pov",
        ]
        subprocess.run(export, check=True, stdout=subprocess.DEVNULL)
        large = f"+W{width * SAMPLES} +H{height * SAMPLES}"
        command = f"povray +Iscene.pov +Oscene.ppm {large} +FP16 File_Gamma=1.0 -A -D -GA"
        subprocess.run(command.split(), check=True, capture_output=True, cwd=folder)
        data = (Path(folder) / "scene.ppm").read_bytes()[-6 * width * height * SAMPLES**2 :]
    grids = np.frombuffer(data, ">u2").reshape(height, SAMPLES, width, SAMPLES, 3)
    return np.moveaxis(grids.mean((1, 3)) / 65535, -1, 0)


def make(name, folder):
    """Write a view's picture, its truth and its guess, and say how bright it is and how long it took."""
    begun = time.monotonic()
    views = VIEWS | SMALL
    view = views[name]
    truth = folder / f"{name}_truth.txt"
    text = scene_text(view, f"What {name}.exr shows.")
    for file, picture in ((PAINT, paint), (SKY, soft_sky)):
        if file in text and not (folder / file).exists():
            write_exr(folder / file, picture(), half=True)
    truth.write_text(text)
    off = guess(view, list(views).index(name))
    (folder / f"{name}_guess.txt").write_text(
        scene_text(off, f"What {name}.exr shows; ball0's index and centre are off.")
    )
    picture = render(truth, view.size)
    write_exr(folder / f"{name}.exr", picture, half=name in SMALL)
    seconds = time.monotonic() - begun
    print(f"{name}: index {view.ior}, centre {numbers(view.center)}, brightest {picture.max():.3f}, {seconds:.0f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("output/photos"), metavar="FOLDER")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(VIEWS | SMALL))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for one in given.names or VIEWS:
        make(one, given.folder)
