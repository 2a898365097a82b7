"""The command `fit`: how it reads ties and priors, shows progress, and what it writes."""

import contextlib
import io
import json
import os
import pty
import re
import subprocess
import sys
import termios
import time
import types

import numpy as np
import pytest
from command_line import run
from fake_fit import VITREOUS, changed, fake_result
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from rich.console import Console

from raytrace_jax import read_picture, write_png
from raytrace_jax.cli import progress
from raytrace_jax.cli.console import UsageError
from raytrace_jax.cli.options.fits import Fit, read_prior
from raytrace_jax.cli.progress import SECONDS_BETWEEN, FitProgress, Timer
from raytrace_jax.images.transfer import ENCODERS
from raytrace_jax.inverse.result import FitResult

TARGET = np.random.default_rng(0).uniform(size=(3, 30, 40))


def options_of(**texts):
    return Fit(scene=VITREOUS, target=(str(VITREOUS),), free=(), output=VITREOUS, **texts).fit_options()


def test_ties_and_priors_are_read():
    ties = options_of(tie=("cyan.ior=vitreous.ior", "odd=name.ior=ball.ior")).ties
    assert ties == {"cyan.ior": "vitreous.ior", "odd=name.ior": "ball.ior"}
    texts = ("ball.radius=2.3±0.01", " ball.ior = 2.3 +- 0.01 ", "ball.center.z=-1e-3 ± 2E+1")
    priors = {"ball.radius": (2.3, 0.01), "ball.ior": (2.3, 0.01), "ball.center.z": (-1e-3, 20.0)}
    assert options_of(prior=texts).priors == priors


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(0, allow_infinity=False), st.sampled_from("±+"))
def test_a_priors_numbers_keep_every_bit(mean, deviation, sign):
    assert read_prior(f"{mean!r}{sign.replace('+', '+-')}{deviation!r}") == (mean, deviation)


def test_what_is_no_assignment_is_refused():
    forms = {
        "tie": ("NAME=FREE, as cyan.ior=vitreous.ior", ["", "=", "a.ior=", "=b.ior"]),
        "prior": (
            "NAME=MEAN+-SD, as vitreous.radius=2.3+-0.01",
            ["x", "a.ior", "a.ior=1", "a.ior=1+-", "a.ior=+-1", "=1+-2", "1+-2"],
        ),
    }
    for option, (form, texts) in forms.items():
        for text in (*texts, *(f"{text} " for text in texts)):
            with pytest.raises(UsageError) as caught:
                options_of(**{option: (text,)})
            assert str(caught.value) == f"--{option} {text}: write {form}."


@pytest.fixture
def clock(monkeypatch):
    now = types.SimpleNamespace(time=1000.0)
    monkeypatch.setattr("raytrace_jax.cli.progress.time", types.SimpleNamespace(monotonic=lambda: now.time))
    return now


def shown(work, **console):
    text = io.StringIO()
    result = fake_result()
    with FitProgress(result.names, Console(file=text, width=200, **console)) as progress:
        work(progress, result)
    return text.getvalue()


def test_without_a_terminal_steps_are_lines(clock):
    def work(progress, result):
        progress.phase("scanning: compiling")
        clock.time += 2.25
        for pictures in range(50, 1050, 50):  # One a second.
            progress.phase(f"scanning, {pictures} pictures")
            clock.time += 1
        progress.phase("solving from start 1")
        for step in result.steps[-2:]:
            progress.step(step)

    every = int(SECONDS_BETWEEN) + 1  # Phases of a kind are lines now and then.
    assert shown(work).splitlines() == [
        "0.0 s  scanning: compiling",
        *(f"{2.25 + second:.1f} s  scanning, {50 + 50 * second} pictures" for second in range(0, 20, every)),
        "22.2 s  solving from start 1",
        "22.2 s  start 1  blur 0 px  step 0  cost 0.5  vitreous.ior 1.391333  vitreous.radius 2.2",
        "22.2 s  start 1  blur 0 px  step 1 (rejected)  cost 0.6  vitreous.ior 1.337  vitreous.radius 2.3",
    ]


def everything(progress, result):
    progress.phase("scanning: compiling")
    for step in result.steps:
        progress.step(step)
    progress.phase("writing the report")


