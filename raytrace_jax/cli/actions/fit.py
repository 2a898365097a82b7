"""`fit`: from a picture to the parameters of a scene."""

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np

from raytrace_jax.cli.console import UsageError, print_table, stderr_console
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.cli.options.shared import joined
from raytrace_jax.cli.preparation import check_folder, picture_window, read_scene, warn_of_shared_materials
from raytrace_jax.cli.progress import FitProgress
from raytrace_jax.images.pictures import read_picture
from raytrace_jax.inverse.estimate import fit
from raytrace_jax.inverse.problem.unknowns import EXPOSURE, OFFSET
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.fit_report.folder import write_report
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.util.journal import FileJournal, identity
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import parse_number, value_and_error

T = TypeVar("T")

NOT_CONVERGED = 3

JOURNAL = "progress.json"

PASSED_ON = ("search", "fit_exposure", "sigma", "edges", "target_sampling", "loss", "blur", "max_steps")
"""Options that go to the fit as they are, and that one which resumes must share."""


def run_fit(command: Fit) -> int:
    """Fit the free parameters, write the report, print the estimates; 3 if the fit did not converge."""
    settings = command.render.settings()
    free = _checked(command)
    ties = once("--tie", map(parse_tie, command.tie))
    priors = once("--prior", map(parse_prior, command.prior))
    check_folder(command.output)
    with jax_session(command.render.precision):
        scene = read_scene(command.scene, command.assignments, command.render.model)
        picture_window(scene, settings)
        names = (*scalar_names(scene, free), *((EXPOSURE, OFFSET) if command.fit_exposure else ()))
        warn_of_shared_materials(scene, free)
        target = read_picture(command.target, transfer=command.transfer, layer=command.layer)
        weights = None if command.mask is None else read_picture(command.mask)
        options = {name: getattr(command, name) for name in PASSED_ON}
        journal = _journal(
            command,
            {
                "scene": format_scene(scene, model=settings.model),
                "target": target,
                "--mask": weights,
                "--free": free,
                "--tie": ties,
                "--prior": priors,
                "setting of the picture": settings,
                **{"--" + name.replace("_", "-"): value for name, value in options.items()},
            },
        )
        console = stderr_console(quiet=command.quiet)
        with FitProgress(names, console) as show:
            result = fit(
                scene,
                target,
                free,
                settings,
                ties=ties,
                priors=priors,
                weights=weights,
                profiles=list(joined(command.profile)),
                max_seconds=command.max_seconds,
                on_step=show.step,
                on_phase=show.phase,
                journal=journal,
                **options,
            )
            show.phase("writing the report")
            write_report(result, command.output)
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
    print(f"{result.status}: {result.message}; {result.advice}")


def parse_tie(text: str) -> tuple[str, str]:
    """Split `cyan.ior=vitreous.ior` into follower and leader."""
    follower, equals, leader = (piece.strip() for piece in text.rpartition("="))
    if not equals or not follower or not leader:
        raise UsageError(f"--tie {text}: write NAME=FREE, as cyan.ior=vitreous.ior.")
    return follower, leader


def parse_prior(text: str) -> tuple[str, tuple[float, float]]:
    """Split `vitreous.radius=2.3+-0.01` into the name, the mean and the standard deviation; `±` serves as well."""
    name, equals, numbers = (piece.strip() for piece in text.rpartition("="))
    mean, between, deviation = numbers.replace("±", "+-").partition("+-")
    try:
        if not name or not equals or not between:
            raise ValueError
        return name, (parse_number(mean.strip()), parse_number(deviation.strip()))
    except ValueError:
        raise UsageError(f"--prior {text}: write NAME=MEAN+-SD, as vitreous.radius=2.3+-0.01.") from None


def once(option: str, pairs: Iterable[tuple[str, T]]) -> dict[str, T]:
    """The pairs as a dictionary. Raises UsageError for a name that comes twice."""
    found: dict[str, T] = {}
    for name, value in pairs:
        if name in found:
            raise UsageError(f"{option} {name} is given twice.")
        found[name] = value
    return found


def _journal(command: Fit, parts: dict[str, object]) -> FileJournal:
    """The journal in the folder, with what is to be gone on with."""
    path = Path(command.output) / JOURNAL
    if command.resume and not path.exists():
        raise UsageError(f"--resume: there is no {path}; there is nothing to go on with.")
    return FileJournal(path, identity(parts), resume=command.resume)


def _checked(command: Fit) -> tuple[str, ...]:
    """The free parameters' names. Raises UsageError for options of the fit that make no sense."""
    free = joined(command.free)
    if not free:
        raise UsageError("--free NAME ... is missing: which parameters should be found?")
    if command.blur is not None and not all(np.isfinite(sigma) and sigma >= 0 for sigma in command.blur):
        raise UsageError(f"--blur is {command.blur}; it takes standard deviations in pixels, each 0 or more.")
    if command.max_steps < 1:
        raise UsageError(f"--max-steps is {command.max_steps}; it can be 1 or more.")
    if command.max_seconds is not None and not command.max_seconds > 0:
        raise UsageError(f"--max-seconds is {command.max_seconds}; it can be any time greater than 0.")
    if command.sigma is not None and not (np.isfinite(command.sigma) and command.sigma > 0):
        raise UsageError(f"--sigma is {command.sigma}; it can be any finite number greater than 0.")
    return free
