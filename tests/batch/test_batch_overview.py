"""What people see of a batch: the names of its files, and the page, without tracing a ray."""

import dataclasses
import json
import re
from urllib.parse import unquote

import pytest
from batch_plans import HEAD, QUICK_FIT
from PIL import Image

from raytrace_jax.batch import plots
from raytrace_jax.batch.jobs import expand, file_name, labelled
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import JobRecord, write_record
from raytrace_jax.batch.table import make_table, remove_tables, write_overview

GRID = "[grid]\nvitreous.ior = [1.2, 1.45, 1.6]\nvitreous.center = [[4.3, 2.3, -1.0], [4.0, 2.3, -1.0]]\n[render]\n"


@pytest.fixture
def jobs_of(tmp_path):
    def jobs(text):
        (tmp_path / "plan.toml").write_text(HEAD + text)
        return labelled(expand(read_plan(tmp_path / "plan.toml")))

    return jobs


def finish(folder, job, path, seconds=0.0, **results):
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (16, 12), "red").save(folder / path)
    write_record(folder, job, JobRecord("done", outputs=(path,), results=results, seconds=seconds))


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
    finish(tmp_path, fit, f"fit/{file_name(fit)}/result.png", seconds=2.5, **numbers)
    (tmp_path / "results.csv").write_text("")
    assert write_overview([*renders, fit], tmp_path) == tmp_path / "index.html"
    page = (tmp_path / "index.html").read_text()
    assert page.count("<tr><td>") == 7 and "1 failed" in page and "&lt;no&gt; light" in page
    assert "0.3999(33)" in page and "_error" not in page
    links = re.findall(r'(?:href|src)="(?!data:)([^"]+)"', page)
    assert len(links) > 14 and all((tmp_path / unquote(link)).exists() for link in links)
    assert all(not link.startswith("/") and "=" not in link for link in links)
    assert page.count("<td>2.5</td>") == 1 and "max_bounces = 1" in page and "size = 16 12" in page
    remove_tables(tmp_path)
    assert not (tmp_path / "index.html").exists()
    assert json.loads(next((tmp_path / "records").glob("*.json")).read_text())


def test_fits_are_plotted_with_their_truths_and_against_each_axis(jobs_of, monkeypatch, tmp_path):
    drawn = []
    real = plots._points
    monkeypatch.setattr(plots, "_points", lambda ax, *columns: drawn.append((ax, *columns)) or real(ax, *columns))
    truths = (0.3, 0.4, 0.5)
    jobs = jobs_of("[grid]\ncyan.alpha = [0.3, 0.4, 0.5]\n" + QUICK_FIT.replace("[0.01]", "[0.01, 0.02]"))
    for number, job in enumerate(jobs):
        truth = job.values["cyan.alpha"]
        numbers = {"fit.status": "converged" if number else "not_converged", "fit.cyan.alpha": truth + 0.01}
        numbers |= {"fit.cyan.alpha.total_error": 0.02 if number else None, "fit.cyan.alpha.standard_error": 0.01}
        finish(tmp_path, job, f"fit/{file_name(job)}/result.png", **numbers, **{"fit.cyan.alpha.truth": truth})
    write_overview(jobs, tmp_path)
    page = (tmp_path / "index.html").read_text()
    words = re.findall(r'alt="([^"]* against [^"]*)"', page)
    ends = ["against their truths", "of cyan.alpha against cyan.alpha", "of cyan.alpha against noise"]
    assert [text.endswith(end) for text, end in zip(words, ends, strict=True)] == [True] * 3
    (ax, x, y, errors, came_to_rest), (_, _, misses, *_), (_, noise, *_) = drawn
    assert sorted(set(x)) == list(truths) and y == pytest.approx(x + 0.01) and misses == pytest.approx(0.01)
    assert list(came_to_rest) == [False] + [True] * 5 and list(errors[1:]) == [0.02] * 5
    assert sorted(set(noise)) == [0.01, 0.02] and ax.get_xlabel() == "cyan.alpha: truth"
    row = make_table(jobs, tmp_path)[0]
    assert (row["settings.size"], row["settings.edges"], row["seconds"]) == ("16 12", "point", 0.0)
