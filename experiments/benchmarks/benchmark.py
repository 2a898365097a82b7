"""Speed and memory of the renderer, its derivatives and the fit, beside a native program: one table in Markdown.

    python experiments/benchmarks/benchmark.py --native64 ./native_tracer --native32 ./native_tracer32

Every measurement runs in a process of its own; see README.md beside this file for what each row means.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import tyro
from rich.console import Console

HERE = Path(__file__).parent
DATA = HERE.parents[1] / "data"
YARDSTICKS = {
    "render": "native",
    "jacobian": "render",
    "gradient": "render",
    "scene_gradient": "render",
    "aware_render": "render",
    "aware_jacobian": "aware_render",
}
"""Our programs, and what each is compared with."""

THROUGHPUT = {
    "trace": "200 pictures of 320 x 240, traced alone",
    "render": "the same by `render` in a loop",
    "write": "the same, and EXR and PNG written",
    "batch": "the same by the batch, with records",
}
"""What `throughput.py` measures."""

Row = Literal[
    "render", "jacobian", "gradient", "scene_gradient", "aware_render", "aware_jacobian",
    "compile", "memory", "start", "fit", "breakdown", "throughput",
]  # fmt: skip
ROWS: tuple[Row, ...] = get_args(Row)


@dataclass(frozen=True)
class Options:
    """Measure the speed and memory of raytrace_jax; the table goes to stdout, what is being done to stderr."""

    native64: Path | None = None
    """A native program in double precision that prints lines `<ms> ms  <rays> rays`; called with `1 5 repeats`."""
    native32: Path | None = None
    """The same in single precision."""
    rows: tuple[Row, ...] = ROWS
    """What to measure."""
    rounds: int = 7
    """How many turns the warm programs take."""


class Table:
    """Rows of a Markdown table; printed as they come."""

    def __init__(self):
        print("| what | median | least | against |\n|---|---|---|---|", flush=True)

    def add(self, what: str, median: str, least: str = "", against: str = "") -> None:
        print(f"| {what} | {median} | {least} | {against} |", flush=True)


def main(options: Options) -> None:
    say = Console(stderr=True, highlight=False).print
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        for platform in platforms():
            cache = str(Path(folder) / platform)
            say(f"{platform}: compile and memory ...")
            cold_rows(table, options.rows, platform, cache)
            say(f"{platform}: warm programs in turns ...")
            warm_rows(table, options, platform, cache)
            if "breakdown" in options.rows and platform == "cpu":
                say("cpu: breakdown ...")
                breakdown_rows(table, cache, options.rounds)
            if "throughput" in options.rows and platform == "cpu":
                say("cpu: throughput ...")
                throughput_rows(table, cache, options.rounds)
        say("command line ...")
        command_rows(table, options.rows, Path(folder))


def platforms() -> list[str]:
    """The processors to measure on: the CPU, and a GPU if JAX has one."""
    code = "import jax; print(jax.default_backend())"
    default = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    return ["cpu"] if default == "cpu" else ["cpu", default]


def worker(platform: str, script: str, *arguments: object) -> dict:
    """What a script beside this file prints, run on a platform in a process of its own."""
    environment = {**os.environ, "JAX_PLATFORMS": "cuda,cpu" if platform == "gpu" else platform}
    command = [sys.executable, str(HERE / script), *map(str, arguments)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def cold_rows(table: Table, rows: tuple[Row, ...], platform: str, cache: str) -> None:
    """Compile times with an empty cache, and peak memory of processes that find their programs in it."""
    if not {"compile", "memory"} & set(rows):
        return
    for name in YARDSTICKS:
        first = worker(platform, "fresh.py", name, 64, cache)
        if "compile" in rows:
            table.add(f"{platform}: compile {name}, float64", f"{first['compile_s']:.1f} s")
        if "memory" in rows:
            again = worker(platform, "fresh.py", name, 64, cache)
            peak = f"{again['peak_mb']:.0f} MB"
            if again["device_peak_mb"]:
                peak += f", {again['device_peak_mb']:.0f} MB on the device"
            before = f"{again['before_mb']:.0f} MB before it"
            table.add(f"{platform}: peak memory of {name}, float64", peak, "", before)


def warm_rows(table: Table, options: Options, platform: str, cache: str) -> None:
    """Warm times of all programs, each beside its yardstick."""
    names = {name for name in YARDSTICKS if name in options.rows}
    if not names:
        return
    names |= {YARDSTICKS[name] for name in names} | {"render"}
    paths = {"64": options.native64, "32": options.native32}
    wanted = []
    for bits, path in paths.items():
        wanted += [f"native:{bits}={path.absolute()}"] if path else []
        wanted += [f"{name}:{bits}" for name in YARDSTICKS if name in names]
    found = worker(platform, "warm.py", cache, options.rounds, *wanted)
    turns = found["turns"]
    for key in turns[0]:
        name, bits = key.split(":")
        yardstick = YARDSTICKS.get(name)
        against = ""
        if f"{yardstick}:{bits}" in turns[0]:
            ratios = [statistics.median(turn[key]) / statistics.median(turn[f"{yardstick}:{bits}"]) for turn in turns]
            against = f"{statistics.median(ratios):.2f} times {yardstick}"
        times = [ms for turn in turns for ms in turn[key]]
        what = f"native program, float{bits}" if name == "native" else f"{platform}: {name}, float{bits}"
        table.add(what, f"{statistics.median(times):.0f} ms", f"{min(times):.0f} ms", against)
    table.add(f"{platform}: devices", found["device"])


def breakdown_rows(table: Table, cache: str, rounds: int) -> None:
    """The stages of a render on one device."""
    stages = worker("cpu", "breakdown.py", cache, 64, rounds)
    whole = stages.pop("whole")
    for name, ms in stages.items():
        table.add(f"one core: {name}, float64", f"{ms:.0f} ms", "", f"{ms / whole:.0%} of the whole")
    table.add("one core: the whole render, float64", f"{whole:.0f} ms")


def throughput_rows(table: Table, cache: str, rounds: int) -> None:
    """Many small pictures on one device, by the loop and by the batch, beside the pure tracing of them."""
    found = worker("cpu", "throughput.py", cache, rounds)
    turns = found["turns"]
    for name, what in THROUGHPUT.items():
        times = [turn[name] for turn in turns]
        ratio = statistics.median(turn[name] / turn["trace"] for turn in turns)
        against = f"{ratio:.2f} times tracing" if name != "trace" else f"{found['compiles']} compiles in all turns"
        table.add(
            f"one core: {what}, float64", f"{statistics.median(times):.1f} ms each", f"{min(times):.1f} ms", against
        )


def command_rows(table: Table, rows: tuple[Row, ...], folder: Path) -> None:
    """Commands from start to exit: a render whose programs are cached, and a fit whose programs are not."""
    scene = DATA / "vitreous.txt"
    if "start" in rows:
        render = ("render", scene, "-o", folder / "picture.exr", "--quiet")
        first = command_seconds(folder / "render-cache", *render)
        again = [command_seconds(folder / "render-cache", *render) for _ in range(3)]
        against = f"the first time: {first:.1f} s"
        table.add("`raytrace-jax render` again", f"{statistics.median(again):.1f} s", f"{min(again):.1f} s", against)
    if "fit" in rows:
        target = DATA / "course_schlick_moved.exr"
        fit = ("fit", scene, target, "--free", "vitreous.ior", "vitreous.center", "-o", folder / "fit", "--quiet")
        first = command_seconds(folder / "fit-cache", *fit)
        again = command_seconds(folder / "fit-cache", *fit)
        table.add("`raytrace-jax fit` of 4 parameters, empty cache", f"{first:.1f} s", "", f"again: {again:.1f} s")


def command_seconds(cache: Path, *arguments: object) -> float:
    """How long a command takes from start to exit."""
    command = [sys.executable, "-m", "raytrace_jax", *map(str, arguments)]
    start = time.perf_counter()
    subprocess.run(command, env={**os.environ, "XDG_CACHE_HOME": str(cache)}, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    main(tyro.cli(Options))
