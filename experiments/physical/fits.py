"""Fits of glass in pictures by POV-Ray: how far from the truth, with which error bar, and with which last word?

    python experiments/physical/fits.py [CASE ...]

Needs the program `povray` (Debian package `povray`). Each case renders its target, fits it from a start that is off, in
a process of its own, and writes its row to `fits.json` at once; a case that is there already is not done again. Without
names all cases are done, then the table is printed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from render_pov_ray import one_channel, render

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from numpy_physical import channel_iors  # noqa: E402
from physical_scenes import Camera, Checker, Material, Rectangle, Scene, Sphere, scene_text  # noqa: E402

from raytrace_jax import read_picture  # noqa: E402

RESULTS = HERE / "fits.json"
FAR = 1e-3
"""An estimate that is off by more is not the truth."""

EYE = Camera((160, 120), (0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
SQUARES = Checker((0.1, 0.15, 0.25), (0.9, 0.85, 0.8), 0.8, (0.13, 0.07))
BOARD = Rectangle(Material(emission=(1, 1, 1), texture=SQUARES), (0, 0, -2.5), (6, 0, 0), (0, 6, 0))
FLINT = (1.6146, 1.6222, 1.6331)


def glass(ior, **more):
    return Material(transmission=1, ior=ior, **more)


def before_board(*balls, eye=EYE):
    return Scene(eye, [BOARD, *balls], radiance=(0.05, 0.06, 0.08), max_bounces=12, least_weight=1e-6)


BALL = Sphere(glass(1.5168), (0.12, -0.07, 0.15), 1)
TWO_BALLS = before_board(
    Sphere(glass(1.3), (-0.5, 0.14, 0.345), 0.7),
    Sphere(glass(1.85), (0.7, -0.1, -0.4), 0.8),
    eye=replace(EYE, viewpoint=(1.1, 0.8, 4.6), lookat=(0.1, -0.05, -0.3), fov=37),
)
BUBBLE = before_board(BALL, Sphere(glass(1.0), (0.3, 0.1, 0.3), 0.4))
TINTED = before_board(replace(BALL, material=glass(1.5168, absorption=(0.1, 0.3, 0.6))))
CROWN = before_board(replace(BALL, material=glass(1.473)))
CHANNELS = before_board(replace(BALL, material=glass(FLINT)))
DISPERSIVE = before_board(replace(BALL, material=glass(1.6200, abbe=36.4)))
SF11 = before_board(replace(BALL, material=glass((1.781498, 1.791155, 1.813442))), eye=replace(EYE, pixeldim=(80, 60)))
"""SCHOTT's N-SF11 of the catalogue: `fit_flint.exr` of `tests/physical_pictures`."""
SMALL = before_board(BALL, eye=replace(EYE, pixeldim=(80, 60)))
NEAR = MappingProxyType({"m1.ior": 1.51, "s1.center": (0.125, -0.075, 0.155)})


class Case(NamedTuple):
    """A target, and what is fitted to it.

    Args:
        scene: what it shows.
        free: the parameters to be fitted.
        start: where the fit begins.
        samples: of the target, a pixel and side.
        noise: standard deviation of white noise that is added to it.
        seed: of that noise.
        picture: the target instead, one of `tests/physical_pictures`.
        binning: of the target's pixels.
        search: whether starts are looked for.
        stated: what the fit's scene has otherwise than the target's: a hidden mismatch.
    """

    scene: Scene = before_board(BALL)
    free: tuple[str, ...] = ("m1.ior", "s1.center")
    start: MappingProxyType = NEAR
    samples: int = 8
    noise: float = 0.0
    seed: int = 1
    picture: str = ""
    binning: int = 1
    search: bool = False
    stated: MappingProxyType = MappingProxyType({})


