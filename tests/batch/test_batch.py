"""The command `batch` in this process: its files and table, failures, what is run again, and that it compiles once."""

import csv
import dataclasses
import io
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from batch_plans import HEAD, QUICK_FIT, TWO_VIEWS
from command_line import run
from fake_fit import fake_result, full_result
from rich.console import Console
from scenes import DATA, assignment_scene

from raytrace_jax import (
    RenderSettings,
    format_scene,
    load_scene,
    picture_derivatives,
    read_exr,
    read_picture,
    render,
    set_parameters,
)
from raytrace_jax.batch.run import JobRecord, run_job
from raytrace_jax.cli.actions.batch import BatchProgress
from raytrace_jax.images.exr import write_exr
from raytrace_jax.report.films import how_made
from raytrace_jax.tracer.settings import resolve_settings

SETTINGS = RenderSettings(size=(16, 12), max_bounces=1)
FIT = QUICK_FIT + "start.cyan.alpha = 0.45\n"


@pytest.fixture
def batch(tmp_path, capsys):
    """Run a plan's text: exit code, rows of the table, stdout and stderr."""

    def run_plan(text, *more, head=HEAD):
        (tmp_path / "plan.toml").write_text(head + text)
        code = run("batch", str(tmp_path / "plan.toml"), "-o", str(tmp_path / "out"), *more)
        captured = capsys.readouterr()
        table = tmp_path / "out" / "results.csv"
        rows = list(csv.DictReader(table.read_text().splitlines())) if table.exists() else None
        return code, rows, captured.out, captured.err

    return run_plan


@pytest.fixture
def replace(monkeypatch):
    """Let a batch do something else: `replace("fit", function)`, by the name within `batch.run`."""
    return lambda name, function: monkeypatch.setattr(f"raytrace_jax.batch.run.{name}", function)


@pytest.mark.slow
def test_a_batch_gives_the_librarys_results(batch, tmp_path):
    out = tmp_path / "out"
    grid = "[grid]\nvitreous.ior = [1.2, 1.6]\n"
    code, rows, printed, shown = batch(grid + "[render]\n[gradient]\nwrt = ['cyan.ior']\nedges = 'point'\n" + FIT)
    assert code == 0
    names = ("results.csv", "index.html")
    assert printed.split() == [str(out / name) for name in names]
    assert shown.splitlines()[0] == "6 jobs"
    assert [row["kind"] for row in rows] == ["render"] * 2 + ["gradient"] * 2 + ["fit"] * 2
    assert [row["vitreous.ior"] for row in rows] == ["1.2", "1.6"] * 3
    assert {row["status"] for row in rows} == {"done"}

    scene = set_parameters(assignment_scene(), {"vitreous.ior": 1.6})
    image = np.asarray(render(scene, SETTINGS).image)
    _, picture, _, layers, _, estimate = rows
    np.testing.assert_array_equal(read_picture(out / picture["file"]), image.astype(np.float32))
    assert (out / picture["file"]).with_suffix(".png").exists()
    assert float(picture["mean.g"]) == pytest.approx(image[1].mean(), rel=1e-12)
    assert read_exr(out / picture["file"]).metadata["scene"] == format_scene(scene)

    found = picture_derivatives(scene, ["cyan.ior"], dataclasses.replace(SETTINGS, edges="point"))
    channels = read_exr(out / layers["file"]).channels
    np.testing.assert_array_equal(channels["d.cyan.ior.R"], found.values[0, 0].astype(np.float32))
    assert float(layers["mean.d.cyan.ior"]) == pytest.approx(float(found.values.mean()), rel=1e-12)

    # The fit began at 0.45 and at the scene's own index, and finds neither the index nor that it differs.
    summary = json.loads((out / estimate["file"]).read_text())
    assert summary["parameters"]["cyan.alpha"]["initial"] == 0.45
    assert float(estimate["fit.cyan.alpha"]) == summary["parameters"]["cyan.alpha"]["value"]
    assert estimate["fit.status"] == summary["status"]
    fitted = load_scene((out / estimate["file"]).with_name("fit.txt"))
    assert float(fitted.materials.ior[3]) == 1.337
    assert float(fitted.materials.alpha[3]) == summary["parameters"]["cyan.alpha"]["value"]
    assert (estimate["noise"], estimate["seed"], estimate["target"]) == ("0.01", "0", "")


