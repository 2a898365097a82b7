"""The run of a job, its files and its record; and the processes of dask.distributed that run many."""

import contextlib
import dataclasses
import json
import logging
import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from ..errors import ParameterError, RaytraceError, one_sentence
from ..images import jpeg, masks
from ..images.pictures import is_jpeg, read_picture
from ..images.png import write_png
from ..inverse.build_problem import as_file_says, of_each_view
from ..inverse.estimate import fit
from ..inverse.options import FitOptions
from ..inverse.result import FitResult
from ..report.films import view_paths, write_derivatives, write_film
from ..report.fit_report.summary import summarize
from ..scene.parameters import set_parameters
from ..scene.scene import Scene
from ..scene.writer import save_scene
from ..tracer.rendering import picture_derivatives, render
from ..util.compilation import SECONDS_COMPILING
from ..util.files import atomic_write, json_text, read_bytes, strict, write_text
from ..util.session import jax_session
from .jobs import OF_NOISE, OF_TRUTH, TOTAL, Job, file_name, job_scene
from .plan import OPTIONS

FOLDER = "records"


@dataclass(frozen=True)
class JobRecord:
    """The outcome of a job: its files, relative to the batch's folder, and its cells of the table, by column."""

    status: Literal["done", "failed", "missing"]
    message: str = ""
    outputs: Sequence[str] = ()
    results: Mapping[str, float | str | None] = field(default_factory=dict)
    seconds: float = 0.0
    compiling: float = 0.0  # Seconds of these that went into programs, which later jobs of this process share.


MISSING = JobRecord("missing")
"""What stands for the record of a job that has none."""


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
        cells = [kept[name] for name in ("status", "message", "outputs", "results", "seconds")]
        record = JobRecord(*cells, compiling=kept.get("compiling", 0.0))
    except (RaytraceError, ValueError, KeyError, TypeError):
        return None
    return record if all((folder / output).exists() for output in record.outputs) else None


def is_done(folder: Path, job: Job) -> bool:
    """Whether a job need not run again; one that failed is tried again."""
    return (read_record(folder, job) or MISSING).status == "done"


def other_records(folder: Path, jobs: Iterable[Job]) -> int:
    """The number of records in a batch's folder that are of none of the jobs."""
    mine = {job.name for job in jobs}
    return sum(path.stem not in mine for path in (folder / FOLDER).glob("[!.]*.json"))


Outcome = tuple[list[Path], Mapping[str, float | str | None]]
"""The paths of a job's files, and its numbers for the table, by column."""


def _fit(job: Job, folder: Path) -> Outcome:
    options = job.options
    # A rendered target has the job's values, and the search for them begins at those of the scene.
    scene = set_parameters(job_scene(job, None if job.target else options["fixed"]), options["start"])
    how, truths = FitOptions(**{name: options[name] for name in OPTIONS}), None
    if job.target:
        paths, clamps = of_each_view(scene, "a picture", job.target), job.settings.model != "physical"
        how = as_file_says(how, paths.values(), scene, options["free"])
        targets = {camera: read_picture(path) for camera, path in paths.items()}
        weights = {
            c: masks.clipped_pixels(path, targets[c], "auto", clamps=clamps).weights for c, path in paths.items()
        }
        storage = {c: jpeg.jpeg_storage(path) if is_jpeg(path) else None for c, path in paths.items()}
    else:
        truths, settings = job_scene(job), dataclasses.replace(job.settings, samples=options["target_samples"])
        targets = {camera: np.asarray(render(truths.seen_by(camera), settings).image) for camera in truths.cameras}
        weights = storage = None
    random, dtype = np.random.default_rng(options["seed"]), f"float{job.precision}"
    for camera, target in targets.items():
        noise = random.normal(scale=options["noise"], size=target.shape)
        targets[camera] = target.astype(dtype) + noise.astype(dtype)
    result = fit(scene, targets, options["free"], job.settings, options=how, weights=weights, storage=storage)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    fitted, numbers = (folder / file_name(job) / name for name in ("fit.txt", "result.json"))
    summary = summarize(result, save_scene(result.scene, fitted, model=result.settings.model))
    # Without its times: the same fit has the same file.
    for row in (summary["provenance"], *summary["history"]):
        for name in ("date", "seconds", "stages"):
            row.pop(name, None)
    write_text(numbers, json_text(summary))
    return [numbers, fitted], _estimates(result, truths)


def _estimates(result: FitResult, truths: Scene | None) -> dict[str, Any]:
    """The numbers of the table, with those of the target's scene, if there is one; None for infinite and no numbers."""
    numbers: dict[str, Any] = {"fit.status": result.status}
    numbers["fit.causes"] = "; ".join(cause.words for cause in result.check.causes) or None
    for camera, view in result.views.items():
        numbers[f"fit.rms_residual.{camera}" if result.further_views else "fit.rms_residual"] = view.rms_residual
    for row in result.parameters.values():
        errors = {f"fit.{row.name}{OF_NOISE}": row.standard_error, f"fit.{row.name}{TOTAL}": row.error}
        numbers |= {f"fit.{row.name}": row.value, **errors}
        with contextlib.suppress(ParameterError):  # Not all that is free is the scene's.
            numbers |= {f"fit.{row.name}{OF_TRUTH}": float(truths[row.name])} if truths else {}
    return {name: strict(value) for name, value in numbers.items()}


