"""`fit`: from a picture to the parameters of a scene."""

import dataclasses
import hashlib
import shlex
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from raytrace_jax.cli.console import TYPED, UsageError, print_table, stderr_console
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.cli.options.shared import joined
from raytrace_jax.cli.preparation import check_folder, picture_window, read_picture_scene, warn_of_shared_materials
from raytrace_jax.cli.progress import FitProgress, Timer
from raytrace_jax.cli.target import read_observed, with_angle_of_view
from raytrace_jax.errors import ParameterError
from raytrace_jax.images.pictures import read_origin
from raytrace_jax.inverse.estimate import fit
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.known_offsets import with_known_offsets
from raytrace_jax.inverse.problem.pose import asked_for
from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.inverse.result_text import estimate_rows, last_word
from raytrace_jax.report.fit_report.folder import write_numbers, write_pictures
from raytrace_jax.report.fit_report.summary import AFTER
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.scene.texture_files import fingerprint
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.util.journal import FileJournal, identity
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import parse_number

T = TypeVar("T")

NOT_CONVERGED = 3

JOURNAL = "progress.json"

MAY_DIFFER = ("profiles", "max_seconds")
"""Options in which a fit that goes on need not be the one that was interrupted."""

SPELLED = {"ties": "--tie", "priors": "--prior", "uncertain": "--uncertain"}
"""Options of the command line that have another name than in `FitOptions`."""


def run_fit(command: Fit) -> int:
    """Fit the free parameters, print the estimates, write the report; 3 if the fit did not converge."""
    # What is wrong with the command shows before anything is read.
    command.render.given()
    free = joined(command.free)
    if not free:
        raise UsageError("--free NAME ... is missing: which parameters should be found?")
    options = fit_options(command)
    check_resume(command)
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

        # A fit that goes on has to be the one that was interrupted: all that its steps depend on is its identity.
        console = stderr_console(quiet=command.quiet)
        journal = _journal(
            command,
            console,
            {
                "scene": format_scene(scene, model=settings.model),
                "textures": fingerprint(scene),
                "target": target,
                "--mask": weights,
                "--free": free,
                "setting of the picture": settings,
                **{_spelled(name): value for name, value in vars(options).items() if name not in MAY_DIFFER},
            },
        )
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
                journal=journal,
            )
        origin_of_it = provenance(command.target) | {AFTER: f"{time.monotonic() - stepped_at:.3g}"}
        result = dataclasses.replace(result, provenance=result.provenance | origin_of_it)

        # Numbers go out before the report, which takes longer and more room on the disk.
        if not command.json:
            print_result(result, command.long)
        numbers = write_numbers(result, command.output)
        if command.json:
            print(numbers, end="", flush=True)
        else:
            print(command.output, flush=True)
        if result.status != "interrupted":
            journal.finish()
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


def fit_options(command: Fit) -> FitOptions:
    """The options of the fit itself. Raises UsageError for what makes no sense."""
    same = {field.name for field in dataclasses.fields(FitOptions)} & vars(command).keys() - {"uncertain"}
    try:
        return FitOptions(
            **{name: getattr(command, name) for name in same},
            ties=once("--tie", map(parse_tie, command.tie)),
            priors=once("--prior", map(parse_prior, command.prior)),
            uncertain=once("--uncertain", map(parse_uncertain, command.uncertain)),
            profiles=joined(command.profile),
        )
    except ParameterError as reason:
        name, space, rest = str(reason).partition(" ")
        raise UsageError(f"{_spelled(name)}{space}{rest}") from None


def _spelled(name: str) -> str:
    """An option of the fit as the command line has it."""
    return SPELLED.get(name, "--" + name.replace("_", "-"))


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


def parse_uncertain(text: str) -> tuple[str, str]:
    """Split `vitreous.radius=0.1%` or `vitreous.radius=0.002` into the name and how well it is known."""
    name, equals, amount = (piece.strip() for piece in text.rpartition("="))
    try:
        parse_number(amount.removesuffix("%").strip())
        if name and equals:
            return name, amount
    except ValueError:
        pass
    raise UsageError(f"--uncertain {text}: write NAME=SD or NAME=SHARE%, as vitreous.radius=0.002 or cam1=0.1%.")


def once(option: str, pairs: Iterable[tuple[str, T]]) -> dict[str, T]:
    """The pairs as a dictionary. Raises UsageError for a name that comes twice."""
    found: dict[str, T] = {}
    for name, value in pairs:
        if name in found:
            raise UsageError(f"{option} {name} is given twice.")
        found[name] = value
    return found


def check_resume(command: Fit) -> None:
    """Refuse to go on with what is not there, before anything is read. Raises UsageError."""
    path = Path(command.output) / JOURNAL
    if command.resume and command.restart:
        raise UsageError("--resume goes on with a fit and --restart begins it anew: which of them?")
    if command.resume and not path.exists():
        raise UsageError(f"--resume: there is no {path}; there is nothing to go on with.")


def _journal(command: Fit, console: Console, parts: dict[str, object]) -> FileJournal:
    """Open the folder's journal: it goes on with a fit that has not ended, unless the command says otherwise."""
    resume = "always" if command.resume else "never" if command.restart else "unfinished"
    journal = FileJournal(Path(command.output) / JOURNAL, identity(parts), resume=resume)
    if journal.goes_on and not command.resume:
        console.print(f"going on with the fit that was interrupted in {command.output}; --restart begins it anew")
    return journal
