"""`grad`: from a scene file to the derivatives of its picture."""

import math

import numpy as np
from rich.console import Console

from raytrace_jax.cli.console import UsageError, print_table, stderr_console
from raytrace_jax.cli.options.pictures import Grad
from raytrace_jax.cli.options.shared import joined
from raytrace_jax.cli.preparation import check_picture_path, picture_window, read_scene, warn_of_shared_materials
from raytrace_jax.cli.progress import Timer
from raytrace_jax.report.films import write_derivatives
from raytrace_jax.report.gradient_figure import draw_gradients
from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.tracer.derivatives import (
    PictureDerivatives,
    correlation,
    finite_differences,
    picture_derivatives,
    relative_error,
)
from raytrace_jax.tracer.settings import MAX_SAMPLES
from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.session import jax_session


def run_grad(command: Grad) -> int:
    """Differentiate the picture, write its layers and their sheet, print the paths and, if asked, the check."""
    settings = command.render.settings(edges=command.edges)
    wrt = _checked(command)
    png_path = command.output.with_suffix(".png")
    check_picture_path(command.output)
    check_picture_path(png_path)
    console = stderr_console(quiet=command.quiet)

    with jax_session(command.render.precision):
        scene = read_scene(command.scene, command.assignments, command.render.model)
        picture_window(scene, settings)
        names = scalar_names(scene, wrt)
        warn_of_shared_materials(scene, wrt)
        differences, caption = None, ""
        if command.check:
            # First of all, because it refuses steps that a parameter cannot take.
            samples, step = command.check_samples, command.check_step
            with _Counter("finite difference", len(names), console) as counter:
                differences = finite_differences(scene, wrt, settings, step, samples, counter.done)
            caption = f"finite differences of\n{samples} × {samples} point samples a pixel,\nstep {step:g}"
        with _Counter("derivative", len(names), console) as counter:
            found = picture_derivatives(scene, wrt, settings, counter.done)
        write_derivatives(command.output, found, scene, settings)
    with atomic_write(png_path) as temporary:
        draw_gradients(found, differences, caption).savefig(temporary)
    print(command.output)
    print(png_path)
    if differences is not None:
        print_check(found, differences)
    return 0


def print_check(found: PictureDerivatives, differences: np.ndarray) -> None:
    """Print on stdout how derivatives and finite differences agree; sums are over pixels and channels."""
    rows = []
    for name, derivative, difference in zip(found.names, found.values, differences, strict=True):
        numbers = relative_error(derivative, difference), correlation(derivative, difference)
        sums = (float(np.asarray(values).sum(dtype=np.float64)) for values in (derivative, difference))
        rows.append((name, *(f"{number:.4g}" for number in (*numbers, *sums))))
    headers = ("parameter", "relative L2 error", "correlation", "sum of derivative", "sum of difference")
    print_table("derivatives against finite differences", headers, rows)


def _checked(command: Grad) -> tuple[str, ...]:
    """The parameters' names. Raises UsageError for options that make no sense."""
    wrt = joined(command.wrt)
    if not wrt:
        raise UsageError("--wrt NAME ... is missing: with respect to which parameters?")
    if command.output.suffix.lower() != ".exr":
        raise UsageError(f"{command.output}: derivatives are signed layers, which only OpenEXR has: name an .exr file.")
    if not 1 <= command.check_samples <= MAX_SAMPLES:
        raise UsageError(f"--check-samples is {command.check_samples}; it can be 1 to {MAX_SAMPLES}.")
    if not (math.isfinite(command.check_step) and command.check_step > 0):
        raise UsageError(f"--check-step is {command.check_step}; it can be any number greater than 0.")
    return wrt


class _Counter(Timer):
    """Says of which parameter a picture is done, and how long it took."""

    def __init__(self, what: str, count: int, console: Console):
        super().__init__(f"{what}s", console)
        self.what, self.count, self.number = what, count, 0

    def done(self, name: str) -> None:
        self.number += 1
        self.took(f"{self.what} {self.number}/{self.count} by {name}")
