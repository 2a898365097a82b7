"""Fit pictures stored in 8 bits; compare the errors of the estimates with the reported ones and with least squares.

    python experiments/estimates/quantization.py [--targets 20] [--size 120 90] [--seed 0]

Each target is the assignment's scene with a random index (1.2 to 1.8) and center (0.2 around its place in each
coordinate), one ray a pixel, stored as the course does (truncated, no gamma). The fits start within 0.002 of the truth
and do not search.
"""

import argparse
import sys

import jax
import numpy as np
from basin import CASES

from raytrace_jax import RenderSettings, fit, load_scene, render, set_parameters
from raytrace_jax.images.png import decode_course, encode_course

FREE = ("vitreous.ior", "vitreous.center")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--size", nargs=2, type=int, default=[120, 90])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    scene, how = load_scene(CASES["assignment"].path), RenderSettings(size=tuple(arguments.size))
    random, ratios = np.random.default_rng(arguments.seed), []

    def with_values(values: np.ndarray):
        return set_parameters(scene, {FREE[0]: values[0], FREE[1]: values[1:]})

    print("| target | loss | errors of ior, center in standard errors | standard error of ior | Cramér-Rao bound |")
    print("|" + "---|" * 5)
    for number in range(arguments.targets):
        truth = np.r_[random.uniform(1.2, 1.8), np.array([4.3, 2.3, -1.0]) + random.uniform(-0.2, 0.2, 3)]
        target = decode_course(encode_course(np.asarray(render(with_values(truth), how).image)))
        start = with_values(truth + random.uniform(-2e-3, 2e-3, 4))
        result = fit(start, target, FREE, how, search=False, target_sampling="point", exact_storage=True)
        ratio = (result.value - truth) / result.standard_error
        if result.loss == "quantization":
            ratios.append(ratio)
        print(
            f"| {number} | {result.loss} | {' '.join(f'{x:+.1f}' for x in ratio)} "
            f"| {result.standard_error[0]:.1e} | {result.uncertainty.cramer_rao[0]:.1e} |",
            flush=True,
        )
    if not ratios:
        print(f"\nNone of {arguments.targets} by quantization.")
        return
    size = np.sqrt(np.mean(np.square(ratios), axis=0))
    print(
        f"\n{len(ratios)} of {arguments.targets} by quantization; root mean squares of their errors in standard errors:"
    )
    print(f"{' '.join(f'{x:.2f}' for x in size)}; the largest {np.max(np.abs(ratios)):.1f}.")


if __name__ == "__main__":
    sys.exit(main())
