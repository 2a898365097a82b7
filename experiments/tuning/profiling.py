"""What the profile's numbers are for: a 95 % interval that does not depend on them, from few linearisations."""

import dataclasses
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
from bench import CASES, SIGMA, Bench
from replacing import replaced

from raytrace_jax import RenderSettings
from raytrace_jax.inverse.conclusion import uncertainty_of
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.pose import pose
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.solve import profile
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine import refine
from raytrace_jax.inverse.solve.solution import RefineOptions, Solution

PROFILE = "inverse.solve.profile"


def held(**changes) -> Any:
    """The tolerance of a profile's points, changed."""
    return dataclasses.replace(profile.HELD, **changes)


VARIED: list[tuple[str, dict[str, Any]]] = [
    ("FARTHEST_ERRORS", {"2": 2.0, "4": 4.0}),
    ("POINTS", {"3": 3, "12": 12}),
    ("HELD.relative", {"1e-5": held(relative=1e-5), "1e-9": held(relative=1e-9)}),
    ("HELD.decrease", {"1e-4": held(decrease=1e-4), "1e-6": held(decrease=1e-6)}),
    ("HELD.rejected", {"1": held(rejected=1)}),
]
"""Numbers of `inverse.solve.profile` with values beside their own."""

REFERENCE = {"FARTHEST_ERRORS": 4.0, "POINTS": 24, "HELD": held(relative=1e-9, decrease=1e-12)}
"""Values with which an interval is taken for the truth."""

HEAD = ("scene", "number", "value", "ends of the intervals, error bars off", "open", "linearisations")


def solutions(bench: Bench) -> Iterator[tuple[Solution, int]]:
    """Fits whose profiles are drawn, with the number of the parameter that is held.

    Targets that are means over each pixel: the index beside noise of 16/255, and the depth beside noise of 4/255 where
    the radius is free, with which it goes together.
    """
    for noise, more, place in ((16, (), 0), (4, ("radius",), 3)):
        names = (*bench.case.free, *(f"{bench.case.ball}.{name}" for name in more))
        target = bench.noisy(noise, noise * SIGMA)
        problem = pose(bench.truth_scene, target, names, RenderSettings(size=bench.how.size), FitOptions()).problem
        recorder = Recorder(problem, {}, None, None, None)
        yield refine(problem, problem.start(), RefineOptions("aware", "l2", None, 60, 0, 0), recorder), place


def rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """The table's rows for one scene."""
    bench = Bench(CASES[name], size)
    with bench.remembering():
        solved = list(solutions(bench))
        linearize = Problem.linearize

        def intervals() -> tuple[np.ndarray, int]:
            count = [0]

            def counted(problem, y, comparison):
                count[0] += 1
                return linearize(problem, y, comparison)

            ends = []
            with mock.patch.object(Problem, "linearize", counted):
                for solution, place in solved:
                    uncertainty = uncertainty_of(solution, None)
                    recorder = Recorder(solution.problem, {}, None, None, None)
                    drawn = profile.draw_profile(solution, place, uncertainty, 60, recorder)
                    estimate = solution.problem.values(solution.y)[place]
                    ends.append((np.array(drawn.interval) - estimate) / uncertainty.standard_error[place])
            return np.array(ends), count[0]

        with replaced({f"{PROFILE}:{number}": value for number, value in REFERENCE.items()}):
            truth, taken = intervals()
        told = "; ".join(f"{low:+.2f} {high:+.2f}" for low, high in truth)
        yield [name, "reference", "", told, str(int(np.sum(np.isinf(truth)))), str(taken)]
        choices = [("usual", "", {})]
        for number, values in VARIED:
            choices += [(f"`{number}`", word, {f"{PROFILE}:{number.split('.')[0]}": v}) for word, v in values.items()]
        for number, word, change in choices:
            with replaced(change):
                ends, taken = intervals()
            closed = np.isfinite(ends) & np.isfinite(truth)
            off = ends[closed] - truth[closed]
            told = " ".join(f"{one:+.3f}" for one in off)
            yield [name, number, word, told, str(int(np.sum(np.isinf(ends)))), str(taken)]
