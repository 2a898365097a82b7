"""What the search's numbers are for: that it finds the truth from anywhere, in few steps."""

from collections.abc import Iterator
from typing import Any

from bench import CASES, Bench
from replacing import replaced

from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.solve.search import choose_levels, find_minima

HEAD = ("scene", "number", "value", "at the truth", "explained", "minima", "pictures scanned", "steps")


VARIED: list[tuple[str, dict[str, Any]]] = [
    ("inverse.solve.search:LEAST_SOLVES", {"1": 1, "4": 4}),
    ("inverse.solve.search:LEAST_SIGNAL", {"0.15": 0.15, "0.6": 0.6}),
]
"""Numbers of `inverse.solve.search` with values beside their own."""

NEAR_TRUTH = 0.02
"""A minimum nearer to the truth than this, in natural scales, is there."""


def rows(name: str, size: tuple[int, int], count: int) -> Iterator[list[str]]:
    """The table's rows for one scene."""
    bench = Bench(CASES[name], size)
    with bench.remembering():
        yield [name, "usual", "", *outcome(bench, count)]
        for address, values in VARIED:
            for word, value in values.items():
                with replaced({address: value}):
                    yield [name, f"`{address.split(':')[1]}`", word, *outcome(bench, count)]


def outcome(bench: Bench, count: int) -> list[str]:
    """What searches from so many starts come to."""
    there = explained = minima = scanned = steps = 0
    for number, start in enumerate(bench.random_starts(count)):
        problem, progress = bench.problem(start, bench.noisy(number), FitOptions())
        phases: list[str] = []
        progress.on_phase = phases.append
        found = find_minima(problem, choose_levels(problem, FitOptions()), FitOptions(), progress)
        there += problem.distance(found[0].summary.value, bench.truth) < NEAR_TRUTH
        explained += found[0].summary.explained
        minima += len(found)
        pictures = [int(phase.split()[1]) for phase in phases if phase.endswith("pictures")]
        scanned, steps = scanned + max(pictures), steps + len(progress.findings.steps)
    return [f"{there} of {count}", str(explained), str(minima), str(scanned), str(steps)]
