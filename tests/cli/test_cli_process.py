"""The command line as a process of its own, and what the package's front has to do with how fast it starts."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import raytrace_jax
from raytrace_jax import render, write_png

ROOT = Path(__file__).parents[2]
VITREOUS = ROOT / "data" / "vitreous.txt"


# What this process has been told about JAX must not reach another one.
ENVIRONMENT = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "XLA_"))}
ENVIRONMENT |= {"PYTHONPATH": str(ROOT)}
PROGRAM = [sys.executable, "-m", "raytrace_jax"]


def process(*arguments):
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=120)


def runs_without(modules, code):
    code = f"import sys; {code}; assert not {{*{modules}}} & {{*sys.modules}}"
    return subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, timeout=60).returncode == 0


@pytest.mark.slow
def test_reading_a_picture_ends_quietly(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((3, 4, 5)))
    ended = process("fit", VITREOUS, tmp_path / "a.png", "--free", "vitreous.ior", "-o", tmp_path / "out")
    assert ended.returncode == 1
    assert ended.stderr.startswith("error: the target is 5 x 4 pixels") and ended.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_cluster_signal_ends_a_fit_early(tmp_path):
    # The picture is the scene's: another one would be refused at once.
    picture = [*PROGRAM, "render", str(VITREOUS), "--size", "80", "60", "-o", str(tmp_path / "a.png"), "--quiet"]
    subprocess.run(picture, env=ENVIRONMENT, check=True, timeout=120)
    command = [*PROGRAM, "fit", str(VITREOUS), str(tmp_path / "a.png"), "--free", "vitreous.ior"]
    command += ["-o", str(tmp_path / "out"), "--size", "80", "60"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    fit = subprocess.Popen(command, env=ENVIRONMENT, **pipes)
    next(line for line in fit.stderr if "  start 1  " in line)  # The solver has begun.
    fit.send_signal(signal.SIGTERM)
    said, _ = fit.communicate(timeout=60)
    assert fit.returncode == 3 and "interrupted: interrupted by the user" in said
    assert json.loads((tmp_path / "out" / "result.json").read_text())["status"] == "interrupted"


def test_help_does_not_wait_for_jax():
    commands = {("--help",): 0, ("render", "none", "-o", "a.exr"): 1, ("batch", "none.toml", "-o", "a"): 1}
    code = "; ".join(f"assert main({list(command)}) == {expected}" for command, expected in commands.items())
    assert runs_without(["jax", "numpy"], f"from raytrace_jax.cli import main; {code}")
    assert runs_without(["jax"], "import raytrace_jax.inverse.options")
    assert runs_without(["jax", "numpy", "tyro"], "from raytrace_jax.cli import main; main(['render', '--version'])")


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end differently")
def test_help_into_a_closed_pipe_is_no_error():
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([*PROGRAM, "fit", "--help"], env=ENVIRONMENT, **pipes) as reader:
        reader.stdout.close()
        assert reader.wait(timeout=60) == 1
        assert reader.stderr.read() == b""


@pytest.mark.skipif(sys.platform == "win32", reason="a shell closes stdout")
def test_without_a_stdout_it_is_refused():
    command = ["sh", "-c", f"{sys.executable} -m raytrace_jax info {VITREOUS} >&-"]
    ended = subprocess.run(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert ended.stderr.startswith("error: stdout is closed, and results are printed there")


def test_a_process_exits_with_the_code():
    done = process("format", "none.txt")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "error: none.txt: there is no such file.\n"


def test_lazy_names_are_the_checkers_names():
    names = set(raytrace_jax.__all__) - {"__version__"}
    assert all(getattr(raytrace_jax, name).__name__.rpartition(".")[2] == name for name in names)
    assert raytrace_jax.render is render and {"fit", "optics", "build", "RenderSettings"} < names
    with pytest.raises(AttributeError, match="no_such_name"):
        raytrace_jax.no_such_name  # noqa: B018
