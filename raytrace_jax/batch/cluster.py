"""The processes of dask.distributed that run jobs, on this machine or on a cluster."""

import contextlib
import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ..errors import RaytraceError, one_sentence
from ..util.session import jax_session
from .jobs import Job
from .run import JobRecord, read_record, run_and_record, write_record

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


@contextlib.contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        where: Any = scheduler
        if scheduler is None:
            # Without a limit on memory: dask would pause and kill workers by how much they hold, which XLA decides.
            options = {"memory_limit": 0, "dashboard_address": None, "silence_logs": logging.CRITICAL}
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, preload=[__name__], **options)
            where = stack.enter_context(cluster)
        try:
            client = stack.enter_context(Client(where, timeout=SECONDS_TO_CONNECT))
        except (OSError, ValueError) as reason:
            raise RaytraceError(f"--scheduler {scheduler}: {one_sentence(reason)}") from None
        yield client
