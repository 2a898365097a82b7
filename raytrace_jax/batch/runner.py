"""Running the jobs that are not done yet: those of one shape together, a failure without harm to the others."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax

from raytrace_jax.batch.jobs import Job, by_shape, job_scene
from raytrace_jax.batch.records import Record, is_done, write_record
from raytrace_jax.batch.run_job import run_job
from raytrace_jax.errors import RaytraceError, one_sentence
from raytrace_jax.tracer.programs.plan_cache import SAMPLED, plan_ahead

CHUNKS_EACH = 4
"""How many chunks a worker gets, where there are enough jobs: more make ends meet, fewer compile less often."""


class Chunk(NamedTuple):
    """Jobs of one shape that run one after the other in one process.

    Args:
        jobs: what is to do.
        sample: some jobs that stand for all of this shape, done ones included: programs are made with room for these,
            so that they are the same in every process, whichever jobs it gets.
    """

    jobs: tuple[Job, ...]
    sample: tuple[Job, ...]


def chunks(jobs: Sequence[Job], folder: Path, workers: int = 1) -> list[Chunk]:
    """Cut what is still to do into chunks, some for each worker, so that they end at about the same time."""
    groups = [(group, [job for job in group if not is_done(folder, job)]) for group in by_shape(jobs)]
    most = max(1, sum(len(todo) for _, todo in groups) // (CHUNKS_EACH * workers))
    found = []
    for group, todo in groups:
        sample = tuple(group[:: max(1, len(group) // SAMPLED)])
        found += [Chunk(tuple(todo[i : i + most]), sample) for i in range(0, len(todo), most)]
    return found


def run_chunk(chunk: Chunk, folder: Path, on_done: Callable[[Job, Record], None] | None = None) -> None:
    """Run the jobs of a chunk that are not done yet, and write their records.

    Raises:
        KeyboardInterrupt: Ctrl-C; the job that it met has no record.
        RaytraceError: a record cannot be written.
    """
    prepared = False
    for job in chunk.jobs:
        if is_done(folder, job):
            continue
        began = time.perf_counter()
        try:
            if not prepared:
                prepare(chunk)
                prepared = True
            record = run_job(job, folder)
        except Exception as error:
            record = Record("failed", one_sentence(error))
        record = Record(record.status, record.message, record.outputs, record.results, time.perf_counter() - began)
        write_record(folder, job, record)
        if on_done:
            on_done(job, record)


def prepare(chunk: Chunk) -> None:
    """Plan programs that have room for all jobs of the chunk's shape."""
    first = chunk.jobs[0]
    if first.kind == "fit":
        return  # A fit plans with room of its own.
    with jax.enable_x64(first.precision == 64):
        scenes = []
        for job in chunk.sample:
            try:
                scenes.append(job_scene(job))
            except RaytraceError:
                continue  # It will fail, when its turn comes.
        if scenes:
            plan_ahead(scenes, first.settings)
