"""Derivative pictures of random sizes against differences: does any one pixel hold what the differences do not have?

    python experiments/edge_gradients/random_sizes.py [--sizes N] [--sides 40 200] [--reference DIR]

For each of four scenes some random sizes, and at each an index of refraction, a coordinate of a centre, a radius and a
coordinate of the viewpoint, 60 pictures in all. The first run makes the differences, which takes about an hour on two
busy cores; they are kept in files, and a run that was interrupted goes on where it stopped.
"""

import argparse
import pathlib
import sys

import jax
import numpy as np
from cases import CASES, Case
from reference import reference_derivative

from raytrace_jax import RenderSettings, load_scene, picture_derivatives
from raytrace_jax.report.differences import correlation, relative_error

SEED = 17
SIZES = 15
LEAST_SIDE, MOST_SIDE = 40, 200
RAYS = 6e6
"""About as many has a picture of the differences, within 20 to 48 rays a side of a pixel."""

SCENES = [CASES[0], *CASES[2:5]]
"""One for each of the scenes with the course's camera."""


def draw_cases(count: int, least: int, most: int) -> list[Case]:
    """Scenes in turn, each with a random size and four parameters, by steps of as many samples as in `cases`."""
    random = np.random.default_rng(SEED)
    found = []
    for number in range(count):
        case = SCENES[number % len(SCENES)]
        width = int(random.integers(least, most, endpoint=True))
        height = int(random.integers(least, width, endpoint=True))
        samples = int(np.clip(np.sqrt(RAYS / (width * height)), 20, 48))
        longer = case.size[0] * case.samples / (width * samples)
        wanted = (".ior", f".center.{random.choice(list('xyz'))}", ".radius")
        steps = {name: step * longer for name, step in case.steps.items() if name.endswith(wanted)}
        steps[f"cam1.viewpoint.{random.choice(list('xyz'))}"] = case.steps["cam1.viewpoint.x"] * longer
        found.append(Case(case.name, case.path, (width, height), samples, steps, {}))
    return found


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, default=SIZES, help="so many random sizes, of four pictures each")
    sides = {"nargs": 2, "type": int, "default": [LEAST_SIDE, MOST_SIDE], "metavar": ("LEAST", "MOST")}
    parser.add_argument("--sides", **sides, help="of the pictures, in pixels")
    parser.add_argument("--reference", type=pathlib.Path, default=pathlib.Path("edge_gradients_reference"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    heads = (
        "scene",
        "size",
        "parameter",
        "two steps",
        "correlation",
        "L2",
        "largest pixel",
        "holds %",
        "is",
        "differs",
    )
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for case in draw_cases(arguments.sizes, *arguments.sides):
        names = list(case.steps)
        found = picture_derivatives(load_scene(case.path), names, RenderSettings(size=case.size, edges="aware"))
        for name, values in zip(names, np.asarray(found.values), strict=True):
            coarser, difference = (reference_derivative(arguments.reference, case, name, halved) for halved in (0, 1))
            squares = np.sum(values**2, axis=0)
            row, column = np.unravel_index(np.argmax(squares), squares.shape)
            channel = np.argmax(np.abs(values[:, row, column]))
            cells = [
                case.name,
                "{} x {}".format(*case.size),
                f"`{name}`",
                f"{relative_error(coarser, difference):.3f}",
                f"{correlation(values, difference):.3f}",
                f"{relative_error(values, difference):.3f}",
                f"{column}, {row}",
                f"{100 * squares[row, column] / np.sum(squares):.1f}",
                f"{values[channel, row, column]:.3g}",
                f"{difference[channel, row, column]:.3g}",
            ]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
