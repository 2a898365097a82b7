"""A batch as it goes: a bar on a terminal, else a line now and then, with an estimate of the time left."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from raytrace_jax.batch.jobs import Job
from raytrace_jax.batch.records import Record

SECONDS_BETWEEN = 5.0
"""Between two lines where there is no terminal."""


class BatchProgress:
    """Shows how many jobs are done, and which failed: use it as a context.

    Args:
        total: how many jobs there are.
        todo: how many of them are not done yet.
        console: where to show it; a quiet console shows nothing.
    """

    def __init__(self, total: int, todo: int, console: Console):
        self.total, self.todo, self.console = total, todo, console
        self.finished = self.failed = 0
        self.began = self.shown_at = time.monotonic()
        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
        self.bar = Progress(*columns, console=console) if console.is_terminal and not console.quiet else None
        self.task = self.bar.add_task("", total=total, completed=total - todo) if self.bar else None

    def __enter__(self) -> Self:
        already = self.total - self.todo
        self.console.print(f"{self.total} jobs" + (f", {already} of them done already" if already else ""))
        if self.bar:
            self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.bar:
            self.bar.stop()
        if self.todo:
            words = "stopped; the same command goes on" if kind else "ready"
            self.console.print(f"{self._counts()} in {duration(time.monotonic() - self.began)}, {words}")

    def done(self, job: Job, record: Record) -> None:
        """Count a job that has ended, and say how long the others will take."""
        self.finished += 1
        if record.status == "failed":
            self.failed += 1
            self.console.print(f"{job.kind} {job.name} failed: {record.message}")
        now = time.monotonic()
        left = (self.todo - self.finished) * (now - self.began) / self.finished
        words = f"about {duration(left)} left"
        if self.bar and self.task is not None:
            self.bar.update(self.task, advance=1, description=words)
        elif now - self.shown_at > SECONDS_BETWEEN:
            self.shown_at = now
            self.console.print(f"{self._counts()}, {words}")

    def _counts(self) -> str:
        failures = f", {self.failed} failed" if self.failed else ""
        return f"{self.total - self.todo + self.finished}/{self.total} jobs{failures}"


def duration(seconds: float) -> str:
    """A time as people say it: `8 s`, `12 min`, `3.5 h`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
