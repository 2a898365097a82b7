"""The command `batch` goes from a plan file to a folder of results and their table."""

import sys

from raytrace_jax.batch import cluster
from raytrace_jax.batch.jobs import expand, labelled
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.plan_file import PlanError
from raytrace_jax.batch.run import chunks, forget_failures, is_done, other_records, run_chunk, write_plan
from raytrace_jax.batch.table import has_parquet, make_table, remove_tables, write_overview, write_table
from raytrace_jax.cli.console import UsageError, print_warning, stderr_console
from raytrace_jax.cli.options.fits import Batch
from raytrace_jax.cli.preparation import check_folder
from raytrace_jax.cli.progress import BatchProgress
from raytrace_jax.util.files import json_text
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import install


def run_batch(command: Batch) -> int:
    """Run the jobs that are not done, write the table and the overview, print their paths; 1 if a job failed."""
    # What is wrong with the options shows before anything is read.
    if command.workers is not None and command.scheduler is not None:
        raise UsageError("--workers and --scheduler exclude each other: the scheduler has its own workers.")
    check_folder(command.output)
    on_workers = command.workers is not None or command.scheduler is not None
    if on_workers:
        cluster.require()
    # One core a job: its numbers, to the last bit, do not depend on how many cores there are.
    with jax_session(64, devices=1):
        try:
            jobs = labelled(expand(read_plan(command.plan)))
        except PlanError as reason:
            raise UsageError(str(reason)) from reason

        # A job that stands twice in the plan is run once; the folder may hold the jobs of other plans.
        folder = command.output.absolute()
        distinct = list({job.name: job for job in jobs}.values())
        todo = [job for job in distinct if not is_done(folder, job)]
        console = stderr_console(quiet=command.quiet)
        others = other_records(folder, jobs)
        if others:
            console.print(f"{command.output}: {others} of the jobs here belong to other plans and are left as they are")
        with BatchProgress(todo, len(distinct) - len(todo), console) as show:
            if todo:
                write_plan(folder, command.plan)
                remove_tables(folder)
                forget_failures(folder, distinct)
            if on_workers and todo:
                cluster.run_on_workers(distinct, folder, command.workers, command.scheduler, show.done)
            else:
                for chunk in chunks(distinct, folder):
                    run_chunk(chunk, folder, show.done)

    # The table and the overview are of all jobs of the plan, also of those that were done before.
    rows = make_table(jobs, folder)
    written = [command.output / path.name for path in [*write_table(rows, folder), *write_overview(jobs, folder)]]
    if command.json:
        sys.stdout.write(json_text({"files": written, "jobs": rows}))
    else:
        print(*written, sep="\n")
    if not has_parquet():
        console.print(f"results.parquet needs pyarrow: {install('batch')}")
    failed = sum(row["status"] != "done" for row in rows)
    if failed:
        print_warning(
            f"{failed} of {len(rows)} jobs failed; column message of {command.output / 'results.csv'} says why."
        )
    return 1 if failed else 0
