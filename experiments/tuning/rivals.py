"""What the numbers of rivals are for: that the right one of several minima is the answer, and that doubt is told."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from bench import CASES, EXPERIMENTS, SIGMA, Bench, Case
from replacing import replaced

from raytrace_jax.inverse.assumptions import ModelCheck
from raytrace_jax.inverse.conclusion import verdict
from raytrace_jax.inverse.noise import explains
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem import Problem
from raytrace_jax.inverse.refine import RIVALS, refine, select_solution
from raytrace_jax.inverse.sampling import told_once
from raytrace_jax.inverse.search import choose_levels, find_minima
from raytrace_jax.inverse.steps import LocalMinimum
from raytrace_jax.inverse.uncertainty import quantify_uncertainty

PEBBLES = Case(EXPERIMENTS / "estimates" / "scenes" / "pebbles.txt", "ball", (1.2, 1.8), 0.3)
MANY_MINIMA: dict[str, tuple[Case, tuple[int, ...]]] = {
    "pebbles": (PEBBLES, (32, 96)),
    "assignment": (CASES["assignment"], (32, 96)),
}
"""Scenes, and standard deviations of noise in steps of 8 bits: much noise makes minima alike."""

VARIED: list[tuple[str, Mapping[str, Any]]] = [
    ("most", {"0": 0, "1": 1, "4": 4}),
    ("same_end", {"1e-5": 1e-5, "1e-4": 1e-4, "1e-2": 1e-2, "1e-1": 1e-1}),
    ("first_evidence", {"1.5": 1.5, "3": 3.0, "12": 12.0, "24": 24.0, "any": np.inf}),
]
"""Numbers of `inverse.refine.RIVALS` with values beside their own."""

HEAD = ("scene", "noise", "number", "value", "at the truth", "words", "minima told", "solved to the end", "steps")
NEAR_TRUTH = 0.15
"""An answer nearer to the truth than this, in natural scales, is there: noise moves it by less, other minima are at
0.5."""


class Searched(NamedTuple):
    """A problem with its minima on small pictures."""

    problem: Problem
    minima: list[LocalMinimum]


def rows(name: str, size: tuple[int, int], count: int) -> Iterator[list[str]]:
    """The table's rows for one scene: so many starts for each noise."""
    case, noises = MANY_MINIMA[name]
    bench = Bench(case, size)
    for steps in noises:
        with bench.remembering():
            searched = []
            for number, start in enumerate(bench.random_starts(count)):
                problem, recorder = bench.problem(start, bench.noisy(number, steps * SIGMA))
                minima = find_minima(problem, choose_levels(problem, None), "aware", True, recorder)
                searched.append(Searched(problem, minima))
            solved: dict = {}
            noise = f"{steps}/255"
            yield [name, noise, "usual", "", *outcome(bench, searched, solved)]
            for number, values in VARIED:
                for word, value in values.items():
                    with replaced({"inverse.refine:RIVALS": dataclasses.replace(RIVALS, **{number: value})}):
                        yield [name, noise, f"`RIVALS.{number}`", word, *outcome(bench, searched, solved)]


def outcome(bench: Bench, searched: list[Searched], solved: dict) -> list[str]:
    """What the answers are; each minimum is solved to the end once for all numbers, in `solved`."""
    options, there, words, told, ends, steps = FitOptions(target_sampling="box"), 0, [], 0, 0, 0

    for number, (problem, minima) in enumerate(searched):
        taken: list[int] = []

        def once(problem, y, how, recorder, number=number, taken=taken):
            place = number, how.candidate
            if place not in solved:
                before = len(recorder.history)
                solution = refine(problem, y, how, recorder)
                solved[place] = solution, len(recorder.history) - before
            taken.append(solved[place][1])
            return solved[place][0]

        _, recorder = bench.problem(bench.truth_scene, bench.clean)
        with replaced({"inverse.refine:refine": once}):
            found, solution = select_solution(problem, minima, 4, options, recorder, told_once(problem))
        word, _, _ = verdict(
            settled=solution.settled,
            explained=explains(solution),
            check=ModelCheck.nothing(len(bench.truth)),
            excess=0.0,
            uncertainty=quantify_uncertainty(solution, None),
            runner_ups=tuple(minimum.summary for minimum in found[1:]),
            max_steps=options.max_steps,
        )
        there += problem.scaled_distance(problem.values(solution.y), bench.truth) < NEAR_TRUTH
        words.append(word)
        told, ends, steps = told + len(found), ends + len(taken), steps + sum(taken)
    counted = ", ".join(f"{words.count(word)} {word}" for word in sorted(set(words)))
    return [f"{there} of {len(searched)}", counted, str(told), str(ends), str(steps)]
