"""Fit pictures of 16 x 16 samples a pixel with few edge-aware samples; print how far the answers are from the truth.

    python experiments/edge_gradients/box_fits.py [--samples 1 3] [--size 160 120]

The targets have no noise: what is left is the bias of the picture model.
"""

import argparse
import sys
import time

import jax
import numpy as np
from cases import ASSIGNMENT

from raytrace_jax import RenderSettings, fit, load_scene, render, set_parameters

NAMES = ("vitreous.ior", *(f"vitreous.center.{axis}" for axis in "xyz"))
TRUTHS = ((1.45, 4.15, 2.45, -1.25), (1.25, 4.5, 2.2, -0.9), (1.6, 4.1, 2.5, -1.2), (1.5, 4.4, 2.1, -1.1))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", nargs="+", type=int, default=[1, 3], help="n x n edge-aware samples of the model")
    parser.add_argument("--size", nargs=2, type=int, default=[160, 120])
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    scene, size = load_scene(ASSIGNMENT), tuple(arguments.size)
    print("| true ior, center | samples | status | error of ior | of center | seconds |\n|---|---|---|---|---|---|")
    for truth in TRUTHS:
        moved = set_parameters(scene, dict(zip(NAMES, truth, strict=True)))
        target = np.asarray(render(moved, RenderSettings(size=size, samples=16)).image)
        for samples in arguments.samples:
            start = time.perf_counter()
            how = RenderSettings(size=size, samples=samples)
            result = fit(scene, target, ["vitreous.ior", "vitreous.center"], how, target_sampling="box")
            errors = [float(found) - true for found, true in zip(result.value, truth, strict=True)]
            seconds = time.perf_counter() - start
            print(
                f"| {truth} | {samples}x{samples} | {result.status} | {errors[0]:+.1e} "
                f"| {max(map(abs, errors[1:])):.1e} | {seconds:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
