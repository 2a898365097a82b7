"""The options of `fit`, and of `batch`, which runs many."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from raytrace_jax.cli.console import UsageError
from raytrace_jax.cli.options import (
    REPEATABLE,
    AsJson,
    Assignments,
    Names,
    OutputFolder,
    Quiet,
    RenderOptions,
    SceneFile,
    Told,
    split_assignment,
    with_running_help,
)
from raytrace_jax.images.options import Clipped, Transfer
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.util.checked import Checked, Wanted
from raytrace_jax.util.text import parse_number


def parse_tie(text: str) -> tuple[str, str]:
    """Split `cyan.ior=vitreous.ior` into follower and leader."""
    return split_assignment("tie", text, "NAME=FREE, as cyan.ior=vitreous.ior", str)


def parse_prior(text: str) -> tuple[str, tuple[float, float]]:
    """Split `vitreous.radius=2.3+-0.01` into the name, the mean and the standard deviation; `±` serves as well."""

    def read(numbers: str) -> tuple[float, float]:
        mean, _, deviation = numbers.replace("±", "+-").partition("+-")
        return parse_number(mean.strip()), parse_number(deviation.strip())

    return split_assignment("prior", text, "NAME=MEAN+-SD, as vitreous.radius=2.3+-0.01", read)


def parse_uncertain(text: str) -> tuple[str, str]:
    """Split `vitreous.radius=0.1%` or `vitreous.radius=0.002` into the name and how well it is known."""

    def read(amount: str) -> str:
        parse_number(amount.removesuffix("%").strip())
        return amount

    form = "NAME=SD or NAME=SHARE%, as vitreous.radius=0.002 or cam1=0.1%"
    return split_assignment("uncertain", text, form, read)


def pairs(option: str, read: Callable[[str], tuple[str, Any]]) -> tuple[object, ...]:
    """Marks of an option whose `NAME=VALUE` texts become a mapping."""

    def read_all(texts: list[str]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, value in map(read, texts):
            if name in found:
                raise UsageError(f"--{option} {name} is given twice.")
            found[name] = value
        return found

    spec = PrimitiveConstructorSpec(
        nargs="*",
        metavar="NAME=VALUE",
        instance_from_str=read_all,
        is_instance=lambda value: isinstance(value, Mapping),
        str_from_instance=lambda value: [*value],
    )
    return spec, REPEATABLE, arg(name=option)


@functools.partial(
    with_running_help,
    hidden=("correlations",),
    ties=pairs("tie", parse_tie),
    priors=pairs("prior", parse_prior),
    uncertain=pairs("uncertain", parse_uncertain),
    profiles=(REPEATABLE, arg(name="profile")),
)
@dataclass(frozen=True)
class FitArguments(Told, FitOptions):
    """How the fit is set up and solved."""


@with_running_help
@dataclass(frozen=True)
class Fit:
    """Fit parameters of a scene to a picture, and say how sure they are.

    The search for starts begins at SCENE with its -D values. The folder gets result.json, report.html, report.png,
    the fitted scene fit.txt, its picture fit.exr and residual.exr, fit minus target; for a paper also
    estimates.csv, estimates.tex and methods.txt. A residual of n/255 is a difference of n in linear light, of which
    white is 255; rms is the root of its mean square, typical comes from its median. A level is one picture of a series
    from blurred to sharp. The last line says how it ended: converged, model_incomplete, ambiguous, degenerate,
    not_converged or interrupted; the exit code is 3 for all but the first. It also names the assumption that the
    estimate depends on most.
    Ctrl-C stops the fit and still writes the values reached so far.

    Example: raytrace-jax fit guess.txt photo.exr --free vitreous.ior vitreous.center -o result
    """

    scene: SceneFile
    """The scene to start from, a model.txt file."""
    target: Annotated[Positional[Path], arg(metavar="TARGET")]
    """The picture to explain, OpenEXR, PNG, JPEG, TIFF, PPM or Radiance HDR, of the size that is rendered; with --crop
    also the whole picture."""
    free: Names
    """The parameters to find (required), as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: OutputFolder
    assignments: Assignments = ()
    mask: Annotated[Path | None, arg(metavar="FILE")] = None
    """Weights of the target's pixels, a picture of the same formats: 0 leaves a pixel out, 1 counts in full. A painted
    one counts where it is bright and opaque."""
    clipped: Clipped = "auto"
    """What becomes of pixels with a channel at the largest number that the target's file can store, or at 0. drop: they
    have no weight; keep: they count; auto: drop those of a JPEG or TIFF, and what is too bright for a PNG where the
    model's light has no end."""
    transfer: Transfer | None = None
    """How the colours of a PNG target were stored. course: floor(255 * C), no gamma; srgb: as screens expect. Without
    this what the file says holds; if it says nothing, whichever is clearly nearer to the picture at the start."""
    layer: Annotated[str | None, arg(metavar="NAME")] = None
    """Which layer of an OpenEXR target, when it is not obvious."""
    long: bool = False
    """Write estimates as 1.337 +- 0.002 in place of 1.337(2), whose parentheses hold the error in the last digits; in
    the table and in the report."""
    pdf: bool = False
    """Write the report's figure as report.pdf, too, for a paper."""
    json: bool = False
    """Print one JSON object on stdout, the content of result.json, in place of the table and the last line."""
    quiet: Quiet = False
    options: FitArguments = FitArguments()
    render: RenderOptions = RenderOptions()


@with_running_help
@dataclass(frozen=True)
class Batch(Told, Checked):
    """Run the many renders, derivatives and fits of a plan, and gather them in a table.

    PLAN.toml names scenes, grids and lists of parameters, noise and seeds (docs/batch.md describes it). DIR gets a
    folder of files for each kind of job, and results.csv, with results.parquet beside it if pyarrow is installed.
    index.html shows all jobs, contact.png all pictures, and a file's name says what varies: vitreous.ior=1.45_e6c514ba.
    Finished jobs are not run again: after Ctrl-C, a kill or a failure the same command goes on. The exit code is 1 if a
    job failed; the table says which one and why.

    Example: raytrace-jax batch plan.toml -o results --workers 2
    """

    plan: Annotated[Positional[Path], arg(metavar="PLAN.toml")]
    """The plan, a TOML file."""
    output: OutputFolder
    workers: Annotated[int | None, Wanted(metavar="N", least=1)] = None
    """Share the jobs out to N processes on this machine, one core each; without it they run one after the other on one
    core. Needs the extra `batch`."""
    scheduler: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Share the jobs out to the workers of this dask scheduler, as tcp://10.0.0.1:8786. They must see DIR, and the
    plan's targets, under the same paths. Needs the extra `batch`."""
    json: AsJson = False
    quiet: Quiet = False