def run_job(job: Job, folder: Path) -> JobRecord:
    """Run a job and write its files into `folder/KIND`; the caller writes its record."""
    with jax.enable_x64(job.precision == 64):
        outputs, results = (_fit if job.kind == "fit" else _pictures)(job, folder / job.kind)
    return JobRecord("done", outputs=tuple(path.relative_to(folder).as_posix() for path in outputs), results=results)


def _pictures(job: Job, folder: Path) -> Outcome:
    """What each camera sees, or its derivatives; the numbers are means over the picture."""
    outputs, results, scene = list[Path](), dict[str, float | str | None](), job_scene(job)
    for camera, path in view_paths(folder / f"{file_name(job)}.exr", scene).items():
        view, mean = scene.seen_by(camera), f"mean.{camera}" if scene.further_views else "mean"
        outputs.append(path)
        if job.kind == "gradient":
            found = picture_derivatives(view, job.options["wrt"], job.settings)
            write_derivatives(path, found, view, job.settings)
            columns, values = [f"{mean}.d.{name}" for name in found.names], found.values
        else:
            film, preview = render(view, job.settings), path.with_suffix(".png")
            write_film(path, film, view, job.settings)
            write_png(preview, film.image)
            outputs.append(preview)
            columns, values = [f"{mean}.{letter}" for letter in "rgb"], film.image
        for column, each in zip(columns, values, strict=True):
            results[column] = float(np.asarray(each).mean(dtype=np.float64))
    return outputs, results


def run_and_record(job: Job, folder: Path) -> JobRecord:
    """Run a job, write its record and return it; a job that Ctrl-C meets gets none."""
    began, before = time.perf_counter(), len(SECONDS_COMPILING)
    try:
        record = run_job(job, folder)
    except Exception as error:
        record = JobRecord("failed", one_sentence(error))
    record = dataclasses.replace(record, seconds=time.perf_counter() - began, compiling=sum(SECONDS_COMPILING[before:]))
    write_record(folder, job, record)
    return record


SECONDS_TO_CONNECT = 30
SECONDS_BETWEEN_LOOKS = 0.2

OnDone = Callable[[Job, JobRecord], None]


def run_on_workers(
    jobs: Sequence[Job], folder: Path, workers: int | None, scheduler: str | None, on_done: OnDone
) -> None:
    """Run jobs on so many `workers` here, or on those of a `scheduler`, by its address, which see the folder too.

    A job whose worker dies goes to another one; one that kills its worker again and again is recorded as failed.

    Raises:
        RaytraceError: no scheduler answers at the address or it goes away, a record cannot be written.
    """
    with _client(workers, scheduler) as client:
        # Dask suspects all that waited at a worker that died; alone, only those that kill it are left.
        for job in _share_out(client, _share_out(client, jobs, folder, on_done), folder, on_done):
            record = JobRecord(
                "failed", "the process that ran it died, each time it was tried: is there enough memory?"
            )
            write_record(folder, job, record)
            on_done(job, record)


def dask_setup(worker: object) -> None:
    """Called by dask in each worker that it starts here: Ctrl-C reaches it too, but it is the command that stops."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _work(job: Job, folder: Path) -> None:
    with jax_session(64, devices=1):
        run_and_record(job, folder)


def _share_out(client: Any, jobs: Sequence[Job], folder: Path, on_done: OnDone) -> list[Job]:
    """Run jobs on the workers; return those that dask gave up, since their workers died."""
    from distributed import KilledWorker

    futures = client.map(_work, jobs, folder=folder, pure=False)
    waiting, given_up = dict(enumerate(futures)), []
    while waiting:
        time.sleep(SECONDS_BETWEEN_LOOKS)
        for number in [number for number, future in waiting.items() if future.status != "pending"]:
            future, job = waiting.pop(number), jobs[number]
            if future.status in ("cancelled", "lost"):
                raise RaytraceError("the scheduler or its workers are gone; the same command goes on where they were.")
            error = future.exception() if future.status == "error" else None
            if isinstance(error, KilledWorker):
                given_up.append(job)
            elif error is not None:
                raise RaytraceError(f"a worker failed: {one_sentence(error)}")
            elif record := read_record(folder, job):
                on_done(job, record)
    return given_up


def _client(workers: int | None, scheduler: str | None) -> Any:
    """The client of a scheduler, or of one that dask starts here with so many workers and ends with the client."""
    from distributed import Client

    # Without a limit on memory: dask would pause and kill workers by how much they hold, which XLA decides.
    here = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "preload": [__name__],
        "memory_limit": 0,
        "dashboard_address": None,
        "silence_logs": logging.CRITICAL,
    }
    try:
        return Client(scheduler, timeout=SECONDS_TO_CONNECT, **({} if scheduler else here))
    except (OSError, ValueError) as reason:
        option = f"--scheduler {scheduler}" if scheduler else f"--workers {workers}"
        raise RaytraceError(f"{option}: {one_sentence(reason)}") from None
