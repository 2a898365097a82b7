"""Reference pictures and derivative pictures: many point samples a pixel, and differences between them.

Every array is kept in a file as soon as it is there, so that a run can be interrupted and goes on where it stopped.
"""

import hashlib
import pathlib
import sys
import time
from collections.abc import Callable

import numpy as np
from cases import Case

from raytrace_jax import RenderSettings, load_scene, render, set_parameters
from raytrace_jax.report.differences import finite_differences
from raytrace_jax.util.files import atomic_write


def kept(folder: pathlib.Path, case: Case, what: str, make: Callable[[], np.ndarray]) -> np.ndarray:
    """An array from its file, or made and written to it."""
    key = hashlib.sha256(repr((case.path.read_text(), case.size, case.samples, what)).encode()).hexdigest()[:16]
    path = folder / f"{case.path.stem}_{case.size[0]}_{key}.npy"
    if not path.exists():
        start = time.perf_counter()
        array = make()
        with atomic_write(path) as temporary:
            np.save(temporary, array)
        print(f"{case.name}: {what}, {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    return np.load(path)


def reference_picture(folder: pathlib.Path, case: Case, moved: bool = False) -> np.ndarray:
    """The picture of the case's scene, or of the moved one."""

    def make():
        scene = load_scene(case.path)
        scene = set_parameters(scene, case.moved) if moved else scene
        return np.asarray(render(scene, RenderSettings(size=case.size, samples=case.samples)).image)

    return kept(folder, case, f"picture {case.moved if moved else ''}", make)


def reference_derivative(folder: pathlib.Path, case: Case, name: str, halvings: int = 0) -> np.ndarray:
    """The derivative picture by central differences; with `halvings` of a smaller step."""
    step = case.steps[name] * 2.0**-halvings

    def make():
        settings = RenderSettings(size=case.size)
        return finite_differences(load_scene(case.path), [name], settings, step=step, samples=case.samples)[0]

    return kept(folder, case, f"{name} by {step:g}", make)
