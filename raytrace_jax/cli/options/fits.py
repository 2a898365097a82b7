"""The options of `fit`, and of `batch`, which runs many."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from raytrace_jax.cli.options.shared import (
    Assignments,
    Names,
    OutputFolder,
    RenderOptions,
    SceneFile,
    with_running_help,
)
from raytrace_jax.images.options import Clipped, Transfer
from raytrace_jax.inverse.options import FitOptions, LossChoice, TargetSampling
from raytrace_jax.scene.setting_words import EdgeMode


@with_running_help
@dataclass(frozen=True)
class Fit:
    """Fit parameters of a scene to a picture, and say how sure they are.

    The search for starts begins at SCENE with its -D values. The folder gets result.json, report.html, report.png,
    the fitted scene fit.txt, its picture fit.exr and residual.exr, fit minus target; for a paper also
    estimates.csv, estimates.tex and methods.txt. A residual of n/255 is n steps of an 8-bit picture; rms is the root
    of its mean square, typical comes from its median. A level is one picture of a series from blurred to sharp. The
    last line says how it ended: converged, model_incomplete, ambiguous, degenerate, not_converged or interrupted; the
    exit code is 3 for all but the first. It also names the assumption that the estimate depends on most.
    Ctrl-C stops the fit and still writes the values reached so far. The same command then continues from there; it
    does so after a kill, too.

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
    """The folder for the results; it is made if it is missing."""
    assignments: Assignments = ()
    """Set a parameter before the search, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""
    search: bool = FitOptions.search
    """Scan indices and positions for starts; with --no-search the scene's values are trusted to be near."""
    tie: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=FREE")] = ()
    """Let a parameter follow a free one, as cyan.ior=vitreous.ior or small.center=large.center."""
    prior: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=MEAN+-SD")] = ()
    """What is known of a free number, as vitreous.radius=2.3+-0.01: mean and standard deviation."""
    uncertain: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=SD")] = ()
    """Standard deviation of a number that stays fixed, as vitreous.radius=0.002 or vitreous.radius=0.1%. The name of a
    block (cam1=0.1%) or of a kind of blocks (lights=1%) stands for all its numbers. The errors then include it."""
    fit_exposure: bool = FitOptions.fit_exposure
    """Fit the target's exposure and offset as well: target = gain * picture + offset, the same for all channels."""
    mask: Annotated[Path | None, arg(metavar="FILE")] = None
    """Weights of the target's pixels, a picture of the same formats: 0 leaves a pixel out, 1 counts in full. A painted
    one counts where it is bright and opaque."""
    clipped: Clipped = "auto"
    """What becomes of pixels with a channel at the largest number that the target's file can store, or at 0. drop: they
    have no weight; keep: they count; auto: drop those of a JPEG or TIFF, and what is too bright for a PNG where the
    model's light has no end."""
    sigma: Annotated[float | None, arg(metavar="SD")] = FitOptions.sigma
    """Standard deviation of the target's noise, where colours reach from 0 to 1; estimated if it is not given."""
    loss: LossChoice = FitOptions.loss
    """How much large residuals count. l2: their squares; huber, cauchy: less, for outliers and objects that the scene
    lacks; auto: cauchy for a point-sampled target, else l2."""
    exact_storage: bool = FitOptions.exact_storage
    """Assume that the scene is exact, and that a point-sampled target differs from its picture only by storage in 8 or
    16 bits. The estimate is then the mean of all values that reproduce the stored numbers."""
    profile: Names = ()
    """Draw the profile likelihood of these numbers: hold one at values around its estimate, fit the others again."""
    edges: EdgeMode = FitOptions.edges
    """aware: derivatives include the motion of silhouettes and refracted edges; point: they do not, and the fit often
    fails."""
    target_sampling: TargetSampling = FitOptions.target_sampling
    """How the target's pixels were made. box: the mean over the pixel, as of a camera or many samples; point: one ray
    a pixel; aware: as render's with --edges aware; auto: what a file of render's says, else whichever of the first two
    is nearer to the target before the last level."""
    target_samples: Annotated[int | None, arg(metavar="N")] = FitOptions.target_samples
    """The target's pixels are means of N x N samples on a regular grid; without this the fit finds out N."""
    transfer: Transfer | None = None
    """How the colours of a PNG target were stored. course: floor(255 * C), no gamma; srgb: as screens expect. Without
    this what the file says holds; if it says nothing, whichever is clearly nearer to the picture at the start."""
    layer: Annotated[str | None, arg(metavar="NAME")] = None
    """Which layer of an OpenEXR target, when it is not obvious."""
    blur: Annotated[tuple[float, ...] | None, arg(metavar="SIGMA ...")] = None
    """Standard deviations in pixels of the blurred levels, coarse to fine; without it they are chosen."""
    max_steps: Annotated[int, arg(metavar="N")] = FitOptions.max_steps
    """The most steps of the solver on the last level."""
    max_seconds: Annotated[float | None, arg(metavar="SECONDS")] = FitOptions.max_seconds
    """Stop after this time and write what there is; without it there is no limit."""
    resume: bool = False
    """Resume the fit in DIR, which must hold one. The fit may have ended, for example to add a profile. Without this
    option the same command resumes an interrupted fit only; the result is the same as without the interruption."""
    restart: bool = False
    """Start from the beginning, even if DIR holds an interrupted fit."""
    long: bool = False
    """Write estimates as 1.337 +- 0.002 in place of 1.337(2), whose parentheses hold the error in the last digits; in
    the table and in the report."""
    pdf: bool = False
    """Write the report's figure as report.pdf, too, for a paper."""
    json: bool = False
    """Print one JSON object on stdout, the content of result.json, in place of the table and the last line."""
    quiet: bool = False
    """Show no progress; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()


@with_running_help
@dataclass(frozen=True)
class Batch:
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
    """The folder for the results; it is made if it is missing."""
    workers: Annotated[int | None, arg(metavar="N")] = None
    """Share the jobs out to N processes on this machine, one core each; without it they run one after the other on one
    core. Needs the extra `batch`."""
    scheduler: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Share the jobs out to the workers of this dask scheduler, as tcp://10.0.0.1:8786. They must see DIR, and the
    plan's targets, under the same paths. Needs the extra `batch`."""
    quiet: bool = False
    """Show no progress; errors and warnings are still shown."""
