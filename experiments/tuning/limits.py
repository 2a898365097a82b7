"""What `HALVINGS` is for: a difference quotient of a parameter near its limit that is that of both sides."""

from collections.abc import Iterator

import numpy as np
from bench import CASES
from replacing import replaced

from raytrace_jax import RenderSettings, load_scene, set_parameters
from raytrace_jax.report.differences import finite_differences, relative_error
from raytrace_jax.tracer.rendering import picture_derivatives

HEAD = ("scene", "step", "distance from the limit", "relative error with `HALVINGS` of 0, 1, 2, 4, 8")
STEPS = (0.1, 0.01)
SHARES = (0.3, 0.1, 0.03, 0.003)
HALVINGS = (0, 1, 2, 4, 8)


def rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """The ball's alpha near 1: no edge moves with it, so that the derivative by automatic differentiation is exact."""
    case = CASES[name]
    alpha, how = f"{case.ball}.alpha", RenderSettings(size=size)
    for step in STEPS:
        for share in SHARES:
            scene = set_parameters(load_scene(case.path), {alpha: 1 - share * step})
            exact = picture_derivatives(scene, [alpha], how).values[0]
            errors = []
            for value in HALVINGS:
                with replaced({"report.differences:HALVINGS": value}):
                    difference = finite_differences(scene, [alpha], how, step=step, samples=1)[0]
                errors.append(relative_error(np.asarray(difference), exact))
            yield [name, f"{step:g}", f"{share:g} steps", " ".join(f"{error:.1e}" for error in errors)]
