"""Sharing jobs out: chunks, jobs that kill their workers, and workers that are gone. The workers are fakes."""

import contextlib
import types

import pytest
from command_line import run
from distributed import KilledWorker
from scenes import DATA

from raytrace_jax import RaytraceError
from raytrace_jax.batch.cluster import run_on_workers
from raytrace_jax.batch.jobs import expand
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import CHUNKS_EACH, JobRecord, chunks, read_record, write_record

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
    """Run jobs on a worker that does nothing but write records; `outcome(chunk)` is a future's status and error."""
    seen, reported = [], []

    class Client:
        def scheduler_info(self, n_workers):
            return {"workers": {"only": None}}

        def map(self, function, work, folder, pure):
            futures = []
            for chunk in work:
                seen.append(chunk)
                status, error = outcome(chunk)
                for job in chunk if status == "finished" else ():
                    write_record(folder, job, JobRecord("done"))
                futures.append(types.SimpleNamespace(status=status, exception=lambda error=error: error))
            return futures

    client = contextlib.nullcontext(Client())
    monkeypatch.setattr("raytrace_jax.batch.cluster._client", lambda workers, scheduler: client)
    run_on_workers(jobs, folder, None, "tcp://fake:1", lambda job, record: reported.append((job.name, record.status)))
    return seen, reported


def test_chunks_are_of_one_shape_and_some_for_each_worker(jobs, tmp_path):
    for job in jobs[:8]:
        write_record(tmp_path, job, JobRecord("done"))
    found = chunks(jobs, tmp_path, workers=2)
    assert [job for chunk in found for job in chunk] == jobs[8:]
    assert all(len({job.shape for job in chunk}) == 1 for chunk in found)
    assert 2 * CHUNKS_EACH <= len(found) <= 2 * CHUNKS_EACH + 2


def test_a_job_that_kills_its_workers_fails_alone(jobs, tmp_path, monkeypatch):
    killer = jobs[17]
    death = KilledWorker("work", types.SimpleNamespace(address="tcp://gone:1"), 3)

    def outcome(chunk):
        return ("error", death) if killer in chunk else ("finished", None)

    seen, reported = run_with(monkeypatch, jobs, tmp_path, outcome)
    assert sorted(name for name, _ in reported) == sorted(job.name for job in jobs)
    assert [name for name, status in reported if status == "failed"] == [killer.name]
    assert "died" in read_record(tmp_path, killer).message
    assert [chunk for chunk in seen if killer in chunk][-1] == (killer,)


def test_a_scheduler_that_goes_away_is_said(jobs, tmp_path, monkeypatch):
    with pytest.raises(RaytraceError, match="are gone; the same command goes on"):
        run_with(monkeypatch, jobs, tmp_path, lambda chunk: ("cancelled", None))
    with pytest.raises(RaytraceError, match="a worker failed: no room"):
        run_with(monkeypatch, jobs, tmp_path, lambda chunk: ("error", OSError("no room")))


def test_a_failure_never_replaces_what_is_done(jobs, tmp_path):
    write_record(tmp_path, jobs[0], JobRecord("done"))
    write_record(tmp_path, jobs[0], JobRecord("failed", "late"))
    assert read_record(tmp_path, jobs[0]).status == "done"


def test_no_scheduler_at_the_address_is_one_message(jobs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("raytrace_jax.batch.cluster.SECONDS_TO_CONNECT", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        assert run("batch", str(tmp_path / "plan.toml"), "-o", str(tmp_path / "out"), "--scheduler", address) == 1
        lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert len(lines) == 1 and lines[0].startswith(f"error: --scheduler {address}: ")