@pytest.mark.slow
def test_each_camera_has_its_pictures_and_a_fit_takes_all(batch, tmp_path):
    out, asked = tmp_path / "out", "[render]\n[gradient]\nwrt = ['glass.ior']\nedges = 'point'\n"
    fit = QUICK_FIT.replace("cyan.alpha", "glass.ior") + "start.glass.ior = 1.49\n"
    code, rows, *_ = batch(asked + fit, head=TWO_VIEWS)
    assert code == 0
    picture, derivative, estimate = rows
    scene, settings = load_scene(DATA / "two_views.txt"), RenderSettings(size=(32, 24), max_bounces=3)
    for camera in ("left", "right"):
        image = np.asarray(render(scene.seen_by(camera), settings).image)
        [path] = (out / "render").glob(f"two_views_{picture['job'][:8]}_{camera}.exr")
        np.testing.assert_array_equal(read_picture(path), image.astype(np.float32))
        assert path.with_suffix(".png").exists()
        assert float(picture[f"mean.{camera}.g"]) == pytest.approx(image[1].mean(), rel=1e-12)
        [path] = (out / "gradient").glob(f"*_{camera}.exr")
        layer = read_exr(path).channels["d.glass.ior.G"]
        assert np.isfinite(float(derivative[f"mean.{camera}.d.glass.ior"])) and layer.any()
        assert 0 < float(estimate[f"fit.rms_residual.{camera}"]) < 0.02
    error = float(estimate["fit.glass.ior.total_error"])
    assert abs(float(estimate["fit.glass.ior"]) - float(estimate["fit.glass.ior.truth"])) < 4 * error < 0.1
    page = (out / "index.html").read_text()
    assert page.count(' loading="lazy"') == 2 and ">left.exr</a>" in page and ">right.png</a>" in page
    assert "<th>mean.right.r</th>" in page


def test_files_of_two_views_are_read_with_what_both_say(batch, tmp_path, replace):
    scene, given = load_scene(DATA / "two_views.txt"), {}

    def fit(scene, target, *_, options, **__):
        given.update(target=target, options=options)
        return fake_result()

    replace("fit", fit)
    for name, samples in (("left", 2), ("right", 2), ("other", 3)):
        settings = resolve_settings(scene, RenderSettings(size=(32, 24), samples=samples))
        image = np.full((3, 24, 32), 0.5)
        write_exr(tmp_path / f"{name}.exr", dict(zip("RGB", image, strict=True)), metadata=how_made(scene, settings))
    plan = "[fit]\nfree = ['glass.ior']\nnoise = [0.01]\ntargets = [{left = 'left.exr', right = 'NAME.exr'}]\n"
    assert batch(plan.replace("NAME", "right"), head=TWO_VIEWS)[0] == 0
    assert given["options"].target_samples == 2
    noises = [target - 0.5 for target in given["target"].values()]
    assert list(given["target"]) == ["left", "right"] and [noise.shape for noise in noises] == [(3, 24, 32)] * 2
    assert np.std(noises) == pytest.approx(0.01, rel=0.1) and np.abs(np.corrcoef(*map(np.ravel, noises))[0, 1]) < 0.1
    assert batch(plan.replace("NAME", "other"), head=TWO_VIEWS)[0] == 0
    assert given["options"].target_samples is None


def test_only_what_changed_is_run_again(batch, tmp_path, replace):
    ran = []

    def recording(job, folder):
        ran.append(job.values["vitreous.ior"])
        return run_job(job, folder)

    replace("run_job", recording)
    batch("[grid]\nvitreous.ior = [1.2, 1.6]\n[render]")
    assert ran == [1.2, 1.6]
    first = (tmp_path / "out" / "results.csv").read_bytes()
    code, _, _, shown = batch("[grid]\nvitreous.ior = [1.2, 1.6]\n[render]\n# a comment")
    assert (code, ran) == (0, [1.2, 1.6]) and "2 of them done already" in shown
    assert (tmp_path / "out" / "results.csv").read_bytes() == first

    _, rows, _, shown = batch("[grid]\nvitreous.ior = [1.4, 1.6]\n[render]")
    assert ran == [1.2, 1.6, 1.4] and "1 of the jobs here belong to other plans" in shown
    assert [row["vitreous.ior"] for row in rows] == ["1.4", "1.6"]

    # A picture that is gone is made again, and a record that is broken counts for nothing.
    (tmp_path / "out" / rows[0]["file"]).unlink()
    (tmp_path / "out" / "records" / f"{rows[1]['job']}.json").write_text("{")
    batch("[grid]\nvitreous.ior = [1.4, 1.6]\n[render]")
    assert ran[3:] == [1.4, 1.6]


def test_a_failed_job_is_tried_again(batch, tmp_path, replace):
    (tmp_path / "target.png").write_text("no picture")
    plan = "[render]\n[grid]\ncyan.ior = [1.5]\n" + FIT + "targets = ['target.png']"
    code, rows, _, shown = batch(plan)
    assert code == 1
    assert [row["status"] for row in rows] == ["done", "failed"]
    assert "target.png: is of an unknown format" in rows[1]["message"] and rows[1]["message"] in shown
    assert "warning: 1 of 2 jobs failed" in shown
    again = batch(plan)
    for row in (*rows, *again[1]):
        del row["seconds"]
    assert again[:2] == (code, rows) and "1 of them done already" in again[3]

    def fail(job, folder):
        raise ZeroDivisionError("over nothing\nand more")

    replace("run_job", fail)  # Nobody expected this error.
    code, [row], *_ = batch("[grid]\ncyan.ior = [1.6]\n[render]")
    assert (code, row["status"], row["message"]) == (1, "failed", "ZeroDivisionError: over nothing")
    code, *_, shown = batch("[grid]\nvitreous.iro = [1.2]\n[render]")  # A mistaken plan is wrong usage.
    assert code == 2 and "plan.toml:" in shown and "vitreous.iro" in shown


