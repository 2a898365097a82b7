"""The result of a fit that never ran, for the tests of what is done with results."""

from pathlib import Path

import numpy as np

from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.modelfile import load_scene
from raytrace_jax.settings import RenderSettings

VITREOUS = Path(__file__).parent.parent / "data" / "vitreous.txt"


def fake_result(status="converged", shape=(3, 30, 40), names=("vitreous.ior", "vitreous.radius")):
    """A result whose last parameter is not determined, with a history of two levels and a rejected step."""
    random = np.random.default_rng(7)
    target = np.floor(256 * random.uniform(size=shape)).clip(0, 255) / 255
    value, initial = np.resize([1.337, 2.3], len(names)), np.resize([1.5, 2.0], len(names))
    steps = ((0, 2.0, 0, 5.0, True), (0, 2.0, 1, 1.0, True), (1, 0.0, 0, 0.5, True), (1, 0.0, 1, 0.6, False))
    return FitResult(
        status=status,
        message="The solver came to rest.",
        names=names,
        value=value,
        initial=initial,
        standard_error=np.array([2.3e-4] * (len(names) - 1) + [np.inf]),
        correlation=np.where(np.eye(len(names)) > 0, 1.0, np.nan),
        rms_residual=0.01,
        scene=load_scene(VITREOUS),
        settings=RenderSettings(size=shape[:0:-1]),
        target=target,
        start_image=target[::-1],
        image=np.clip(target + random.normal(scale=0.01, size=shape), 0, 1),
        history=tuple(FitStep(*step, initial + (value - initial) * i / 3, 0.5 * i) for i, step in enumerate(steps)),
    )
