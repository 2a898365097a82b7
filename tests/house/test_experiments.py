"""The scripts of `experiments/` still run: each at the smallest size that says anything, and slowly at that."""

import importlib
import importlib.util
import itertools
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"
PICTURES = ROOT / "tests" / "physical_pictures"

SMALL = "--scenes assignment --size 32 24"
RUNS = {
    "benchmarks/benchmark.py": ["--rows render --rounds 1"],
    "benchmarks/breakdown.py": ["cache 64 1"],
    "benchmarks/compare.py": ["HEAD --rows render --rounds 1"],
    "benchmarks/fresh.py": ["render 64 cache"],
    "benchmarks/growing.py": ["bounces 1 2"],
    "benchmarks/growth.py": ["-o growth.png --series bounces --devices 1 --count 2"],
    "benchmarks/on_gpu.py": ["on_gpu.json 'numbers, float64'"],
    "benchmarks/throughput.py": ["cache 1 3"],
    "benchmarks/warm.py": ["cache 1 render:64"],
    "calibration/calibration.py": ["run 'white noise' --fits 1 --results calibration.jsonl"],
    "camera/fits.py": [f"'{PICTURES}' photographed_ball --cases 'camera fixed' --binning 4 --output ."],
    "edge_gradients/edge_gradients.py": ["--cases 'two balls' --samples 1 --size 16 12 --reference references"],
    "edge_gradients/figure.py": ["-o edges.png"],
    "edge_gradients/random_sizes.py": ["--sizes 1 --sides 8 12 --reference references"],
    "estimates/basin.py": ["assignment --starts 1 --size 32 24"],
    "estimates/controls.py": ["'assignment, points' --targets 1"],
    "estimates/honesty.py": ["--only 'of another size' 'free radius' --size 32 24 --targets 1"],
    "estimates/mismatch.py": ["--only 'radius +0.01 %, points without noise' --size 32 24"],
    "estimates/noise.py": ["--targets 2 --size 32 24 --sampling point --outliers 0"],
    "estimates/other_programs.py": ['--kinds OpenEXR --starts "the scene\'s" --crop 300 120 48 36'],
    "estimates/scenes/make_pebbles.py": ["pebbles.txt"],
    "photograph/lenses.py": [". --lenses 1"],
    "photograph/places.py": ["."],
    "physical/fuzz.py": ["--scenes 1 --edges point"],
    "physical/independent.py": ["regular --results independent.json"],
    "physical/make_sky.py": ["sky.exr"],
    "real/tank.py": [""],
    "suite/counts.py": [""],
    "suite/mutations.py": ["--only gamma_chunk -o mutations"],
    "suite/pieces.py": ["slow --only chunks -o pieces"],
    "tuning/tuning.py": [
        "pictures --scenes assignment --size 16 12 --rows 1",
        *(f"{part} {SMALL} --count 1 --rows 1" for part in ("search", "point")),
        "box --scenes assignment --size 16 12 --count 1 --rows 1",
        f"limits curvature bounds {SMALL} --rows 1",
        *(f"{part} {SMALL} --rows 1" for part in ("corners", "judge")),
    ],
}
"""By script the command lines of its smallest runs; several where it has parts that have little in common."""

MADE = ("edges.png", "growth.png", "on_gpu.json", "fits.json", "pebbles.txt", "sky.exr")
MADE += ("mutations/mutations.json", "pieces/slow.json")
"""Files that scripts are asked for; the others print what they find."""

NEEDS_OTHER_PROGRAMS = {
    "camera/pictures.py": "povray",
    "photograph/colours.py": "povray",
    "photograph/lab.py": "povray",
    "photograph/light.py": "povray",
    "photograph/rooms.py": "povray",
    "photograph/tank_lab.py": "povray",
    "photograph/tanks.py": "povray",
    "physical/beside_mitsuba.py": "mitsuba",
    "physical/fits.py": "povray",
    "physical/last_word.py": "povray",
    "physical/render_blender.py": "blender",
    "physical/render_mitsuba.py": "mitsuba",
    "physical/render_pov_ray.py": "povray",
}
"""Scripts that do nothing without a program that is not installed here; pyright sees whether they know the package."""

ROW = re.compile(r"\| *[^ |-].*\|")


def findings(printed: str) -> list[str]:
    """The rows of tables below their heads, the JSON lines and the counts that were printed."""
    lines = printed.splitlines()
    heads = {line for line, below in itertools.pairwise(lines) if below.startswith("|--")}
    rows = [line for line in lines if ROW.fullmatch(line) and line not in heads]
    return rows + [line for line in lines if line.startswith("{") or re.search(r"\d+ of \d+ right", line)]


ONE_BY_ONE = [
    pytest.param(script, line, id=script + (f" {line.split()[0]}" if len(lines) > 1 else ""))
    for script, lines in RUNS.items()
    for line in lines
]


@pytest.mark.slow
@pytest.mark.parametrize(("script", "line"), ONE_BY_ONE)
def test_a_script_runs_and_finds_something(script, line, tmp_path):
    arguments = shlex.split(line)
    ended = subprocess.run(
        [sys.executable, EXPERIMENTS / script, *arguments],
        # Programs that run for a moment are not worth much compiling.
        env={**os.environ, "PYTHONPATH": str(ROOT), "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert ended.returncode == 0, ended.stderr[-4000:]
    made = [name for name in MADE if (tmp_path / name).exists() and (tmp_path / name).stat().st_size > 0]
    assert made or findings(ended.stdout), ended.stdout + ended.stderr[-4000:]


def test_every_script_is_run_or_excused():
    has_main = re.compile(r'^if __name__ == "__main__":', re.MULTILINE)
    scripts = {path for path in EXPERIMENTS.rglob("*.py") if has_main.search(path.read_text())}
    names = {path.relative_to(EXPERIMENTS).as_posix() for path in scripts}
    # What stores the notebooks is run by their own tests.
    assert names == {*RUNS, *NEEDS_OTHER_PROGRAMS, "teaching/store.py"} and not {*RUNS} & {*NEEDS_OTHER_PROGRAMS}


def test_tuned_numbers_are_in_the_package():
    """Tables name them as `module:NAME`, which no type checker sees."""
    lost, count = [], 0
    for path in (EXPERIMENTS / "tuning").glob("*.py"):
        text = path.read_text()
        rooms = dict(re.findall(r'^([A-Z]+) = "((?:inverse|tracer)[a-z_.]*)"', text, re.MULTILINE))
        for name, room in rooms.items():
            text = text.replace(f"{{{name}}}", room)
        addresses = re.findall(r'"([a-z_.]+):([A-Za-z_.]+)"', text)
        count += len(addresses)
        lost += [f"{path.name}: {module}:{name}" for module, name in addresses if not is_there(module, name, rooms)]
    assert not lost and count >= 15


def is_there(module: str, name: str, rooms: dict[str, str]) -> bool:
    """Whether a module of the package, or of one of these rooms in it, has a number."""
    for room in ("", *(f"{room}." for room in rooms.values())):
        try:
            found = importlib.import_module(f"raytrace_jax.{room}{module}")
            for part in name.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError):
            continue
        return True
    return False


def test_mutated_texts_are_in_the_package():
    spec = importlib.util.spec_from_file_location("mutations", EXPERIMENTS / "suite" / "mutations.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name, place in module.MUTATIONS.items():
        assert place.old in (ROOT / "raytrace_jax" / place.file).read_text(), name
        for test in place.tests.split():
            assert list(ROOT.glob(f"tests/*/test_{test}.py")), name
