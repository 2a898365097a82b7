"""`grad`: from a scene file to the derivatives of its picture."""

import dataclasses
import sys

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from raytrace_jax.cli.console import UsageError, print_table, print_warning, stderr_console
from raytrace_jax.cli.options.pictures import Grad
from raytrace_jax.cli.preparation import (
    check_picture_path,
    picture_window,
    read_picture_scene,
    warn_of_shared_materials,
)
from raytrace_jax.cli.progress import Timer
from raytrace_jax.images.masks import bad_pixels, blackened, in_words
from raytrace_jax.images.options import Transfer
from raytrace_jax.report.derivative_check import DerivativeCheck, check_derivative
from raytrace_jax.report.films import screen_transfer, write_derivatives
from raytrace_jax.report.gradient_figure import draw_gradients
from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.tracer.derivatives import Differences, PictureDerivatives, picture_derivatives, steady_differences
from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.json_text import json_text
from raytrace_jax.util.session import jax_session


def run_grad(command: Grad) -> int:
    """Differentiate the picture, write its layers and their sheet, print the paths and, if asked, the check.

    1 if a pixel of the picture or of a derivative is not finite.
    """
    # What is wrong with the command shows before anything is read.
    asked = dataclasses.replace(command.render, edges=command.edges)
    _check(command)
    wrt = command.wrt
    png_path = command.output.with_suffix(".png")
    check_picture_path(command.output)
    check_picture_path(png_path)
    console = stderr_console(quiet=command.quiet)

    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, asked)
        origin = picture_window(scene, settings)[:2]
        names = scalar_names(scene, wrt)
        warn_of_shared_materials(scene, wrt)
        differences = None
        if command.check:
            # First of all, because it refuses steps that a parameter cannot take.
            with _Counter("finite difference", None, console) as counter:
                step, samples = command.check_step, command.check_samples
                differences = steady_differences(scene, wrt, settings, step, samples, counter.done)
        with _Counter("derivative", len(names), console) as counter:
            found = picture_derivatives(scene, wrt, settings, counter.done)
        image, values = np.asarray(found.image), np.asarray(found.values)
        bad = bad_pixels(image, values)
        if bad.any():
            print_warning(f"{in_words(bad, origin)}, in the picture or a derivative. They are 0 in the files.")
            found = found._replace(image=blackened(image), values=blackened(values))
        write_derivatives(command.output, found, scene, settings, differences)

    # The sheet shows what the layers hold; the words say how far differences agree with them.
    checks = [] if differences is None else check_all(found, differences, origin)
    with atomic_write(png_path) as temporary:
        draw_sheet(found, differences, checks, origin, screen_transfer(settings)).savefig(temporary)
    if command.json:
        told: dict[str, object] = {"output": command.output, "png": png_path, "parameters": found.names}
        if differences is not None:
            numbers = check_numbers(found, differences, checks)
            told["checks"] = [{"words": check.words, **row} for check, row in zip(checks, numbers, strict=True)]
        sys.stdout.write(json_text(told))
    else:
        print(command.output)
        print(png_path)
        if differences is not None:
            print_check(found, differences, checks)
    return 1 if bad.any() else 0


def check_all(found: PictureDerivatives, differences: Differences, origin: tuple[int, int]) -> list[DerivativeCheck]:
    """Compare each derivative with its difference; `origin` is the place of the first pixel in the whole picture."""
    both = zip(np.asarray(found.values), differences.values, differences.spreads, strict=True)
    return [check_derivative(derivative, difference, spread, origin) for derivative, difference, spread in both]


def draw_sheet(
    found: PictureDerivatives,
    differences: Differences | None,
    checks: list[DerivativeCheck],
    origin: tuple[int, int],
    transfer: Transfer,
) -> Figure:
    """The sheet, with differences, how they were made and the verdicts' words if there are any."""
    if differences is None:
        return draw_gradients(found, origin=origin, transfer=transfer)
    caption = f"finite differences of\n{differences.samples} × {differences.samples} point samples a pixel"
    words = [f"{check.verdict}, step {step:.3g}" for check, step in zip(checks, differences.steps, strict=True)]
    return draw_gradients(found, differences.values, caption, words, origin, transfer)


def check_numbers(
    found: PictureDerivatives, differences: Differences, checks: list[DerivativeCheck]
) -> list[dict[str, float]]:
    """What is told of each derivative beside finite differences; sums are over all pixels."""
    return [
        {
            "relative L2 error": check.error,
            "correlation": check.correlation,
            "difference by two steps": check.spread,
            "sum of derivative": float(np.asarray(found.values[k]).sum(dtype=np.float64)),
            "sum of difference": float(differences.values[k].sum(dtype=np.float64)),
            "step": float(differences.steps[k]),
        }
        for k, check in enumerate(checks)
    ]


def print_check(found: PictureDerivatives, differences: Differences, checks: list[DerivativeCheck]) -> None:
    """Print on stdout how derivatives and finite differences agree, in numbers and words."""
    numbers = check_numbers(found, differences, checks)
    rows = [(name, *(f"{n:.4g}" for n in row.values())) for name, row in zip(found.names, numbers, strict=True)]
    print_table("derivatives against finite differences", ("parameter", *numbers[0]), rows)
    for name, check in zip(found.names, checks, strict=True):
        print(f"{name}: {check.words}")


def _check(command: Grad) -> None:
    """Refuse options that make no sense. Raises UsageError."""
    if not command.wrt:
        raise UsageError("--wrt NAME ... is missing: with respect to which parameters?")
    if command.output.suffix.lower() != ".exr":
        raise UsageError(f"{command.output}: derivatives are signed layers, which only OpenEXR has: name an .exr file.")


class _Counter(Timer):
    """Says of which parameter a picture is done, and how long it took; `count` is how many there will be, if known."""

    def __init__(self, what: str, count: int | None, console: Console):
        super().__init__(f"{what}s", console)
        self.what, self.count, self.number = what, count, 0

    def done(self, name: str) -> None:
        self.number += 1
        number = self.number if self.count is None else f"{self.number}/{self.count}"
        self.took(f"{self.what} {number} by {name}")
