"""The command `batch`: from a plan file to a folder of results and their table."""

import importlib.util
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from statistics import mean
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from ...batch.jobs import Job, expand, labelled
from ...batch.plan import read_plan
from ...batch.plan_file import PlanError
from ...batch.run import JobRecord, is_done, other_records, run_and_record, run_on_workers, write_plan
from ...batch.table import make_table, remove_tables, write_overview, write_table
from ...errors import RaytraceError, reworded
from ...util.files import json_text
from ...util.text import install
from ..console import UsageError, print_warning, stderr_console
from ..options.fits import Batch
from ..preparation import check_folder
from ..progress import Shown

SECONDS_BETWEEN = 30.0  # Where there is no terminal, the least time between two lines.


def run_batch(command: Batch) -> int:
    """Run the jobs that are not done, write the table and the overview, print their paths; 1 if a job failed."""
    if command.workers is not None and command.scheduler is not None:
        raise UsageError("--workers and --scheduler exclude each other: the scheduler has its own workers.")
    check_folder(command.output)
    on_workers = command.workers is not None or command.scheduler is not None
    if on_workers and importlib.util.find_spec("distributed") is None:
        raise RaytraceError(f"--workers and --scheduler need dask.distributed: {install('batch')}")
    with reworded(UsageError, PlanError):
        plan = read_plan(command.plan)
    jobs = labelled(expand(plan))

    # A job that stands twice in the plan is run once; the folder may hold the jobs of other plans.
    folder = command.output.absolute()
    distinct = list({job.name: job for job in jobs}.values())
    todo = [job for job in distinct if not is_done(folder, job)]
    console = stderr_console(command.quiet)
    others = other_records(folder, jobs)
    if others:
        console.print(f"{command.output}: {others} of the jobs here belong to other plans and are left as they are")
    with BatchProgress(todo, len(distinct) - len(todo), console) as show:
        if todo:
            write_plan(folder, command.plan)
            remove_tables(folder)
        if on_workers and todo:
            run_on_workers(todo, folder, command.workers, command.scheduler, show.done)
        else:
            for job in todo:
                show.done(job, run_and_record(job, folder))

    # The table and the overview are of all jobs of the plan, also of those that were done before.
    rows = make_table(jobs, folder)
    written = [command.output / path.name for path in (write_table(rows, folder), write_overview(jobs, folder))]
    if command.json:
        sys.stdout.write(json_text({"files": written, "jobs": rows}))
    else:
        print(*written, sep="\n")
    failed = sum(row["status"] != "done" for row in rows)
    if failed:
        print_warning(f"{failed} of {len(rows)} jobs failed; column message of {written[0]} says why.")
    return 1 if failed else 0


class BatchProgress(Shown):
    """Shows how many jobs are done, which failed, and how long the others will take: use it as a context.

    Each kind of job has its own time, and compiling counts once for each kind and scene.

    Beside those to do `already` others were done before.
    """

    def __init__(self, todo: Sequence[Job], already: int, console: Console):
        bar = Progress(BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), console=console)
        self.total, self.already = already + len(todo), already
        self.task = bar.add_task("", total=self.total, completed=already)
        super().__init__(console, bar, "")
        self.ended, self.failed, self.shown_at = already, 0, self.began
        self.waiting = Counter((job.kind, job.scene_name) for job in todo)
        self.records = defaultdict[tuple[str, str], list[JobRecord]](list)

    def __enter__(self) -> Self:
        done = f", {self.already} of them done already" if self.already else ""
        self.console.print(f"{self.total} jobs{done}")
        return super().__enter__()

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        if self.total > self.already:
            words = "stopped; the same command goes on" if exception[0] else "ready"
            self.console.print(f"{self._counts()} in {duration(time.monotonic() - self.began)}, {words}")

    def done(self, job: Job, record: JobRecord) -> None:
        """Count a job that has ended, and say how long the others will take."""
        self.ended += 1
        if record.status == "failed":
            self.failed += 1
            self.console.print(f"{job.kind} {job.name} failed: {record.message}")
        self.waiting[job.kind, job.scene_name] -= 1
        self.records[job.kind, job.scene_name].append(record)
        now = time.monotonic()
        if self.display:
            self.display.update(self.task, advance=1, description=self._left(now))
        elif now - self.shown_at > SECONDS_BETWEEN:
            self.shown_at = now
            self.console.print(", ".join(filter(None, (self._counts(), self._left(now)))))

    def _left(self, now: float) -> str:
        """How long the jobs of the kinds that have been met will take, and how many others there are."""
        kinds, left, unknown = dict.fromkeys(kind for kind, _ in self.waiting), 0.0, list[str]()
        for kind in kinds:
            ended = [record for (of, _), records in self.records.items() if of == kind for record in records]
            waiting = {scene: count for (of, scene), count in self.waiting.items() if of == kind and count}
            if ended:
                left += sum(waiting.values()) * mean(record.seconds - record.compiling for record in ended)
                new = sum((kind, scene) not in self.records for scene in waiting)
                left += new * max(record.compiling for record in ended)
            elif waiting:
                unknown.append(f"{sum(waiting.values())} {kind}s not timed yet")
        # Workers run several at once.
        spent = sum(record.seconds for records in self.records.values() for record in records)
        known = f"about {duration(left * (now - self.began) / spent)} left" if spent and left else ""
        return ", ".join(filter(None, (known, *unknown)))

    def _counts(self) -> str:
        return f"{self.ended}/{self.total} jobs" + (f", {self.failed} failed" if self.failed else "")


def duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
