"""`fit`: from a picture to the parameters of a scene."""

import dataclasses
import hashlib
import shlex
import time
from pathlib import Path

from raytrace_jax.cli.console import TYPED, UsageError, print_table, stderr_console
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.cli.preparation import check_folder, picture_window, read_picture_scene, warn_of_shared_materials
from raytrace_jax.cli.progress import FitProgress, Timer
from raytrace_jax.cli.target import read_observed, with_angle_of_view
from raytrace_jax.images.pictures import read_origin
from raytrace_jax.inverse.build_problem import asked_for
from raytrace_jax.inverse.estimate import fit
from raytrace_jax.inverse.fixed import with_known_offsets
from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.inverse.result_file import estimate_rows, last_word
from raytrace_jax.report.fit_report.folder import write_numbers, write_pictures
from raytrace_jax.report.fit_report.summary import AFTER
from raytrace_jax.scene.bundled import scene_path
from raytrace_jax.tracer.rendering import refuse_too_large
from raytrace_jax.util.session import jax_session

NOT_CONVERGED = 3


def run_fit(command: Fit) -> int:
    """Fit the free parameters, print the estimates, write the report; 3 if the fit did not converge."""
    # What is wrong with the command shows before anything is read.
    free, options = command.free, command.options
    if not free:
        raise UsageError("--free NAME ... is missing: which parameters should be found?")
    check_folder(command.output)
    with jax_session(command.render.precision):
        # What the files say: the scene, and the target with what is known of how it was made.
        scene, settings = read_picture_scene(command.scene, command.assignments, command.render)
        picture_window(scene, settings)
        scene = with_angle_of_view(scene, command.target, command.assignments)
        filmed, names, _ = asked_for(scene, free, options)
        refuse_too_large(scene, settings, len(names))
        origin = read_origin(command.target)
        options = with_known_offsets(options.as_made(origin.how_made), filmed, names, origin.maker)
        warn_of_shared_materials(filmed, free)
        target, weights, storage = read_observed(command, scene, free, settings, options)

        console = stderr_console(quiet=command.quiet)
        with FitProgress(names, console) as show:
            stepped_at = time.monotonic()

            def on_step(step: FitStep) -> None:
                nonlocal stepped_at
                show.step(step)
                stepped_at = time.monotonic()

            result = fit(
                scene,
                target,
                free,
                settings,
                options,
                weights=weights,
                storage=storage,
                on_step=on_step,
                on_phase=show.phase,
            )
        origin_of_it = provenance(command.target) | {AFTER: f"{time.monotonic() - stepped_at:.3g}"}
        result = dataclasses.replace(result, provenance=result.provenance | origin_of_it)

        # Numbers go out before the report, which takes longer and more room on the disk.
        if not command.json:
            print_result(result, command.long)
        comments = scene_path(command.scene).read_text(encoding="utf-8-sig")
        numbers = write_numbers(result, command.output, comments)
        if command.json:
            print(numbers, end="", flush=True)
        else:
            print(command.output, flush=True)
        if result.status != "interrupted":
            with Timer("writing the report", console) as timer:
                write_pictures(result, command.output, command.long, command.pdf)
                timer.took("writing the report")
    return 0 if result.status == "converged" else NOT_CONVERGED


def print_result(result: FitResult, long: bool = False) -> None:
    """Print the estimates, `long` as 1.337 +- 0.002, and the verdict; only that if there was no first step."""
    if result.history.steps:
        print_table("estimates", *estimate_rows(result, long))
    print(last_word(result))


def provenance(target: Path) -> dict[str, str]:
    """The target's file, its bytes and hash, and the command that was typed."""
    content = target.read_bytes()
    return {
        "target": str(target),
        "target_bytes": str(len(content)),
        "target_sha256": hashlib.sha256(content).hexdigest(),
        "command": shlex.join(["raytrace-jax", *TYPED.get()]),
    }
