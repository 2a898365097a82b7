"""What people see of a batch: the names of its files, and the page, without tracing a ray."""

import dataclasses
import json
import re
from urllib.parse import unquote

import pytest
from batch_plans import HEAD, QUICK_FIT
from PIL import Image

from raytrace_jax.batch.jobs import expand, file_name, labelled
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import JobRecord, write_record
from raytrace_jax.batch.table import remove_tables, write_overview

GRID = "[grid]\nvitreous.ior = [1.2, 1.45, 1.6]\nvitreous.center = [[4.3, 2.3, -1.0], [4.0, 2.3, -1.0]]\n[render]\n"


@pytest.fixture
def jobs_of(tmp_path):
    def jobs(text):
        (tmp_path / "plan.toml").write_text(HEAD + text)
        return labelled(expand(read_plan(tmp_path / "plan.toml")))

    return jobs


def finish(folder, job, path, **results):
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (16, 12), "red").save(folder / path)
    write_record(folder, job, JobRecord("done", outputs=(path,), results=results))


def test_job_names_are_unique_and_stable(jobs_of):
    jobs = jobs_of("[set]\ncyan.alpha = 0.5\n" + GRID)
    names = [file_name(job) for job in jobs]
    assert names[2] == f"vitreous.ior=1.45,vitreous.center.x=4.3_{jobs[2].name[:8]}"
    assert names == [file_name(job) for job in jobs_of("[set]\ncyan.alpha = 0.5\n" + GRID)]
    # Another plan with the same folder, which varies the same but is not the same, takes other names.
    others = [file_name(job) for job in jobs_of("[set]\ncyan.alpha = 0.6\n" + GRID)]
    assert len(set(names + others)) == 12
    [alone] = jobs_of("[render]")
    assert file_name(alone) == f"vitreous_{alone.name[:8]}"
    [fit, *_] = jobs_of(QUICK_FIT.replace("noise = [0.01]", "noise = [0.01, 0.02]\nseeds = [1, 2]"))
    assert file_name(fit).startswith("noise=0.01,seed=1_")
    for varied in ((("a#1.ior", "<>:|?*/\\ä"),), tuple(("b" * 30, "1") for _ in range(20))):
        name = file_name(dataclasses.replace(alone, varied=varied))
        assert re.fullmatch(r"[\w.,=+-]{1,109}", name, re.ASCII)


def test_the_page_links_jobs_to_their_files(jobs_of, tmp_path):
    renders = jobs_of(GRID)
    [fit] = jobs_of(QUICK_FIT)
    for job in renders[1:]:
        finish(tmp_path, job, f"render/{file_name(job)}.png")
    write_record(tmp_path, renders[0], JobRecord("failed", "<no> light"))
    numbers = {"fit.status": "converged", "fit.cyan.alpha": 0.39991, "fit.cyan.alpha.total_error": 0.0033}
    numbers["fit.cyan.alpha.standard_error"] = 0.0001
    finish(tmp_path, fit, f"fit/{file_name(fit)}/result.png", **numbers)
    (tmp_path / "results.csv").write_text("")
    assert write_overview([*renders, fit], tmp_path) == tmp_path / "index.html"
    page = (tmp_path / "index.html").read_text()
    assert page.count("<tr><td>") == 7 and "1 failed" in page and "&lt;no&gt; light" in page
    assert "0.3999(33)" in page and "_error" not in page
    links = re.findall(r'(?:href|src)="([^"]+)"', page.replace('href="data:,"', ""))
    assert len(links) > 14 and all((tmp_path / unquote(link)).exists() for link in links)
    assert all(not link.startswith("/") and "=" not in link for link in links)
    remove_tables(tmp_path)
    assert not (tmp_path / "index.html").exists()
    assert json.loads(next((tmp_path / "records").glob("*.json")).read_text())
