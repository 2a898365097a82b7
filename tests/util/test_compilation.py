"""Programs are compiled once for each kind of arguments, by one of several threads, and found by the next process."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run
from compiles import counted_compiles, counted_traces
from user_loops import SCENE

from raytrace_jax.inverse.problem.problem import values_and_slopes
from raytrace_jax.inverse.problem.unknowns import Transform, Unknowns
from raytrace_jax.util.compilation import forget_programs, jit, keep_programs


def scaled(x, table, power):
    return {"sum": sum(table.values()) * x**power, "power": None}


def test_only_another_kind_is_recompiled():
    function = jit(scaled, static_argnames="power")
    table = {"one": jnp.asarray(2.0), "two": np.asarray(3.0)}
    with counted_compiles() as compiles:
        assert float(function(jnp.asarray(2.0), table, 2)["sum"]) == 20
        assert float(function(jnp.asarray(3.0), table=table, power=2)["sum"]) == 45
    assert compiles.count("jit(scaled)") == 1
    with counted_compiles() as compiles:
        function(jnp.asarray(2.0), table, 3)
        function(jnp.asarray([2.0]), table, 3)
        function(jnp.asarray(2.0, jnp.float32), {"one": jnp.asarray(2.0, jnp.float32)}, 3)
    assert compiles.count("jit(scaled)") == 3


def test_of_two_threads_one_compiles():
    traced, both = [], threading.Barrier(2)

    def slow(x):
        traced.append(x.shape)
        return jnp.sin(x)

    function = jit(slow)

    def call(value):
        with jax.enable_x64(True):
            both.wait()
            return float(function(jnp.asarray(value)))

    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(call, (0.5, 1.0)))
    np.testing.assert_allclose(found, np.sin([0.5, 1.0]))
    assert len(traced) == 1


def test_a_failed_program_is_tried_again():
    fails = [True]

    def fragile(x):
        if fails:
            raise ValueError(fails.pop())
        return 2 * x

    function, one = jit(fragile), jnp.asarray(1.0)
    with pytest.raises(ValueError):
        function(one)
    assert float(function(one)) == 2


@pytest.fixture
def kept(tmp_path):
    """A folder in which programs are kept while a test runs."""
    keep_programs(tmp_path)
    yield tmp_path
    keep_programs(None)


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


Y = np.asarray([0.25])


def anew():
    """The results of a program that is not in memory."""
    forget_programs()
    return values_and_slopes(Y, Unknowns(("a.radius",), (Transform(0.0),)))


def test_a_broken_program_file_is_made_anew(kept):
    first = anew()
    (path,) = files(kept)
    assert path.name.startswith("values_and_slopes-")
    with counted_traces() as traces:
        again = anew()
    assert traces == ["values_and_slopes_exported"]
    np.testing.assert_array_equal(again, first)
    for content in (b"", b"no program", path.read_bytes()[:-100]):
        path.write_bytes(content)
        np.testing.assert_array_equal(anew(), first)
        assert path.stat().st_size > 1000


def test_least_recent_programs_are_deleted(kept, monkeypatch):
    old = kept / "programs" / "of-another-version" / "linearize-0"
    old.parent.mkdir(parents=True)
    for most, left in ((0, 0), (1_000_000, 2)):
        monkeypatch.setattr("raytrace_jax.util.compilation.MOST_BYTES", most)
        old.write_bytes(b"old")
        anew()
        assert len(files(kept)) == left


def test_a_closure_is_not_kept(kept):
    offset = 2.0

    def closure(x):
        return x + offset

    assert float(jit(closure)(jnp.asarray(1.0))) == 3
    assert not files(kept)


SECOND_PROCESS = """
import sys
sys.path.insert(0, sys.argv[1])
from command_line import run
from compiles import counted_traces
with counted_traces() as traces:
    code = run(*sys.argv[2:])
heavy = {"differentiate_batches", "linearize", "color_batches", "moved_scene"}
heavy |= {"moved_scenes", "values_and_slopes"}
print(code, sorted(heavy & set(traces)))
"""


@pytest.mark.slow
def test_a_second_process_traces_no_programs(tmp_path):
    """Its programs run in a process that never lowered any, LAPACK's QR among them, and say the same."""
    common = ["--size", "24", "18", "--max-bounces", "1", "--quiet"]
    scene, target = str(tmp_path / "scene.txt"), str(tmp_path / "target.exr")
    Path(scene).write_text(SCENE)
    fit = ["fit", scene, target, "--free", "glass.ior", "--no-search", *common]
    fit += ["--edges", "point", "--target-sampling", "point"]
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}

    def run_anew(*arguments):
        command = [sys.executable, "-c", SECOND_PROCESS, str(Path(__file__).parents[1]), *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.splitlines()[-1]

    assert run("render", scene, "-D", "glass.ior=1.42", "-o", target, *common) == 0
    assert run_anew(*fit, "-o", str(tmp_path / "first")).startswith("0 ['color_batches', 'differentiate_batches'")
    assert run_anew(*fit, "-o", str(tmp_path / "second")) == "0 []"
    results = [(tmp_path / name / "fit.txt").read_text() for name in ("first", "second")]
    assert results[0] == results[1]
