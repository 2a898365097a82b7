"""Batches that are killed, here and on workers: run again they end as if nothing had happened, byte for byte."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from batch_plans import HEAD, QUICK_FIT

ROOT = Path(__file__).parents[2]

PLAN = HEAD + "[grid]\ncyan.alpha = { start = 0.2, stop = 0.7, count = 12 }\n[render]\n" + QUICK_FIT
RENDERS, JOBS = 12, 24
TIMES = re.compile(rb"(?<=,done,,)[\d.]+|(?<=<td>done</td><td>)[^<]+")  # The seconds in the table and on the page.


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """A plan, with what an undisturbed run of it writes in the folder `whole` beside it."""
    path = tmp_path_factory.mktemp("batch") / "plan.toml"
    path.write_text(PLAN)
    finish(start(path, "whole"))
    return path


def start(plan, name, *more):
    return launch(plan, "raytrace_jax", "batch", str(plan), "-o", str(plan.parent / name), *more)


def launch(plan, module, *arguments):
    """A process; what this one has been told about JAX must not reach it."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "XLA_"))}
    environment = {**inherited, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(plan.parent / "cache")}
    command = [sys.executable, "-m", module, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment, start_new_session=True, **pipes)


def finish(process):
    _, shown = process.communicate(timeout=300)
    assert process.returncode == 0, shown
    return shown


def records(plan, name):
    return len(list((plan.parent / name / "records").glob("[!.]*.json")))


def wait_for(count, process, plan, name):
    deadline = time.monotonic() + 200
    while records(plan, name) < count:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.005)


def contents(folder):
    """Every file's bytes, but for the time that each job took and what killed processes had not finished writing."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file() and ".part-" not in path.name:
            found[path.relative_to(folder)] = TIMES.sub(b"", path.read_bytes())
            if path.parent.name == "records" and path.suffix == ".json":
                found[path.relative_to(folder)] = {**json.loads(path.read_text()), "seconds": None, "compiling": None}
    return found


def kill(process):
    process.kill()
    process.communicate()


def same(plan, name):
    first, second = (contents(plan.parent / folder) for folder in ("whole", name))
    assert first.keys() == second.keys()
    assert len(first) == JOBS * 3 + 3  # The table, the page and the plan.
    assert [path for path in first if first[path] != second[path]] == []


@pytest.mark.slow
def test_a_killed_batch_is_resumed(plan):
    for count in (2, RENDERS + 2):
        process = start(plan, "killed")
        wait_for(count, process, plan, "killed")
        kill(process)
        assert count <= records(plan, "killed") < JOBS
        assert not (plan.parent / "killed" / "results.csv").exists()
    shown = finish(start(plan, "killed"))
    assert "of them done already" in shown.splitlines()[0]
    same(plan, "killed")


@pytest.mark.slow
def test_killed_processes_change_nothing(plan):
    process = start(plan, "workers", "--workers", "2")
    wait_for(2, process, plan, "workers")
    victim = worker_processes(process)[0]
    victim.kill()
    wait_for(RENDERS + 2, process, plan, "workers")
    orphans = worker_processes(process)
    assert len(orphans) == 2  # The one that was killed has a successor.
    kill(process)
    assert records(plan, "workers") < JOBS
    _, alive = psutil.wait_procs(orphans, timeout=60)
    assert alive == []
    finish(start(plan, "workers", "--workers", "2"))
    same(plan, "workers")


@pytest.mark.slow
def test_a_users_scheduler_shares_the_jobs(plan):
    file = str(plan.parent / "scheduler.json")
    options = ["--scheduler-file", file, "--no-dashboard"]
    scheduler = launch(plan, "distributed.cli.dask_scheduler", *options, "--port", "0", "--host", "127.0.0.1")
    worker = launch(plan, "distributed.cli.dask_worker", *options, "--nthreads", "1", "--no-nanny")
    try:
        deadline = time.monotonic() + 60
        while not Path(file).exists():
            assert time.monotonic() < deadline and scheduler.poll() is None
            time.sleep(0.1)
        address = json.loads(Path(file).read_text())["address"]
        finish(start(plan, "scheduler", "--scheduler", address))
        assert worker.poll() is None
    finally:
        kill(worker)
        kill(scheduler)
    same(plan, "scheduler")


def worker_processes(process):
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]
