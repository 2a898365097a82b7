"""One job: its files, and its numbers for the table."""

from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
from jax.typing import ArrayLike

from raytrace_jax.batch.fit_job import run_fit
from raytrace_jax.batch.jobs import Job, job_scene
from raytrace_jax.batch.records import Record
from raytrace_jax.images.png import write_png
from raytrace_jax.report.films import write_derivatives, write_film
from raytrace_jax.tracer.derivatives import picture_derivatives
from raytrace_jax.tracer.rendering import render

Outcome = tuple[list[Path], Mapping[str, float | str | None]]


def run_job(job: Job, folder: Path) -> Record:
    """Run a job and write its files into `folder/KIND`; its record is for the caller to write.

    Raises:
        RaytraceError: what the job wants is impossible, or a file cannot be read or written.
        KeyboardInterrupt: Ctrl-C.
    """
    place = folder / job.kind / job.name
    with jax.enable_x64(job.precision == 64):
        outputs, results = {"render": _render, "gradient": _gradient, "fit": run_fit}[job.kind](job, place)
    return Record("done", outputs=tuple(path.relative_to(folder).as_posix() for path in outputs), results=results)


def _render(job: Job, place: Path) -> Outcome:
    scene = job_scene(job)
    film = render(scene, job.settings)
    picture, preview = place.with_suffix(".exr"), place.with_suffix(".png")
    write_film(picture, film, scene, job.settings, half=False)
    write_png(preview, film.image)
    return [picture, preview], {f"mean.{letter}": _mean(plane) for letter, plane in zip("rgb", film.image, strict=True)}


def _gradient(job: Job, place: Path) -> Outcome:
    scene = job_scene(job)
    found = picture_derivatives(scene, job.options["wrt"], job.settings)
    path = place.with_suffix(".exr")
    write_derivatives(path, found, scene, job.settings)
    return [path], {f"mean.d.{name}": _mean(values) for name, values in zip(found.names, found.values, strict=True)}


def _mean(values: ArrayLike) -> float:
    return float(np.asarray(values).mean(dtype=np.float64))
