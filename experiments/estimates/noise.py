"""Fit noisy pictures; compare the scatter of the estimates with the Cramer-Rao bound and with the reported errors.

    python experiments/estimates/noise.py [--targets 40] [--size 160 120] [--sampling point box] [--outliers 0 0.02]
        [--seed 1]

Each target is the assignment's scene with Gaussian noise of 1/255 in every channel. There is a table for each share
of outliers, pixels replaced by random colours; where there are any the loss is Cauchy's. `point` targets have one ray
a pixel, `box` targets are means over the pixel. The fits start near the truth and do not search: this is about error
bars.
"""

import argparse
import sys
import time

import jax
import numpy as np
from basin import CASES

from raytrace_jax import FitOptions, RenderSettings, fit, load_scene, render, set_parameters
from raytrace_jax.inverse.options import LossChoice, TargetSampling

SIGMA = 1 / 255
ELLIPSE_95 = 9.488
"""95 % quantile of the chi-square distribution with four degrees of freedom."""


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=40)
    parser.add_argument("--size", nargs=2, type=int, default=[160, 120])
    parser.add_argument("--sampling", nargs="+", choices=("point", "box"), default=["point", "box"])
    parser.add_argument("--box-samples", type=int, default=48)
    parser.add_argument("--outliers", nargs="+", type=float, default=[0.0, 0.02])
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    header = "sampling | parameter | sd / bound | mean error / its error | reported / sd | in the ellipse"
    for outliers in arguments.outliers:
        loss = "cauchy" if outliers else "auto"
        print(f"\n{outliers:.0%} outliers, loss {loss}\n\n| {header} |\n|" + "---|" * 6, flush=True)
        for sampling in arguments.sampling:
            report(sampling, outliers, loss, arguments)


def report(sampling: TargetSampling, outliers: float, loss: LossChoice, arguments: argparse.Namespace) -> None:
    """One block of a table."""
    began, size = time.perf_counter(), tuple(arguments.size)
    scene, how = load_scene(CASES["assignment"].path), RenderSettings(size=size)
    names = ["vitreous.ior", "vitreous.center"]
    samples = 1 if sampling == "point" else arguments.box_samples
    clean = np.asarray(render(scene, RenderSettings(size=size, samples=samples)).image)
    start = set_parameters(scene, {"vitreous.ior": 1.34, "vitreous.center": (4.305, 2.295, -1.01)})
    truth = np.array([scene.materials.ior[list(scene.materials.names).index("cyan")], 4.3, 2.3, -1.0], float)

    random, results = np.random.default_rng(arguments.seed), []
    for _ in range(arguments.targets):
        target = clean + random.normal(0, SIGMA, clean.shape)
        bad = random.random(clean.shape[1:]) < outliers
        target = np.where(bad, random.random(clean.shape), target)
        options = FitOptions(search=False, sigma=SIGMA, loss=loss, target_sampling=sampling)
        results.append(fit(start, target, names, how, options=options))
    errors = np.array([result.value - truth for result in results])
    reported = np.array([result.standard_error for result in results])
    bound = np.mean([result.uncertainty.cramer_rao for result in results], axis=0)
    spread, mean = errors.std(axis=0, ddof=1), errors.mean(axis=0)
    within = sum(inside(result, error) for result, error in zip(results, errors, strict=True))
    for k, name in enumerate(results[0].names):
        average_error, typical = spread[k] / np.sqrt(len(errors)), np.sqrt(np.mean(reported[:, k] ** 2))
        print(
            f"| {sampling} | {name} | {spread[k]:.2e} / {bound[k]:.2e} = {spread[k] / bound[k]:.2f} "
            f"| {mean[k] / average_error:+.1f} | {typical / spread[k]:.2f} | {within} of {len(errors)} |"
        )
    words = ", ".join(sorted({result.status for result in results}))
    chi = np.mean([result.uncertainty.reduced_chi_square for result in results])
    print(
        f"| {sampling} | all | {words}; reduced chi-square {chi:.3f}; {time.perf_counter() - began:.0f} s | | | |",
        flush=True,
    )


def inside(result, error: np.ndarray) -> bool:
    """Whether the truth lies in the 95 % ellipse."""
    covariance = result.uncertainty.correlation * np.outer(result.standard_error, result.standard_error)
    return bool(error @ np.linalg.solve(covariance, error) <= ELLIPSE_95)


if __name__ == "__main__":
    sys.exit(main())
