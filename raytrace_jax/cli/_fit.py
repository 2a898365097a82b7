"""`fit`: from a picture to the parameters of a scene."""

import numpy as np

from raytrace_jax._estimates import value_and_error
from raytrace_jax.cli._console import print_table, stderr_console
from raytrace_jax.cli._errors import UsageError
from raytrace_jax.cli._options import Fit
from raytrace_jax.cli._output import check_folder
from raytrace_jax.cli._progress import FitProgress
from raytrace_jax.cli._render import picture_window
from raytrace_jax.cli._scene import read_scene, warn_of_shared_materials
from raytrace_jax.cli._session import jax_session
from raytrace_jax.inverse.fit import fit, pyramid_levels
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.parameters import scalar_names
from raytrace_jax.pictures import read_picture
from raytrace_jax.report import write_fit

NOT_CONVERGED = 3


def run_fit(command: Fit) -> int:
    """Fit the free parameters, write the report, print the estimates; 3 if the fit did not converge."""
    settings = command.render.settings()
    free = _checked(command)
    check_folder(command.output)
    with jax_session(command.render.precision):
        scene = read_scene(command.scene, command.assignments)
        picture_window(scene, settings)
        names = scalar_names(scene, free)
        warn_of_shared_materials(scene, free)
        target = read_picture(command.target, transfer=command.transfer, layer=command.layer)
        console = stderr_console()
        console.quiet = command.quiet
        with FitProgress(names, len(pyramid_levels(command.blur)), console) as show:
            result = fit(
                scene,
                target,
                free,
                settings,
                edges=command.edges,
                target_sampling=command.target_sampling,
                blur=command.blur,
                max_steps=command.max_steps,
                max_seconds=command.max_seconds,
                on_step=show,
            )
        write_fit(result, command.output)
    print_result(result)
    print(command.output)
    return 0 if result.status == "converged" else NOT_CONVERGED


def print_result(result: FitResult) -> None:
    """Print the estimates and the verdict on stdout."""
    rows = []
    for name, initial, value, error in zip(
        result.names, result.initial, result.value, result.standard_error, strict=True
    ):
        rows.append((name, f"{initial:.8g}", *value_and_error(float(value), float(error))))
    print_table("estimates", ("parameter", "initial", "value", "standard error"), rows)
    print(f"{result.status}: {result.message}")


def _checked(command: Fit) -> tuple[str, ...]:
    """The free parameters' names. Raises UsageError for options of the fit that make no sense."""
    free = tuple(name for names in command.free for name in names)
    if not free:
        raise UsageError("--free NAME ... is missing: which parameters should be found?")
    if not command.blur or not all(np.isfinite(sigma) and sigma >= 0 for sigma in command.blur):
        raise UsageError(f"--blur is {command.blur}; it takes standard deviations in pixels, each 0 or more.")
    if command.max_steps < 1:
        raise UsageError(f"--max-steps is {command.max_steps}; it can be 1 or more.")
    if command.max_seconds is not None and not command.max_seconds > 0:
        raise UsageError(f"--max-seconds is {command.max_seconds}; it can be any time greater than 0.")
    return free