FIT_ON_A_TERMINAL = """
import sys
from raytrace_jax.cli.console import print_warning, stderr_console
from raytrace_jax.cli.progress import FitProgress
from raytrace_jax.inverse.result import FitStep

names = ("a_long_name_of_glass.ior", "a_long_name_of_glass.center.x")
with FitProgress(names, stderr_console(), verbose="--verbose" in sys.argv) as progress:
    progress.phase("solving from start 1")
    for number in range(100):
        progress.step(FitStep(0, 0, 0.0, number, 0.5, True, (1.3 + number / 1000, 0.0), 0.0))
        if number == 50:
            print_warning("one pixel is not finite")
    progress.phase("checking the model")
"""


def on_a_terminal(*arguments, columns=60):
    """What a process of its own writes on a terminal of so many columns."""
    outer, inner = pty.openpty()
    termios.tcsetwinsize(inner, (24, columns))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
    command = [sys.executable, "-c", FIT_ON_A_TERMINAL, *arguments]
    process = subprocess.Popen(command, stdin=inner, stdout=inner, stderr=inner, env=environment | {"TERM": "xterm"})
    os.close(inner)
    pieces = []
    with contextlib.suppress(OSError):  # The terminal ends with its process.
        while piece := os.read(outer, 4096):
            pieces.append(piece)
    os.close(outer)
    assert process.wait() == 0
    return b"".join(pieces).decode()


def test_a_terminal_shows_one_line_that_is_overwritten():
    text = on_a_terminal()
    *lines, after = text.split("\r\n")
    assert len(lines) == 2 and "\x1b[?25h" in after  # The cursor is shown again, on a line of its own.
    rows = re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9?;]*[a-zA-Z]", "", text))
    assert max(map(len, rows)) == 60 and "warning: one pixel is not finite" in rows
    assert re.fullmatch(r"[0-9.]+ s  checking the model  a_long_name_of_glass.ior 1.399  …", rows[-2])


def test_a_terminal_shows_all_lines_when_verbose():
    lines = on_a_terminal("--verbose").split("\r\n")
    assert [sum(f"  step {number}  " in line for line in lines) for number in range(100)] == [1] * 100
    assert not shown(everything, quiet=True) and not shown(everything, quiet=True, force_terminal=True)


def test_a_failed_fit_restores_the_terminal():
    text = io.StringIO()
    with pytest.raises(ZeroDivisionError), FitProgress(("a.ior",), Console(file=text, force_terminal=True)) as progress:
        progress.phase("scanning")
        raise ZeroDivisionError
    assert text.getvalue().rstrip("\n").endswith("\x1b[?25h")  # The cursor is shown again.


@pytest.fixture
def arguments(tmp_path):
    write_png(tmp_path / "target.png", TARGET)
    return ["fit", str(VITREOUS), str(tmp_path / "target.png"), "-o", str(tmp_path / "out"), "--size", "40", "30"]


FREE = ["--free", "vitreous.ior"]


@pytest.mark.parametrize("has_steps", [True, False])
def test_unfitted_numbers_have_no_error_bars(has_steps, arguments, replace_work, capsys, tmp_path):
    whole, unknown = fake_result("interrupted"), np.full(2, np.nan)
    stopped = changed(
        whole,
        uncertainty={"standard_error": unknown},
        image=None,
        start_image=None,
        steps=whole.steps if has_steps else (),
    )
    replace_work("fit.fit", lambda *_, **__: stopped)
    assert run(*arguments, *FREE) == 3
    lines = capsys.readouterr().out.splitlines()
    table = ["# estimates", "parameter        initial  estimate", "vitreous.ior     1.5      1.337"]
    assert lines[: -3 if has_steps else -2] == (table if has_steps else [])
    assert lines[-2].startswith("interrupted: ")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"fit.txt", "result.json"}


