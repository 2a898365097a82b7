"""Records of jobs: a job is done when its record exists, which is written after everything else that it writes."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from raytrace_jax.batch.jobs import Job
from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.files import atomic_write, read_bytes, write_text

FOLDER = "records"


@dataclass(frozen=True)
class Record:
    """What became of a job.

    Args:
        message: why it failed, in one line.
        outputs: its files, relative to the batch's folder.
        results: its numbers and words for the table, by column.
    """

    status: Literal["done", "failed"]
    message: str = ""
    outputs: tuple[str, ...] = ()
    results: Mapping[str, float | str | None] = field(default_factory=dict)
    seconds: float = 0.0


def write_plan(folder: Path, plan: Path) -> None:
    """Keep a copy of a plan beside the records, so that a batch that is stopped at once has left what it was.

    Raises:
        RaytraceError: a file cannot be read or written.
    """
    with atomic_write(folder / FOLDER / plan.name) as temporary:
        temporary.write_bytes(read_bytes(plan))


def record_path(folder: Path, job: Job) -> Path:
    """Where a job's record is."""
    return folder / FOLDER / f"{job.name}.json"


def write_record(folder: Path, job: Job, record: Record) -> None:
    """Write a job's record; a failure never replaces what another process has done.

    Raises:
        RaytraceError: the file cannot be written.
    """
    if record.status == "failed" and is_done(folder, job):
        return
    about: dict[str, Any] = {"job": job.name, "kind": job.kind, "scene": job.scene_name, "values": dict(job.values)}
    text = json.dumps({**about, "options": dict(job.options), **record.__dict__}, indent=2)
    write_text(record_path(folder, job), text + "\n")


def read_record(folder: Path, job: Job) -> Record | None:
    """The record of a job; None if it has none, or one that is broken or whose files are gone."""
    path = record_path(folder, job)
    if not path.exists():
        return None
    try:
        kept = json.loads(read_bytes(path))
        outputs = tuple(kept["outputs"])
        record = Record(kept["status"], kept["message"], outputs, kept["results"], kept["seconds"])
    except (RaytraceError, ValueError, KeyError, TypeError):
        return None
    return record if all((folder / output).exists() for output in outputs) else None


def is_done(folder: Path, job: Job) -> bool:
    """Whether a job need not run again; one that failed is tried again."""
    record = read_record(folder, job)
    return record is not None and record.status == "done"


def forget_failures(folder: Path, jobs: Iterable[Job]) -> None:
    """Remove the records of jobs that failed, so that they are tried again."""
    for job in jobs:
        if not is_done(folder, job):
            record_path(folder, job).unlink(missing_ok=True)


def other_records(folder: Path, jobs: Iterable[Job]) -> int:
    """How many records in the folder belong to jobs of other plans."""
    mine = {job.name for job in jobs}
    return sum(path.stem not in mine for path in (folder / FOLDER).glob("*.json") if not path.name.startswith("."))