CASES = {
    "ball": Case(),
    "ball, 6 x 6": Case(samples=6),
    "ball, 16 x 16": Case(samples=16),
    "ball, 8 x 8 binned by 2": Case(scene=before_board(BALL, eye=replace(EYE, pixeldim=(320, 240))), binning=2),
    "ball, 80 x 60": Case(scene=SMALL),
    "ball, noise 1/255": Case(noise=1 / 255),
    "ball, searched": Case(search=True, start=MappingProxyType({"m1.ior": 1.4, "s1.center": (0.0, 0.0, 0.0)})),
    "two balls": Case(
        TWO_BALLS,
        ("m1.ior", "m2.ior", "s1.center", "s2.center"),
        MappingProxyType(
            {"m1.ior": 1.31, "m2.ior": 1.84, "s1.center": (-0.49, 0.13, 0.35), "s2.center": (0.69, -0.09, -0.41)}
        ),
    ),
    "bubble": Case(
        BUBBLE,
        ("m1.ior", "s1.center", "s2.center"),
        MappingProxyType({"m1.ior": 1.515, "s1.center": (0.122, -0.072, 0.152), "s2.center": (0.305, 0.105, 0.305)}),
    ),
    "tinted": Case(
        TINTED,
        ("m1.ior", "m1.absorption", "s1.center"),
        MappingProxyType({**NEAR, "m1.absorption": (0.15, 0.25, 0.5)}),
    ),
    "three indices": Case(CHANNELS, start=MappingProxyType({**NEAR, "m1.ior": (1.62, 1.62, 1.62)})),
    "Blender, EXR": Case(CROWN, start=MappingProxyType({**NEAR, "m1.ior": 1.48}), picture="blender_ball.exr"),
    "Blender, 8-bit PNG": Case(CROWN, start=MappingProxyType({**NEAR, "m1.ior": 1.48}), picture="blender_ball.png"),
    "abbe": Case(
        DISPERSIVE, ("m1.ior", "m1.abbe", "s1.center"), MappingProxyType({**NEAR, "m1.ior": 1.61, "m1.abbe": 40.0})
    ),
    "two balls, searched": Case(
        TWO_BALLS,
        ("m1.ior", "m2.ior", "s1.center", "s2.center"),
        MappingProxyType({"m1.ior": 1.4, "m2.ior": 1.7, "s1.center": (-0.4, 0.05, 0.4), "s2.center": (0.6, 0.0, -0.3)}),
        search=True,
    ),
    "field of view": Case(free=("m1.ior", "s1.center", "eye.fov"), start=MappingProxyType({**NEAR, "eye.fov": 40.1})),
    "camera's place": Case(
        free=("m1.ior", "s1.center", "eye.viewpoint"),
        start=MappingProxyType({**NEAR, "eye.viewpoint": (0.01, -0.01, 5.02)}),
    ),
    "board 0.1 % larger": Case(stated=MappingProxyType({"t0.square": 0.8008})),
    "board nearer": Case(stated=MappingProxyType({"s0.center": (0, 0, -2.4975)})),
    "radius 0.1 % larger": Case(stated=MappingProxyType({"s1.radius": 1.001})),
    "fov 0.1 % larger": Case(stated=MappingProxyType({"eye.fov": 40.04})),
}


def far_start(seed):
    """A start of `BALL`'s fit: any index from 1.2 to 2, the centre .4 away in any direction."""
    random = np.random.default_rng(seed)
    away = random.normal(size=3)
    center = np.add(BALL.center, 0.4 * away / np.linalg.norm(away))
    return MappingProxyType({"m1.ior": random.uniform(1.2, 2), "s1.center": tuple(center.tolist())})


STARTS = {f"start {seed}": Case(search=True, start=far_start(seed)) for seed in range(32)}
NOISE = {f"noise {seed}": Case(noise=1 / 255, seed=seed, scene=SMALL) for seed in range(40)}
CASES |= STARTS | NOISE


