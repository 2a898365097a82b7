"""Two commits of this repository in turns, on the same machine in the same minutes: one table of ratios in Markdown.

    python experiments/benchmarks/compare.py 6466e48 HEAD

Each commit is checked out into a folder of its own and run with the packages that are installed here. The programs and
commands are those of `benchmark.py`; a turn runs the old commit, then the new one, and its ratio is what counts.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console

REPOSITORY = Path(__file__).parents[2]
BENCHMARKS = Path("experiments/benchmarks")

Program = Literal["render", "jacobian", "gradient", "scene_gradient", "aware_render", "aware_jacobian"]
Row = Literal[Program, "start", "fit", "box_fit"]
ROWS: tuple[Row, ...] = ("render", "jacobian", "gradient", "start", "fit", "box_fit")

REPEATS = 5
"""How often a process runs each program in a turn, all of them in rotation: starting it takes longer."""


@dataclass(frozen=True)
class Options:
    """Compare the speed of two commits; the table goes to stdout, what is being done to stderr."""

    old: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="OLD")]
    """The commit that is compared with."""
    new: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NEW")] = "HEAD"
    """The commit that is compared."""
    rows: tuple[Row, ...] = ROWS
    """What to measure."""
    rounds: int = 5
    """How many turns the warm programs take; commands take three and one before, fits one."""


def main(options: Options) -> None:
    say = Console(stderr=True, highlight=False).print
    with tempfile.TemporaryDirectory() as folder:
        sides = [Side(commit, Path(folder) / name) for commit, name in ((options.old, "old"), (options.new, "new"))]
        print(
            f"| what | {options.old} | {options.new} | ratio of the least | median turn |\n|---|---|---|---|---|",
            flush=True,
        )
        programs = [row for row in options.rows if row in get_args(Program)]
        if programs:
            say("compiling ...")
            for side in sides:
                side.warm(programs)
            say("warm programs in turns ...")
            turns = [[side.warm(programs) for side in sides] for _ in range(options.rounds)]
            for key in turns[0][0]:
                print_row(key.replace(":", ", float"), [[found[key] for found in turn] for turn in turns], "ms")
        if "start" in options.rows:
            say("starts in turns ...")
            in_turns("`raytrace-jax render` again", sides, lambda side: side.command("render"), 4)
        if "fit" in options.rows:
            say("fits in turns ...")
            in_turns("`raytrace-jax fit` of 4 parameters, empty cache", sides, lambda side: side.command("fit"), 0)
            in_turns("the same again", sides, lambda side: side.command("fit"), 1)
        if "box_fit" in options.rows:
            say("fits to means over each pixel in turns ...")
            target = Path(folder) / "box.exr"
            sides[-1].command("box_target", target)
            for side in sides:
                shutil.rmtree(side.cache, ignore_errors=True)
            for what in ("`raytrace-jax fit` to means over 320 x 240 pixels, empty cache", "the same again"):
                in_turns(what, sides, lambda side: side.command("box_fit", target), 1)


class Side:
    """A commit in a folder of its own, with a cache of its own."""

    def __init__(self, commit: str, folder: Path):
        self.root, self.cache, self.output = folder / "tree", folder / "cache", folder / "output"
        self.root.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", commit], cwd=REPOSITORY, stdout=subprocess.PIPE, check=True)
        subprocess.run(["tar", "-x", "-C", self.root], input=archive.stdout, check=True)
        self.environment = {**os.environ, "PYTHONPATH": str(self.root), "XDG_CACHE_HOME": str(self.cache)}

    def warm(self, programs: list[str]) -> dict[str, float]:
        """The least milliseconds of warm programs, by name and bits, in one process."""
        entries = [f"{name}:{bits}" for bits in ("64", "32") for name in programs]
        command = [sys.executable, self.root / BENCHMARKS / "warm.py", self.cache / "warm", REPEATS, *entries]
        done = self.run(command, stdout=subprocess.PIPE)
        turns = json.loads(done.stdout.splitlines()[-1])["turns"]
        return {key: min(min(turn[key]) for turn in turns) for key in turns[0]}

    def command(self, name: Literal["render", "fit", "box_target", "box_fit"], target: Path | None = None) -> float:
        """Seconds of a command from start to exit; `target` is what the last two write and fit."""
        data, small = self.root / "data", ("--size", "320", "240")
        arguments = {
            "render": ["render", data / "vitreous.txt", "-o", self.output / "picture.exr", "--quiet"],
            "fit": [
                *("fit", data / "vitreous.txt", data / "course_schlick_moved.exr"),
                *("--free", "vitreous.ior", "vitreous.center", "-o", self.output / "fit", "--quiet"),
            ],
            "box_target": [
                *("render", data / "vitreous.txt", "-D", "vitreous.ior=1.45", "-D", "vitreous.center=4.15,2.45,-1.25"),
                *(*small, "--samples", "8", "-o", target, "--quiet"),
            ],
            "box_fit": [
                *("fit", data / "vitreous.txt", target, *small, "--free", "vitreous.ior", "vitreous.center"),
                *("-o", self.output / "box_fit", "--quiet"),
            ],
        }
        start = time.perf_counter()
        self.run([sys.executable, "-m", "raytrace_jax", *arguments[name]], stdout=subprocess.DEVNULL)
        return time.perf_counter() - start

    def run(self, command: list[object], stdout: int) -> subprocess.CompletedProcess[str]:
        """Run a command with this commit's package."""
        return subprocess.run(
            [str(word) for word in command], cwd=self.root, env=self.environment, stdout=stdout, text=True, check=True
        )


def in_turns(what: str, sides: list[Side], measure: Callable[[Side], float], rounds: int) -> None:
    """Measure both sides in turns and print the row; no rounds are the first and only run, else one comes before."""
    turns = [[measure(side) for side in sides] for _ in range(max(rounds, 1))]
    if rounds > 1:
        turns = turns[1:]
    print_row(what, turns, "s")


def print_row(what: str, turns: list[list[float]], unit: str) -> None:
    """The least of both sides and its ratio: other work only ever adds time. Then the ratios turn by turn."""
    old, new = (min(turn[side] for turn in turns) for side in range(2))
    ratios = sorted(after / before for before, after in turns)
    each = f"{statistics.median(ratios):.3f} ({ratios[0]:.2f} to {ratios[-1]:.2f})" if len(ratios) > 1 else ""
    shown = [f"{value:.0f} {unit}" if value >= 100 or unit == "ms" else f"{value:.1f} {unit}" for value in (old, new)]
    print(f"| {what} | {shown[0]} | {shown[1]} | {new / old:.3f} | {each} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
