"""Fit a box-filtered picture from random starts; print where each ended and how many found the truth.

    python experiments/estimates/basin.py assignment [--starts 64] [--size 160 120] [--seed 0]
    python experiments/estimates/basin.py pebbles [--starts 64] [--size 160 120] [--seed 0]

The truth is the scene file's. A start is at the truth if its index ends within 5e-3 and its center within 2e-2 of it;
what ends elsewhere should not say `converged`.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import jax
import numpy as np

from raytrace_jax import RenderSettings, fit, load_scene, render, set_parameters

HERE = Path(__file__).parent
SIZE = (160, 120)
TARGET_SAMPLES = 12
"""Not one of the numbers with which the fit supersamples."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, the ball in it, the range of the indices to start from, and how far off each coordinate may be."""

    path: Path
    ball: str
    index: tuple[float, float]
    offset: float


CASES = {
    "assignment": Case(HERE.parent.parent / "data" / "vitreous.txt", "vitreous", (1.05, 2.5), 0.8),
    "pebbles": Case(HERE / "scenes" / "pebbles.txt", "ball", (1.2, 1.8), 0.3),
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--first", type=int, default=0, help="number of the first start")
    parser.add_argument("--size", nargs=2, type=int, default=SIZE, metavar=("W", "H"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)

    case, size = CASES[arguments.case], tuple(arguments.size)
    scene, names = load_scene(case.path), (f"{case.ball}.ior", f"{case.ball}.center")
    truth = np.concatenate([np.atleast_1d(scene[name]) for name in names])
    target = np.asarray(render(scene, RenderSettings(size=size, samples=TARGET_SAMPLES)).image)
    random = np.random.default_rng(arguments.seed)
    starts = [
        np.r_[random.uniform(*case.index), truth[1:] + random.uniform(-1, 1, 3) * case.offset] for _ in range(1000)
    ]

    print("| start | ior, center | status | error of ior | of center | minima | steps | seconds |\n|" + "---|" * 8)
    found, honest, index_errors, center_errors = 0, 0, [], []
    for number in range(arguments.first, arguments.starts):
        start, began = starts[number], time.perf_counter()
        begin = set_parameters(scene, {names[0]: start[0], names[1]: start[1:]})
        result = fit(begin, target, names, RenderSettings(size=size))
        error = np.abs(result.value - truth)
        there = bool(error[0] < 5e-3 and np.max(error[1:]) < 2e-2)
        found, honest = found + there, honest + (there or result.status != "converged")
        index_errors.append(error[0])
        center_errors.append(np.max(error[1:]))
        print(
            f"| {number} | {' '.join(f'{x:.2f}' for x in start)} | {result.status} | {error[0]:.1e} "
            f"| {np.max(error[1:]):.1e} | {1 + len(result.runner_ups)} | {len(result.steps)} "
            f"| {time.perf_counter() - began:.0f} |",
            flush=True,
        )
    count = arguments.starts - arguments.first
    print(f"\n{found} of {count} at the truth; {honest} of {count} there or not said to be converged.")
    print(f"Median error of the index {np.median(index_errors):.1e}, of the center {np.median(center_errors):.1e}.")


if __name__ == "__main__":
    sys.exit(main())