def test_the_fitted_scene_keeps_comments(arguments, replace_work, tmp_path):
    replace_work("fit.fit", lambda *_, **__: fake_result())
    scene = tmp_path / "scene.txt"
    scene.write_text("# Measured on Monday.\n\n" + VITREOUS.read_text())
    assert run("fit", scene, *arguments[2:], *FREE, "--transfer", "course", "--pdf") == 0
    assert (tmp_path / "out" / "fit.txt").read_text().startswith("# Measured on Monday.\n")
    assert (tmp_path / "out" / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_no_report_leaves_what_a_script_reads(arguments, replace_work, tmp_path):
    replace_work("fit.fit", lambda *_, **__: fake_result())
    assert run(*arguments, *FREE) == 0
    assert run(*arguments, *FREE, "--no-report") == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"fit.txt", "result.json", "result.npz"}
    assert FitResult.load(tmp_path / "out")["vitreous.ior"].value == 1.337


@pytest.mark.skipif(sys.platform == "win32", reason="files there have no limit of their size")
def test_estimates_are_printed_without_files(arguments, replace_work, capsys, tmp_path):
    import resource

    replace_work("fit.fit", lambda *_, **__: fake_result())
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
    try:
        code = run(*arguments, *FREE)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    captured = capsys.readouterr()
    assert code == 1 and "vitreous.ior     1.5      1.33700(23)" in captured.out
    [error] = captured.err.splitlines()
    assert "fit.txt: cannot be written: " in error
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("exposure", [[], ["--fit-exposure"]])
@pytest.mark.parametrize("transfer", ["course", "srgb"])
@pytest.mark.parametrize("told", [None, "course"])
def test_an_unmarked_png_is_read_as_nearest(
    transfer, told, exposure, arguments, monkeypatch, replace_work, capsys, tmp_path
):
    truth = np.random.default_rng(3).uniform(0.05, 0.6, size=(3, 30, 40))
    pixels = np.moveaxis(ENCODERS[transfer](truth * (1.3 if exposure else 1)), 0, -1)
    Image.fromarray(pixels).save(tmp_path / "target.png")
    seen = []
    replace_work("fit.fit", lambda *_, target, **__: seen.extend(target.values()) or fake_result())
    start = truth + np.random.default_rng(4).normal(scale=0.02, size=truth.shape)
    monkeypatch.setattr("raytrace_jax.cli.actions.fit.supersampled", lambda problem, y, samples: start)
    assert run(*arguments, *FREE, *exposure, *(["--transfer", told] if told else [])) == 0
    np.testing.assert_array_equal(seen[0], read_picture(tmp_path / "target.png", transfer=told or transfer))
    words = f"target.png does not say how its colours were stored: read with --transfer {transfer}, "
    assert (words in capsys.readouterr().err) == (told is None)


def test_silent_work_is_said_to_go_on(monkeypatch):
    monkeypatch.setattr(progress, "SILENCE", 0.0)
    text = io.StringIO()
    with Timer("drawing", Console(file=text)):
        time.sleep(1.5)
    assert re.fullmatch(r"(\d+\.\d s  drawing\n)+", text.getvalue())


@pytest.mark.slow
def test_two_views_are_fitted_and_reported(tmp_path, monkeypatch, capsys):
    """Each picture in a size of its own, and one of them masked."""
    monkeypatch.chdir(tmp_path)
    values = ["-D", "glass.ior=1.52", "-D", "glass.center=0.05,0.02,-0.03"]
    for camera, size in (("left", (48, 36)), ("right", (64, 48))):
        assert run("render", "two_views", "--camera", camera, "--size", *size, *values, "-o", f"{camera}.exr") == 0
    write_png("mask.png", np.ones((3, 36, 48)))
    targets = ["left=left.exr", "right=right.exr", "--mask", "left=mask.png"]
    code = run("fit", "two_views", *targets, "--free", "glass.ior", "glass.center", "--no-search", "-o", "out")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"fit_left.exr", "residual_right.exr", "report.png", "report.html", "methods.txt", "fit.txt"} <= written
    result = FitResult.load("out")
    assert code == 0 and result.status == "converged", result.message
    assert result.views["left"].image.shape == (3, 36, 48) and result.views["right"].image.shape == (3, 48, 64)
    np.testing.assert_allclose(result.value, [1.52, 0.05, 0.02, -0.03], atol=1e-4)
    summary = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [view["camera"] for view in summary["views"]] == ["left", "right"]
    assert summary["provenance"]["target"] == "left.exr, right.exr"
