"""Jobs are shared out to the processes of dask.distributed, on this machine or on a cluster."""

import contextlib
import importlib.util
import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from raytrace_jax.batch.jobs import Job
from raytrace_jax.batch.run import Chunk, JobRecord, chunks, read_record, run_chunk, write_record
from raytrace_jax.errors import RaytraceError, one_sentence
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import install

SECONDS_TO_CONNECT = 30
SECONDS_BETWEEN_LOOKS = 0.2

OnDone = Callable[[Job, JobRecord], None]


def require() -> None:
    """Raise RaytraceError with the command that installs it if dask.distributed is missing."""
    if importlib.util.find_spec("distributed") is None:
        raise RaytraceError(f"--workers and --scheduler need dask.distributed: {install('batch')}")


def run_on_workers(
    jobs: Sequence[Job], folder: Path, workers: int | None, scheduler: str | None, on_done: OnDone
) -> None:
    """Run what is not done on workers; what a killed one was at goes to another one.

    A job that kills its worker again and again is recorded as failed, and those that shared its chunk run all the same.

    All workers see the folder under this path. They are so many processes here, each for one job at a time, or those
    of the scheduler at an address.

    Raises:
        RaytraceError: no scheduler answers at the address or it goes away, a record cannot be written.
    """
    with _client(workers, scheduler) as client:
        count = workers or max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
        given_up = _share_out(client, chunks(jobs, folder, count), folder, on_done)
        alone = [(job,) for chunk in given_up for job in chunk]
        for chunk in _share_out(client, alone, folder, on_done):
            [job] = chunk
            record = JobRecord(
                "failed", "the process that ran it died, each time it was tried: is there enough memory?"
            )
            write_record(folder, job, record)
            on_done(job, record)


def dask_setup(worker: object) -> None:
    """Called by dask in each worker that it starts here: Ctrl-C reaches it too, but it is the command that stops."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _work(chunk: Chunk, folder: Path) -> None:
    """Run a chunk in a worker."""
    with jax_session(64, devices=1):
        run_chunk(chunk, folder)


def _share_out(client: Any, work: Sequence[Chunk], folder: Path, on_done: OnDone) -> list[Chunk]:
    """Run chunks on the workers; return those that dask gave up, without their jobs that are done."""
    from distributed import KilledWorker

    futures = client.map(_work, work, folder=folder, pure=False)
    waiting = {job.name: job for chunk in work for job in chunk}
    while True:
        finished = all(future.status != "pending" for future in futures)
        # After the question above, so that no record is missed; a job's record is written when all else is.
        for job in list(waiting.values()):
            record = read_record(folder, job)
            if record:
                del waiting[job.name]
                on_done(job, record)
        if finished:
            break
        time.sleep(SECONDS_BETWEEN_LOOKS)
    given_up = []
    for future, chunk in zip(futures, work, strict=True):
        if future.status in ("cancelled", "lost"):
            raise RaytraceError("the scheduler or its workers are gone; the same command goes on where they were.")
        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            given_up.append(tuple(job for job in chunk if job.name in waiting))
        elif error is not None:
            raise RaytraceError(f"a worker failed: {one_sentence(error)}")
    return given_up


@contextlib.contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    """A client of the scheduler, or of a new one with workers on this machine, which end with it."""
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=SECONDS_TO_CONNECT)
        except (OSError, ValueError) as reason:
            raise RaytraceError(f"--scheduler {scheduler}: {one_sentence(reason)}") from None
        with client:
            yield client
        return
    # Without a limit on memory: dask would pause and kill workers by how much they hold, which XLA decides.
    options = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": None, "silence_logs": logging.CRITICAL}
    with LocalCluster(n_workers=workers, preload=[__name__], **options) as cluster, Client(cluster) as client:
        yield client
