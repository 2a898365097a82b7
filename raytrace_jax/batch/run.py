"""The run of a job, its files and its record."""

import dataclasses
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from jax.typing import ArrayLike

from ..errors import RaytraceError, one_sentence
from ..images import jpeg, masks, pictures
from ..images.png import write_png
from ..inverse.build_problem import as_file_says
from ..inverse.estimate import fit
from ..inverse.options import FitOptions
from ..inverse.result import FitResult
from ..report.films import write_derivatives, write_film
from ..report.fit_report.summary import summarize
from ..scene.parameters import set_parameters
from ..scene.writer import save_scene
from ..tracer.derivatives import picture_derivatives
from ..tracer.rendering import render
from ..util.files import atomic_write, json_text, read_bytes, write_text
from .jobs import OF_NOISE, TOTAL, Job, file_name, job_scene
from .plan import OPTIONS

FOLDER = "records"


@dataclass(frozen=True)
class JobRecord:
    """The outcome of a job: its files, relative to the batch's folder, and its cells of the table, by column."""

    status: Literal["done", "failed", "missing"]
    message: str = ""
    outputs: tuple[str, ...] = ()
    results: Mapping[str, float | str | None] = field(default_factory=dict)
    seconds: float = 0.0


def write_plan(folder: Path, plan: Path) -> None:
    """Keep a copy of a plan beside the records, so that a batch that is stopped at once has left what it was."""
    with atomic_write(folder / FOLDER / plan.name) as temporary:
        temporary.write_bytes(read_bytes(plan))


def write_record(folder: Path, job: Job, record: JobRecord) -> None:
    """Write a job's record; a failure never replaces what another process has done."""
    if record.status == "failed" and is_done(folder, job):
        return
    about: dict[str, Any] = {"job": job.name, "kind": job.kind, "scene": job.scene_name, "values": dict(job.values)}
    text = json.dumps({**about, "options": dict(job.options), **record.__dict__}, indent=2)
    write_text(folder / FOLDER / f"{job.name}.json", text + "\n")


def read_record(folder: Path, job: Job) -> JobRecord | None:
    """The record of a job; None if it has none, or one that is broken or whose files are gone."""
    path = folder / FOLDER / f"{job.name}.json"
    if not path.exists():
        return None
    try:
        kept = json.loads(read_bytes(path))
        outputs = tuple(kept["outputs"])
        record = JobRecord(kept["status"], kept["message"], outputs, kept["results"], kept["seconds"])
    except (RaytraceError, ValueError, KeyError, TypeError):
        return None
    return record if all((folder / output).exists() for output in outputs) else None


def is_done(folder: Path, job: Job) -> bool:
    """Whether a job need not run again; one that failed is tried again."""
    record = read_record(folder, job)
    return record is not None and record.status == "done"


def other_records(folder: Path, jobs: Iterable[Job]) -> int:
    mine = {job.name for job in jobs}
    return sum(path.stem not in mine for path in (folder / FOLDER).glob("[!.]*.json"))


Outcome = tuple[list[Path], Mapping[str, float | str | None]]
"""The paths of a job's files, and its numbers for the table, by column."""


def _fit(job: Job, folder: Path) -> Outcome:
    options, path = job.options, job.target
    # A rendered target has the job's values, and the search for them begins at those of the scene.
    scene = set_parameters(job_scene(job, None if path else options["fixed"]), options["start"])
    how, weights, storage = FitOptions(**{name: options[name] for name in OPTIONS}), None, None
    if path:
        how, picture = as_file_says(how, path, scene, options["free"]), pictures.read_picture(path)
        weights = masks.clipped_pixels(path, picture, "auto", clamps=job.settings.model != "physical").weights
        storage = jpeg.jpeg_storage(path) if pictures.is_jpeg(path) else None
        target = picture.astype(f"float{job.precision}")
    else:
        settings = dataclasses.replace(job.settings, samples=options["target_samples"])
        target = np.asarray(render(job_scene(job), settings).image)
    noise = np.random.default_rng(options["seed"]).normal(scale=options["noise"], size=target.shape)
    target = target + noise.astype(target.dtype)
    result = fit(scene, target, options["free"], job.settings, options=how, weights=weights, storage=storage)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    fitted, numbers = (folder / file_name(job) / name for name in ("fit.txt", "result.json"))
    summary = summarize(result, save_scene(result.scene, fitted, model=result.settings.model))
    # Without its times: the same fit has the same file.
    for row in (summary["provenance"], *summary["history"]):
        for name in ("date", "seconds", "stages"):
            row.pop(name, None)
    write_text(numbers, json_text(summary))
    return [numbers, fitted], _estimates(result)


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


def run_job(job: Job, folder: Path) -> JobRecord:
    """Run a job and write its files into `folder/KIND`; the caller writes its record."""
    with jax.enable_x64(job.precision == 64):
        outputs, results = {"render": _render, "gradient": _gradient, "fit": _fit}[job.kind](job, folder / job.kind)
    return JobRecord("done", outputs=tuple(path.relative_to(folder).as_posix() for path in outputs), results=results)


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


def run_and_record(job: Job, folder: Path) -> JobRecord:
    """Run a job, write its record and return it; a job that Ctrl-C meets gets none."""
    began = time.perf_counter()
    try:
        record = run_job(job, folder)
    except Exception as error:
        record = JobRecord("failed", one_sentence(error))
    record = dataclasses.replace(record, seconds=time.perf_counter() - began)
    write_record(folder, job, record)
    return record
