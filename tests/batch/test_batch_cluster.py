"""Sharing jobs out: jobs that kill their workers, and workers that are gone. The workers are fakes."""

import contextlib
import types

import pytest
from command_line import run
from distributed import KilledWorker
from scenes import DATA

from raytrace_jax import RaytraceError
from raytrace_jax.batch.jobs import expand
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import JobRecord, read_record, run_on_workers, write_record

PLAN = f"""scenes = ['{(DATA / "vitreous.txt").as_posix()}']
[grid]
vitreous.ior = {{ start = 1.0, stop = 2.0, count = 40 }}
[render]
[gradient]
wrt = ["cyan.ior"]
"""


@pytest.fixture
def jobs(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    return expand(read_plan(tmp_path / "plan.toml"))


def run_with(monkeypatch, jobs, folder, outcome):
    """Run jobs on a worker that does nothing but write records; `outcome(job)` is a future's status and error."""
    reported = []

    def submit(function, jobs, folder, pure):
        for job in jobs:
            status, error = outcome(job)
            if status == "finished":
                write_record(folder, job, JobRecord("done"))
            yield types.SimpleNamespace(status=status, exception=lambda error=error: error)

    client = contextlib.nullcontext(types.SimpleNamespace(map=submit))
    monkeypatch.setattr("raytrace_jax.batch.run._client", lambda workers, scheduler: client)
    monkeypatch.setattr("raytrace_jax.batch.run.SECONDS_BETWEEN_LOOKS", 0)
    run_on_workers(jobs, folder, None, "tcp://fake:1", lambda job, record: reported.append((job.name, record.status)))
    return reported


def test_a_worker_killing_job_fails_alone(jobs, tmp_path, monkeypatch):
    killer, beside = jobs[17:19]
    death = KilledWorker("work", types.SimpleNamespace(address="tcp://gone:1"), 3)
    accused = [killer, beside]  # One that waited where the other one was run is accused, too, the first time.

    def outcome(job):
        died = job == killer or job in accused
        return ("error", death) if died and (job == killer or not accused.remove(job)) else ("finished", None)

    reported = run_with(monkeypatch, jobs, tmp_path, outcome)
    assert sorted(name for name, _ in reported) == sorted(job.name for job in jobs)
    assert [name for name, status in reported if status == "failed"] == [killer.name]
    assert "died" in read_record(tmp_path, killer).message
    write_record(tmp_path, jobs[0], JobRecord("failed", "late"))  # It never replaces what is done.
    assert read_record(tmp_path, jobs[0]).status == "done"


def test_a_scheduler_that_goes_away_is_said(jobs, tmp_path, monkeypatch):
    with pytest.raises(RaytraceError, match="are gone; the same command goes on"):
        run_with(monkeypatch, jobs, tmp_path, lambda job: ("cancelled", None))
    with pytest.raises(RaytraceError, match="a worker failed: no room"):
        run_with(monkeypatch, jobs, tmp_path, lambda job: ("error", OSError("no room")))


def test_no_scheduler_is_one_message(jobs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("raytrace_jax.batch.run.SECONDS_TO_CONNECT", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        assert run("batch", str(tmp_path / "plan.toml"), "-o", str(tmp_path / "out"), "--scheduler", address) == 1
        lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert len(lines) == 1 and lines[0].startswith(f"error: --scheduler {address}: ")
