"""Running the jobs that are not done yet: those of one shape together, a failure without harm to the others."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from raytrace_jax.batch.jobs import Job, by_shape
from raytrace_jax.batch.records import Record, is_done, write_record
from raytrace_jax.batch.run_job import run_job
from raytrace_jax.errors import one_sentence

CHUNKS_EACH = 4
"""How many chunks a worker gets, where there are enough jobs: more make ends meet, fewer compile less often."""

Chunk = tuple[Job, ...]
"""Jobs of one shape that run one after the other in one process."""


def chunks(jobs: Sequence[Job], folder: Path, workers: int = 1) -> list[Chunk]:
    """Cut what is still to do into chunks, some for each worker, so that they end at about the same time."""
    groups = by_shape([job for job in jobs if not is_done(folder, job)])
    most = max(1, sum(map(len, groups)) // (CHUNKS_EACH * workers))
    return [tuple(group[i : i + most]) for group in groups for i in range(0, len(group), most)]


def run_chunk(chunk: Chunk, folder: Path, on_done: Callable[[Job, Record], None] | None = None) -> None:
    """Run the jobs of a chunk that are not done yet, and write their records.

    Raises:
        KeyboardInterrupt: Ctrl-C; the job that it met has no record.
        RaytraceError: a record cannot be written.
    """
    for job in chunk:
        if is_done(folder, job):
            continue
        began = time.perf_counter()
        try:
            record = run_job(job, folder)
        except Exception as error:
            record = Record("failed", one_sentence(error))
        record = Record(record.status, record.message, record.outputs, record.results, time.perf_counter() - began)
        write_record(folder, job, record)
        if on_done:
            on_done(job, record)
