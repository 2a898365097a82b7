"""What the last level's numbers are for: an answer that is off by little of its error bar, in few steps."""

from collections.abc import Iterator
from typing import Any
from unittest import mock

import jax
import numpy as np
from bench import CASES, SIGMA, Bench
from replacing import replaced

from raytrace_jax.inverse.judge.uncertainty import Uncertainty, quantify_uncertainty
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.prediction import ForwardModel
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.solve.refine import refine as solve

BOX: list[tuple[str, dict[str, Any]]] = [
    ("inverse.problem.sampling:COARSE_SAMPLES", {"3": 3, "4": 4}),
    ("inverse.problem.sampling:LATTICES", {f"{n}": (n,) for n in (89, 233, 610, 1597)}),
]
"""Numbers that matter to targets that are means over each pixel."""

NEAR = np.array([5e-3, 5e-3, -5e-3, 5e-3])
"""How far from the truth the solves begin: where a search ends."""


def varied(name: str, bench: Bench, numbers, outcome) -> Iterator[list[str]]:
    """The rows of one table: the usual numbers, then each with other values."""
    with bench.remembering():
        yield [name, "usual", "", *outcome()]
        for address, values in numbers:
            for word, value in values.items():
                with replaced({address: value}):
                    yield [name, f"`{address.split(':')[1]}`", word, *outcome()]


def solved(bench: Bench, target: np.ndarray, number: int, edges, loss) -> tuple[FitState, Uncertainty, int, Any]:
    """The end of a solve from near the truth, how sure it is, its steps, and who kept the history."""
    start = bench.truth + NEAR * np.random.default_rng(number).choice([-1, 1], 4)
    sampling = "box" if edges == "aware" else "point"
    options = FitOptions(search=False, sigma=SIGMA, loss=loss, target_sampling=sampling)
    problem, progress = bench.problem(bench.scene_at(start), target, options)
    solution = solve(problem, problem.start(), options, progress, progress.of_level(0, 0))
    return solution, quantify_uncertainty(solution, SIGMA), len(progress.findings.steps), progress


BOX_HEAD = ("scene", "number", "value", "error / bound", "steps", "fine rays a pixel")


def box_rows(name: str, size: tuple[int, int], count: int) -> Iterator[list[str]]:
    """Targets without noise that are means over each pixel: the error beside the bound for noise of 1/255."""
    bench, rays = Bench(CASES[name], size), []
    render_points = ForwardModel().points

    def counted(scenes, points, settings):
        rays.append(points.shape[1])
        place = hash((*(leaf.tobytes() for leaf in jax.tree.leaves(scenes)), points.tobytes(), settings))
        if place not in bench.kept:
            bench.kept[place] = render_points(scenes, points, settings)
        return bench.kept[place]

    def outcome():
        rays.clear()
        errors, steps = [], 0
        for number in range(count):
            solution, sure, taken, _ = solved(bench, bench.clean, number, "aware", "l2")
            errors.append(np.max(np.abs(solution.problem.values(solution.y) - bench.truth) / sure.cramer_rao))
            steps += taken
        found = " ".join(f"{error:.3f}" for error in errors)
        return [found, str(steps), f"{sum(rays) / (count * size[0] * size[1]):.0f}"]

    with mock.patch("raytrace_jax.inverse.problem.problem.forward_model", lambda _: ForwardModel(points=counted)):
        yield from varied(name, bench, BOX, outcome)


POINT_HEAD = ("scene", "number", "value", "settled", "rms error / error bar", "error without noise", "steps")


def point_rows(name: str, size: tuple[int, int], count: int) -> Iterator[list[str]]:
    """Targets of one ray a pixel, with noise of 1/255 and without."""
    bench = Bench(CASES[name], size, "point")

    def outcome():
        ratios, settled, steps = [], 0, 0
        for number in range(count):
            solution, sure, taken, _ = solved(bench, bench.noisy(number), number, "point", "cauchy")
            ratios.append((solution.problem.values(solution.y) - bench.truth) / sure.standard_error)
            settled, steps = settled + solution.settled, steps + taken
        exact, _, taken, _ = solved(bench, bench.clean, 0, "point", "cauchy")
        error = np.max(np.abs(exact.problem.values(exact.y) - bench.truth))
        size = np.sqrt(np.mean(np.square(ratios)))
        return [f"{settled} of {count}", f"{size:.2f}", f"{error:.1e}", f"{steps} + {taken}"]

    yield from varied(name, bench, [], outcome)