def make_target(case):
    """What POV-Ray makes of a case's scene, or the picture that is stored: (3, height, width)."""
    if case.picture:
        # Blender's PNG does not say how its numbers were made.
        return read_picture(ROOT / "tests" / "physical_pictures" / case.picture, transfer="srgb")
    width, height = case.scene.camera.pixeldim
    large = replace(case.scene.camera, pixeldim=(width * case.samples, height * case.samples))
    scene = replace(case.scene, camera=large)
    materials = [shape.material for shape in scene.shapes]
    indices = {k: channel_iors(m) for k, m in enumerate(materials) if np.ndim(m.ior) or m.abbe is not None}
    if indices:
        picture = np.stack([render(one_channel(scene, c, indices))[..., c] for c in range(3)], axis=-1)
    else:
        picture = render(scene)
    side = case.samples * case.binning
    means = picture.astype(float).reshape(height // case.binning, side, width // case.binning, side, 3).mean((1, 3))
    return np.moveaxis(means + np.random.default_rng(case.seed).normal(0, case.noise or 1e-300, means.shape), -1, 0)


def run(name):
    """The row of a case: estimates and errors by parameter, the last word, the seconds that the fit took."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import raytrace_jax as rj

    case = CASES[name]
    target = make_target(case)
    truth = rj.parse_scene(scene_text(case.scene))
    scene = rj.set_parameters(truth, {**case.start, **case.stated})
    begun = time.monotonic()
    settings = rj.RenderSettings(size=target.shape[:0:-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = rj.fit(scene, target, list(case.free), settings, options=rj.FitOptions(search=case.search))
    seconds = time.monotonic() - begun
    exact = np.array([float(truth[name]) for name in found.names])
    return {
        "names": found.names,
        "error": (found.value - exact).tolist(),
        "standard_error": found.standard_error.tolist(),
        "total_error": np.hypot(found.standard_error, found.systematic_error).tolist(),
        "grid": found.target_samples,
        "rms": found.rms_residual,
        "status": found.status,
        "message": found.message,
        "seconds": round(seconds, 1),
    }


def results():
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else {}


def summary(rows):
    """How many starts ended where, and how the errors of noisy targets compare with what is said of them."""
    starts = [row for name, row in rows.items() if name in STARTS]
    if starts:
        right = [np.all(np.abs(row["error"]) < FAR) for row in starts]
        false = sum(row["status"] == "converged" and not good for row, good in zip(starts, right, strict=True))
        print(f"\n{sum(right)} of {len(starts)} starts ended at the truth, {false} converged elsewhere")
    noisy = [row for name, row in rows.items() if name in NOISE]
    if noisy:
        error, bound = (np.array([row[key] for row in noisy]) for key in ("error", "standard_error"))
        ratio = np.sqrt(np.mean((error / bound) ** 2, axis=0))
        words = {word: sum(row["status"] == word for row in noisy) for word in sorted({r["status"] for r in noisy})}
        print(f"\n{len(noisy)} noisy targets, errors over standard errors, root mean square: {ratio.round(2)}; {words}")


def table(rows):
    """Of each case the error of the index and the largest of the others, in themselves and in total errors."""
    print("| case | index off by | others | total errors | grid | last word | s |\n|---|---|---|---|---|---|---|")
    for name, row in rows.items():
        if name in STARTS or name in NOISE:
            continue
        off, total = np.abs(row["error"]), np.array(row["total_error"])
        is_index = np.array([".ior" in one for one in row["names"]])
        others = f"{off[~is_index].max():.1e}" if (~is_index).any() else ""
        print(
            f"| {name} | {off[is_index].max():.1e} | {others} | {np.max(off / total):.1f} | {row['grid']} |"
            f" {row['status']} | {row['seconds']:.0f} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--one", action="store_true", help="run one case in this process and print its row")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(run(given.cases[0])))
        sys.exit()
    for name in given.cases or CASES:
        if name in results():
            continue
        with tempfile.TemporaryFile("w+") as errors:
            command = [sys.executable, __file__, "--one", name]
            done = subprocess.run(command, stdout=subprocess.PIPE, stderr=errors, text=True)
            errors.seek(0)
            if done.returncode:
                print(f"{name}: {errors.read()[-2000:]}", file=sys.stderr)
                continue
        row = json.loads(done.stdout.splitlines()[-1])
        RESULTS.write_text(json.dumps({**results(), name: row}, indent=1))
        print(name, row["status"], row["error"][0], row["seconds"], flush=True)
    table(results())
    summary(results())
