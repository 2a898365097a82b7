"""Fits of targets that are what the scene says: how many does the check of the model doubt, how many are wrong?

    python experiments/estimates/controls.py [NAME ...] [--targets 20] [--size 40 30]

Every target is a picture of the scene, or one that another program made of it, with noise of 1/255 of another seed; the
fit starts at the truth and is told nothing of the noise. `model_incomplete` is a false alarm, and so is "far from
explained"; `wrong` are those that say `converged` more than 4 total errors from the truth.
"""

import argparse
import dataclasses
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np
from basin import CASES as SCENES

from raytrace_jax import FitOptions, RenderSettings, fit, load_scene, read_picture, render, set_parameters
from raytrace_jax.scene.setting_words import ModelName, Reflectance

SIGMA = 1 / 255
DATA = SCENES["assignment"].path.parent


class Control(NamedTuple):
    """What a target shows.

    Args:
        scene: its file.
        free: the parameters to be fitted.
        samples: a pixel and side; 1 is fitted as points, more as means.
        model: the scene's.
        reflectance: of the assignment's model; None is the model's own.
        moved: numbers of the scene that the picture has otherwise.
        picture: another program's, of which a window of the given size about `middle` (column, row) is taken.
    """

    scene: Path = SCENES["assignment"].path
    free: tuple[str, ...] = ("vitreous.ior", "vitreous.center")
    samples: int = 1
    model: ModelName = "classic"
    reflectance: Reflectance | None = None
    moved: Mapping[str, float | tuple[float, ...]] = MappingProxyType({})
    picture: Path | None = None
    middle: tuple[int, int] = (0, 0)


PEBBLES = Control(SCENES["pebbles"].path, ("ball.ior", "ball.center"))
CHECKPOINTS = Control(DATA / "checkpoints.txt", ("lens.ior", "lens.center"), model="additive")
MOVED = {"vitreous.ior": 1.45, "vitreous.center": (4.15, 2.45, -1.25)}
CONTROLS = {
    "assignment, points": Control(),
    "assignment, means": Control(samples=16),
    "pebbles, points": PEBBLES,
    "pebbles, means": PEBBLES._replace(samples=16),
    "checkpoints, points": CHECKPOINTS,
    "checkpoints, means": CHECKPOINTS._replace(samples=16),
    "course, alpha": Control(reflectance="none", picture=DATA / "course_alpha.exr", middle=(330, 150)),
    "course, schlick": Control(moved=MOVED, picture=DATA / "course_schlick_moved.exr", middle=(330, 150)),
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", default=list(CONTROLS))
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--size", type=int, nargs=2, default=(40, 30), metavar=("W", "H"))
    parser.add_argument("--seed", type=int, default=0, help="of the first target")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    print("| targets | size | converged | false alarms | wrong | largest error / total error | seconds each |")
    print("|---|---|---|---|---|---|---|", flush=True)
    width, height = arguments.size
    for name in arguments.names:
        print(f"| {name} | {row(CONTROLS[name], width, height, arguments.targets, arguments.seed)} |", flush=True)


def row(control: Control, width: int, height: int, targets: int, seed: int) -> str:
    """The cells of one control; what is a false alarm or wrong is told on stderr."""
    scene = set_parameters(load_scene(control.scene, model=control.model), control.moved)
    settings = RenderSettings(size=(width, height), model=control.model, reflectance=control.reflectance)
    if control.picture is None:
        image = np.asarray(render(scene, dataclasses.replace(settings, samples=control.samples)).image)
    else:
        whole = read_picture(control.picture)
        left, top = control.middle[0] - width // 2, control.middle[1] - height // 2
        image = whole[:, top : top + height, left : left + width]
        settings = dataclasses.replace(settings, size=whole.shape[:0:-1], crop=(left, top, width, height))
    statuses, alarms, wrong, largest, began = Counter(), 0, 0, 0.0, time.perf_counter()
    for number in range(seed, seed + targets):
        target = image + np.random.default_rng(number).normal(0, SIGMA, image.shape)
        sampling = "point" if control.samples == 1 else "box"
        result = fit(scene, target, control.free, settings, options=FitOptions(search=False, target_sampling=sampling))
        truth = np.array([float(scene[name]) for name in result.names])
        errors = np.abs(result.value - truth) / result.total_error
        alarm = result.status == "model_incomplete" or "far from explained" in result.message
        missed = result.status == "converged" and np.max(errors) > 4
        statuses[result.status] += 1
        alarms, wrong, largest = alarms + alarm, wrong + missed, max(largest, np.max(errors))
        if alarm or missed or result.status != "converged":
            causes = ", ".join(f"{cause.words} ({cause.score:.1f})" for cause in result.check.causes)
            print(f"  {number}: {result.status}, {np.round(errors, 1)}, {causes}; {result.message}", file=sys.stderr)
    each = f"{(time.perf_counter() - began) / targets:.1f}"
    counts = f"{statuses['converged']} of {targets} | {alarms} | {wrong}"
    return f"{width} x {height} | {counts} | {largest:.1f} | {each}"


if __name__ == "__main__":
    sys.exit(main())
