"""Fits that must not look better than they are: more unknowns, no signal, the wrong scene, targets that are none.

python experiments/estimates/honesty.py
"""

import sys
from collections.abc import Callable

import jax
import numpy as np
from basin import CASES

from raytrace_jax import FitResult, RenderSettings, fit, get_parameter, load_scene, render, set_parameters
from raytrace_jax.errors import RaytraceError

SIZE = (160, 120)
HOW = RenderSettings(size=SIZE)
SIGMA = 1 / 255
FREE = ["vitreous.ior", "vitreous.center"]
BOX_SAMPLES = 16
TARGETS = 20


def main() -> None:
    """The command."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    scene = load_scene(CASES["assignment"].path)
    clean = np.asarray(render(scene, RenderSettings(size=SIZE, samples=BOX_SAMPLES)).image)
    opaque = set_parameters(scene, {"vitreous.alpha": 0.0})
    other = set_parameters(scene, {"upperright.center": (2.0, 4.5, -2.5), "vitreous.alpha": 0.9, "central.radius": 0.7})

    print("| target | free | status | message |\n|---|---|---|---|")
    cases = {
        "an opaque ball": (opaque, np.asarray(render(opaque, RenderSettings(size=SIZE, samples=BOX_SAMPLES)).image)),
        "another scene": (scene, np.asarray(render(other, RenderSettings(size=SIZE, samples=BOX_SAMPLES)).image)),
        "upside down": (scene, clean[:, ::-1]),
        "with NaN": (scene, np.where(clean > 0.9, np.nan, clean)),
        "of another size": (scene, clean[:, :-1]),
        "constant": (scene, np.full_like(clean, 0.25)),
    }
    for name, (start, target) in cases.items():
        print(f"| {name} | index, center | {outcome(lambda s=start, t=target: fit(s, t, FREE, HOW))} |", flush=True)
    free_radius(scene, clean)


def outcome(work: Callable[[], FitResult]) -> str:
    """Status and message of a fit, or what refused it."""
    try:
        result = work()
    except RaytraceError as error:
        return f"refused | {error}"
    return f"{result.status} | {result.message}"


def free_radius(scene, clean: np.ndarray) -> None:
    """The error bars with and without a free radius, and whether they hold."""
    columns = "free | parameter | standard error | sd of the errors | within 2 errors | status"
    print(f"\n| {columns} |\n|" + "---|" * 6)
    for free in (FREE, [*FREE, "vitreous.radius"]):
        random, errors, reported, statuses = np.random.default_rng(4), [], [], set()
        for _ in range(TARGETS):
            target = clean + random.normal(0, SIGMA, clean.shape)
            result = fit(scene, target, free, HOW, search=False, sigma=SIGMA, target_sampling="box")
            truth = np.array([float(get_parameter(scene, name)) for name in result.names])
            errors.append(result.value - truth)
            reported.append(result.standard_error)
            statuses.add(result.status)
        for k, name in enumerate(result.names):
            error, bar = np.array(errors)[:, k], np.array(reported)[:, k]
            within = int(np.sum(np.abs(error) < 2 * bar))
            print(
                f"| {len(result.names)} numbers | {name} | {np.mean(bar):.1e} | {np.std(error):.1e} "
                f"| {within} of {TARGETS} | {', '.join(sorted(statuses))} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
