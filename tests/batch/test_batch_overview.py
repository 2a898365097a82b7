"""What people see of a batch: the names of its files, the contact sheet and the page, without tracing a ray."""

import dataclasses
import itertools
import json
import re
from urllib.parse import unquote

import numpy as np
import pytest
from batch_plans import HEAD, QUICK_FIT
from PIL import Image

from raytrace_jax import write_png
from raytrace_jax.batch.jobs import expand, file_name, labelled
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.run import JobRecord, write_record
from raytrace_jax.batch.table import remove_tables, write_overview
from raytrace_jax.report.contact_sheet import GAP, LARGEST, LabelledPicture, draw_contact_sheet, layout

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
    assert [path.name for path in write_overview([*renders, fit], tmp_path)] == ["contact.png", "index.html"]
    page = (tmp_path / "index.html").read_text()
    assert page.count("<tr><td>") == 7 and "1 failed" in page and "&lt;no&gt; light" in page
    assert "0.3999(33)" in page and "_error" not in page
    links = re.findall(r'(?:href|src)="([^"]+)"', page.replace('href="data:,"', ""))
    assert len(links) > 14 and all((tmp_path / unquote(link)).exists() for link in links)
    assert all(not link.startswith("/") and "=" not in link for link in links)
    write_overview([fit], tmp_path)
    assert not (tmp_path / "contact.png").exists()
    remove_tables(tmp_path)
    assert not (tmp_path / "index.html").exists()
    assert json.loads(next((tmp_path / "records").glob("*.json")).read_text())


def test_the_sheet_has_one_cell_a_picture(tmp_path):
    Image.new("RGB", (16, 12), "red").save(tmp_path / "red.png")
    (tmp_path / "broken.png").write_text("no picture")
    cells = [LabelledPicture(tmp_path / "red.png", ["ior = 1.2"])] * 3
    cells += [LabelledPicture(None, ["failed"]), LabelledPicture(tmp_path / "broken.png", [])]
    sheet, plan = draw_contact_sheet(cells), layout(5, (16, 12), 1)
    right, down = plan.pitch
    assert sheet.size == (3 * right + GAP, 2 * down + GAP)
    middles = [(GAP + x * right + 80, GAP + y * down + 60) for y in range(2) for x in range(3)]
    red, grey, white = (255, 0, 0), (208, 208, 208), (255, 255, 255)
    assert [sheet.getpixel(middle) for middle in middles] == [red, red, red, grey, grey, white]
    for count, size in itertools.product((1, 7, 300, 2000, 10_000), ((16, 12), (4000, 3000), (30, 3000))):
        plan = layout(count, size, 9)
        assert plan.columns * plan.rows >= count
        assert plan.columns * plan.pitch[0] <= LARGEST and plan.rows * plan.pitch[1] <= 2.2 * LARGEST
    # It shows light as a screen does.
    write_png(tmp_path / "grey.png", np.full((3, 30, 40), 0.5))
    sheet = draw_contact_sheet([LabelledPicture(tmp_path / "grey.png", ["grey"])])
    assert sheet.getpixel((sheet.width // 2, GAP + 20)) == (188, 188, 188)


def test_sheet_rows_are_grid_rows(jobs_of, tmp_path):
    assert [layout(24, (16, 12), 1, group).columns for group in (4, 6, 2, 1, 24)] == [4, 6, 4, 5, 5]
    jobs = jobs_of(
        "[grid]\nvitreous.ior = [1.1, 1.2, 1.3]\ncyan.alpha = { start = 0, stop = 0.8, count = 8 }\n[render]\n"
    )
    for job in jobs:
        finish(tmp_path, job, f"render/{file_name(job)}.png")
    write_overview(jobs, tmp_path)
    with Image.open(tmp_path / "contact.png") as sheet:
        right, down = layout(24, (16, 12), 2, 8).pitch
        assert sheet.size == (8 * right + GAP, 3 * down + GAP)
