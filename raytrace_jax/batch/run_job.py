"""One job: its files, and its numbers for the table."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
from jax.typing import ArrayLike

from raytrace_jax.batch.fit_plan import OPTIONS
from raytrace_jax.batch.jobs import Job, job_scene
from raytrace_jax.batch.labels import OF_NOISE, TOTAL, file_name
from raytrace_jax.batch.records import Record
from raytrace_jax.images.jpeg import jpeg_storage
from raytrace_jax.images.masks import clipped_pixels
from raytrace_jax.images.pictures import is_jpeg, read_origin, read_picture
from raytrace_jax.images.png import write_png
from raytrace_jax.inverse.build_problem import asked_for
from raytrace_jax.inverse.estimate import fit
from raytrace_jax.inverse.fixed import with_known_offsets
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import write_derivatives, write_film
from raytrace_jax.report.fit_report.summary import provenance_of, summarize
from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.scene.writer import save_scene
from raytrace_jax.tracer.derivatives import picture_derivatives
from raytrace_jax.tracer.rendering import render
from raytrace_jax.util.files import write_text
from raytrace_jax.util.json_text import json_text

Outcome = tuple[list[Path], Mapping[str, float | str | None]]
"""The paths of a job's files, and its numbers for the table, by column."""


def run_fit(job: Job, folder: Path) -> Outcome:
    """Fit, and write `result.json` and the fitted scene `fit.txt` into the job's folder within `folder`.

    Raises:
        RaytraceError: the target does not fit the scene, or a file cannot be read or written.
        KeyboardInterrupt: Ctrl-C.
    """
    options = job.options
    target, weights = fit_target(job)
    # A rendered target has the job's values, and the search for them begins at those of the scene.
    start = job_scene(job, None if job.target else options["fixed"])
    scene, how = set_parameters(start, options["start"]), FitOptions(**{name: options[name] for name in OPTIONS})
    if job.target:
        origin = read_origin(job.target)
        how = how.as_made(origin.how_made)
        filmed, names, _ = asked_for(scene, options["free"], how)
        how = with_known_offsets(how, filmed, names, origin.maker)
    result = fit(
        scene,
        target,
        options["free"],
        job.settings,
        how,
        weights=weights,
        storage=jpeg_storage(job.target) if job.target and is_jpeg(job.target) else None,
    )
    if result.status == "interrupted":
        raise KeyboardInterrupt
    return _write(folder / file_name(job), result), _estimates(result)


def fit_target(job: Job) -> tuple[np.ndarray, np.ndarray | None]:
    """The target of a fit, "3 height width", a file's picture or a rendered one, with the job's noise on it.

    With it come a file's weights, "height width": 0 where the file could not store the light.

    Raises:
        PictureError: the file cannot be read.
    """
    if job.target:
        picture = read_picture(job.target)
        weights = clipped_pixels(job.target, picture, "auto", clamps=job.settings.model != "physical").weights
        target = picture.astype(f"float{job.precision}")
    else:
        weights = None
        settings = dataclasses.replace(job.settings, samples=job.options["target_samples"])
        target = np.asarray(render(job_scene(job), settings).image)
    noise = np.random.default_rng(job.options["seed"]).normal(scale=job.options["noise"], size=target.shape)
    return target + noise.astype(target.dtype), weights


def _write(place: Path, result: FitResult) -> list[Path]:
    scene, numbers = place / "fit.txt", place / "result.json"
    summary = summarize(result, save_scene(result.scene, scene, model=result.settings.model))
    # Without its times: the same fit has the same file.
    summary["provenance"] = {
        name: value for name, value in provenance_of(result).items() if name not in ("date", "seconds", "stages")
    }
    summary["history"] = [
        {name: value for name, value in dataclasses.asdict(step).items() if name != "seconds"}
        | {"value": step.value.tolist()}
        for step in result.history.steps
    ]
    write_text(numbers, json_text(summary))
    return [numbers, scene]


def _estimates(result: FitResult) -> dict[str, float | str | None]:
    """The numbers of the table; None for what is infinite or not a number."""

    def finite(number: float) -> float | None:
        return float(number) if np.isfinite(number) else None

    causes = "; ".join(cause.words for cause in result.check.causes)
    numbers = {"fit.status": result.status, "fit.causes": causes or None}
    numbers["fit.rms_residual"] = finite(result.pictures.rms_residual)
    rows = zip(result.names, result.value, result.standard_error, result.total_error, strict=True)
    for name, value, of_noise, error in rows:
        numbers |= {f"fit.{name}": finite(value), f"fit.{name}{OF_NOISE}": finite(of_noise)}
        numbers[f"fit.{name}{TOTAL}"] = finite(error)
    return numbers


def run_job(job: Job, folder: Path) -> Record:
    """Run a job and write its files into `folder/KIND`; its record is for the caller to write.

    Raises:
        RaytraceError: what the job wants is impossible, or a file cannot be read or written.
        KeyboardInterrupt: Ctrl-C.
    """
    with jax.enable_x64(job.precision == 64):
        outputs, results = {"render": _render, "gradient": _gradient, "fit": run_fit}[job.kind](job, folder / job.kind)
    return Record("done", outputs=tuple(path.relative_to(folder).as_posix() for path in outputs), results=results)


def _render(job: Job, folder: Path) -> Outcome:
    scene = job_scene(job)
    film = render(scene, job.settings)
    # Not by with_suffix: there are dots in the name.
    picture, preview = (folder / f"{file_name(job)}{suffix}" for suffix in (".exr", ".png"))
    write_film(picture, film, scene, job.settings, half=False)
    write_png(preview, film.image)
    return [picture, preview], {f"mean.{letter}": _mean(plane) for letter, plane in zip("rgb", film.image, strict=True)}


def _gradient(job: Job, folder: Path) -> Outcome:
    scene = job_scene(job)
    found = picture_derivatives(scene, job.options["wrt"], job.settings)
    path = folder / f"{file_name(job)}.exr"
    write_derivatives(path, found, scene, job.settings)
    return [path], {f"mean.d.{name}": _mean(values) for name, values in zip(found.names, found.values, strict=True)}


def _mean(values: ArrayLike) -> float:
    return float(np.asarray(values).mean(dtype=np.float64))
