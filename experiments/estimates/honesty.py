"""Fits that must not look better than they are: more unknowns, no signal, the wrong scene, targets that are none.

python experiments/estimates/honesty.py [--only NAME ...] [--size 160 120] [--targets 20]
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable

import jax
import numpy as np
from basin import CASES

from raytrace_jax import FitOptions, FitResult, RenderSettings, fit, load_scene, render, set_parameters
from raytrace_jax.errors import RaytraceError

SIZE = (160, 120)
SIGMA = 1 / 255
FREE = ["vitreous.ior", "vitreous.center"]
BOX_SAMPLES = 16
NAMES = ("an opaque ball", "another scene", "upside down", "with NaN", "of another size", "constant", "free radius")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES), metavar="NAME")
    parser.add_argument("--size", nargs=2, type=int, default=SIZE, metavar=("W", "H"))
    parser.add_argument("--targets", type=int, default=20, help="of each number of free parameters")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    scene = load_scene(CASES["assignment"].path)
    how = RenderSettings(size=tuple(arguments.size))
    sampled = dataclasses.replace(how, samples=BOX_SAMPLES)
    clean = np.asarray(render(scene, sampled).image)
    opaque = set_parameters(scene, {"vitreous.alpha": 0.0})
    other = set_parameters(scene, {"upperright.center": (2.0, 4.5, -2.5), "vitreous.alpha": 0.9, "central.radius": 0.7})

    print("| target | free | status | message |\n|---|---|---|---|")
    cases = {
        "an opaque ball": (opaque, np.asarray(render(opaque, sampled).image)),
        "another scene": (scene, np.asarray(render(other, sampled).image)),
        "upside down": (scene, clean[:, ::-1]),
        "with NaN": (scene, np.where(clean > 0.9, np.nan, clean)),
        "of another size": (scene, clean[:, :-1]),
        "constant": (scene, np.full_like(clean, 0.25)),
    }
    for name, (start, target) in cases.items():
        if name in arguments.only:
            print(f"| {name} | index, center | {outcome(lambda s=start, t=target: fit(s, t, FREE, how))} |", flush=True)
    if "free radius" in arguments.only:
        free_radius(scene, clean, how, arguments.targets)


def outcome(work: Callable[[], FitResult]) -> str:
    """Status and message of a fit, or what refused it."""
    try:
        result = work()
    except RaytraceError as error:
        return f"refused | {error}"
    return f"{result.status} | {result.message}"


def free_radius(scene, clean: np.ndarray, how: RenderSettings, targets: int) -> None:
    """The error bars with and without a free radius, and whether they hold."""
    columns = "free | parameter | standard error | sd of the errors | within 2 errors | status"
    print(f"\n| {columns} |\n|" + "---|" * 6)
    for free in (FREE, [*FREE, "vitreous.radius"]):
        random, errors, reported, statuses = np.random.default_rng(4), [], [], set()
        names: tuple[str, ...] = ()
        for _ in range(targets):
            target = clean + random.normal(0, SIGMA, clean.shape)
            result = fit(scene, target, free, how, options=FitOptions(search=False, sigma=SIGMA, target_sampling="box"))
            names = result.names
            truth = np.array([float(scene[name]) for name in names])
            errors.append(result.value - truth)
            reported.append(result.standard_error)
            statuses.add(result.status)
        for k, name in enumerate(names):
            error, bar = np.array(errors)[:, k], np.array(reported)[:, k]
            within = int(np.sum(np.abs(error) < 2 * bar))
            print(
                f"| {len(names)} numbers | {name} | {np.mean(bar):.1e} | {np.std(error):.1e} "
                f"| {within} of {targets} | {', '.join(sorted(statuses))} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
