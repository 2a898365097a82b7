"""What the search's numbers are for: that it finds the truth from anywhere, in few steps."""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

from bench import CASES, Bench
from replacing import replaced

from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.solve import candidates, levels
from raytrace_jax.inverse.solve.levels import choose_levels
from raytrace_jax.inverse.solve.search import find_minima

HEAD = ("scene", "number", "value", "at the truth", "explained", "minima", "pictures scanned", "steps")
SOLVE = "inverse.solve"


def scaled(numbers: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """Each number so many times."""
    return tuple(factor * x for x in numbers)


def between(numbers: tuple[float, ...]) -> tuple[float, ...]:
    """The numbers and those in the middle of two neighbours."""
    return tuple(sorted([*numbers, *((a + b) / 2 for a, b in itertools.pairwise(numbers))]))


def coarse(**changes) -> Any:
    """The tolerance of the coarse levels, changed."""
    return dataclasses.replace(levels.COARSE, **changes)


def compared(**changes) -> Any:
    """The tolerance of the last level on small pictures, changed."""
    return dataclasses.replace(levels.COMPARED, **changes)


VARIED: list[tuple[str, dict[str, Any]]] = [
    ("candidates:INDICES", {"every other": candidates.INDICES[::2], "and between": between(candidates.INDICES)}),
    ("candidates:NEAR", {"half": scaled(candidates.NEAR, 0.5), "double": scaled(candidates.NEAR, 2)}),
    ("candidates:NEAR_DEPTH", {"half": scaled(candidates.NEAR_DEPTH, 0.5), "double": scaled(candidates.NEAR_DEPTH, 2)}),
    ("candidates:FAR", {"3": 3, "5": 5, "14": 14}),
    ("candidates:FAR_INDICES", {"1.5": (1.5,), "and between": between(candidates.FAR_INDICES)}),
    ("search:SCAN_BLUR", {"0.5": 0.5, "2": 2.0}),
    ("search:SAME_START", {"0.05": 0.05, "0.2": 0.2}),
    ("search:LEAST_SOLVES", {"1": 1, "4": 4}),
    ("search:MOST_SOLVES", {"2": 2, "10": 10}),
    ("levels:COARSE_BLUR", {"4 2 1": (4.0, 2.0, 1.0), "16 8 4": (16.0, 8.0, 4.0), "8 2": (8.0, 2.0), "none": ()}),
    ("levels:LEAST_SIGNAL", {"0.15": 0.15, "0.6": 0.6}),
    ("levels:MOST_STEPS", {"12": 12, "50": 50}),
    ("levels:COARSE.relative", {"3e-4": coarse(relative=3e-4), "3e-3": coarse(relative=3e-3)}),
    ("levels:COARSE.decrease", {"1e-3": coarse(decrease=1e-3), "1e-1": coarse(decrease=1e-1)}),
    ("levels:COARSE.rejected", {"1": coarse(rejected=1), "4": coarse(rejected=4)}),
    ("levels:COMPARED.relative", {"1e-5": compared(relative=1e-5), "1e-3": compared(relative=1e-3)}),
    ("levels:COMPARED.decrease", {"1e-6": compared(decrease=1e-6), "1e-2": compared(decrease=1e-2)}),
    ("levels:COMPARED.rejected", {"1": compared(rejected=1), "4": compared(rejected=4)}),
    ("levels:SAME_MINIMUM", {"0.015": 0.015, "0.06": 0.06}),
]
"""Numbers of `inverse.solve` with values beside their own."""

NEAR_TRUTH = 0.02
"""A minimum nearer to the truth than this, in natural scales, is there."""


def rows(name: str, size: tuple[int, int], count: int) -> Iterator[list[str]]:
    """The table's rows for one scene."""
    bench = Bench(CASES[name], size)
    with bench.remembering():
        yield [name, "usual", "", *outcome(bench, count)]
        for address, values in VARIED:
            for word, value in values.items():
                with replaced({f"{SOLVE}.{address.split('.')[0]}": value}):
                    yield [name, f"`{address.split(':')[1]}`", word, *outcome(bench, count)]


def outcome(bench: Bench, count: int) -> list[str]:
    """What searches from so many starts come to."""
    there = explained = minima = scanned = steps = 0
    for number, start in enumerate(bench.random_starts(count)):
        problem, recorder = bench.problem(start, bench.noisy(number), FitOptions())
        phases: list[str] = []
        recorder.on_phase = phases.append
        found = find_minima(problem, choose_levels(problem, None), "aware", True, recorder)
        there += problem.scaled_distance(found[0].summary.value, bench.truth) < NEAR_TRUTH
        explained += found[0].summary.explained
        minima += len(found)
        pictures = [int(phase.split()[1]) for phase in phases if phase.endswith("pictures")]
        scanned, steps = scanned + max(pictures), steps + len(recorder.history)
    return [f"{there} of {count}", str(explained), str(minima), str(scanned), str(steps)]