def test_ctrl_c_keeps_what_is_done(batch, tmp_path, replace):
    def interrupted(job, folder):
        if job.values["vitreous.ior"] == 1.6:
            raise KeyboardInterrupt
        return run_job(job, folder)

    replace("run_job", interrupted)
    code, rows, _, shown = batch("[grid]\nvitreous.ior = [1.2, 1.6]\n[render]")
    assert (code, rows) == (130, None) and "the same command goes on" in shown
    assert len(list((tmp_path / "out" / "records").glob("*.json"))) == 1


def test_a_stopped_fit_begins_anew(batch, tmp_path, replace):
    replace("fit", lambda *_, **__: fake_result(status="interrupted"))
    code, rows, *_ = batch(FIT)
    assert (code, rows) == (130, None)
    [kept] = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert kept.name == "plan.toml" and kept.read_bytes() == (tmp_path / "plan.toml").read_bytes()
    replace("fit", lambda *_, **__: fake_result(status="not_converged"))
    code, [row], *_ = batch(FIT)
    assert (code, row["status"], row["fit.status"]) == (0, "done", "not_converged")
    assert row["fit.vitreous.radius.standard_error"] == row["fit.vitreous.radius.total_error"] == ""  # Infinite.

    found = full_result()
    replace("fit", lambda *_, **__: found)
    [row] = batch("[set]\ncyan.ior = 1.5\n" + FIT)[1]
    assert row["fit.causes"] == "; ".join(cause.words for cause in found.check.causes) != ""
    errors = [float(row[f"fit.{found.names[0]}.{error}"]) for error in ("standard_error", "total_error")]
    assert errors == [found.standard_error[0], found.total_error[0]] and errors[0] < errors[1]


def test_the_time_that_is_left_is_told_by_kind_without_what_was_compiled():
    kinds = ["render"] * 21 + ["fit"] * 2
    jobs = [SimpleNamespace(kind=kind, name=kind, scene_name="a.txt") for kind in kinds]
    console = Console(file=io.StringIO(), soft_wrap=True)
    show = BatchProgress(jobs, 0, console)

    def ended(job, seconds, compiling=0.0):
        show.began -= seconds
        show.shown_at = -100
        show.done(job, JobRecord("done", seconds=seconds, compiling=compiling))

    ended(jobs[0], 70, 60)
    ended(jobs[1], 10)
    ended(jobs[21], 1200, 600)
    for job in [*jobs[2:21], jobs[22]]:
        ended(job, 10)
    said = console.file.getvalue().splitlines()
    assert said[:2] == [
        "1/23 jobs, about 3 min left, 2 fits not timed yet",
        "2/23 jobs, about 3 min left, 2 fits not timed yet",
    ]
    assert said[2] == "3/23 jobs, about 13 min left"  # 19 pictures of 10 s, and a fit of 600.
    assert said[-1] == "23/23 jobs"


def test_a_second_scene_is_compiled_too():
    jobs = [SimpleNamespace(kind="render", name="render", scene_name=scene) for scene in "aaab"]
    show = BatchProgress(jobs, 0, Console(file=io.StringIO(), soft_wrap=True))
    show.began -= 70
    show.shown_at = -100
    show.done(jobs[0], JobRecord("done", seconds=70, compiling=60))
    assert show.console.file.getvalue() == "1/4 jobs, about 2 min left\n"


def test_a_batch_says_nothing_but_its_counts(monkeypatch):
    monkeypatch.setattr("raytrace_jax.cli.progress.SILENCE", 0.0)
    console = Console(file=io.StringIO(), soft_wrap=True)
    with BatchProgress([SimpleNamespace(kind="fit", name="fit", scene_name="a")], 0, console) as show:
        show.over.wait(1.5)
    assert console.file.getvalue().splitlines() == ["1 jobs", "0/1 jobs in 2 s, ready"]


def test_json_tells_files_and_rows(batch, tmp_path):
    code, rows, printed, _ = batch("[render]", "--json")
    told = json.loads(printed)
    assert code == 0 and told["files"][0] == str(tmp_path / "out" / "results.csv")
    assert [job["job"] for job in told["jobs"]] == [row["job"] for row in rows]


@pytest.mark.parametrize(
    ("code", "more", "words"),
    [
        (2, ["--workers", "0"], ["--workers is 0", "1 or more"]),
        (2, ["--workers", "1", "--scheduler", "tcp://x:1"], ["exclude each other"]),
        (1, ["--workers", "1"], ["need dask.distributed", "pip install 'distributed>="]),
        (1, ["-o", "plan.toml/x"], ["plan.toml is not a folder"]),
    ],
)
def test_bad_options_are_one_message(code, more, words, batch, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)  # As if it were not installed.
    monkeypatch.chdir(tmp_path)
    found, rows, printed, shown = batch("[render]", *more)
    assert (found, rows, printed) == (code, None, "")
    assert shown.startswith("error: ") and shown.count("\n") == 1 and all(word in shown for word in words)
