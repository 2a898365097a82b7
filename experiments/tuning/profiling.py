"""What the profile's numbers are for: the ends of a parameter's interval, in few solves."""

from collections.abc import Iterator
from unittest import mock

import numpy as np
from bench import CASES, Bench
from refining import changed, solved, varied

from raytrace_jax.inverse.solve import profile

HEAD = ("scene", "number", "value", "interval of the index, in error bars", "center x at its ends", "linearisations")
VARIED = [
    ("profile:FARTHEST_ERRORS", {"2": 2.0, "2.5": 2.5, "4.5": 4.5}),
    ("profile:POINTS", {"3": 3, "4": 4, "12": 12}),
    ("profile:HELD.relative", changed(profile.HELD, "relative", 1e-5, 1e-9)),
    ("profile:HELD.decrease", changed(profile.HELD, "decrease", 1e-12, 1e-8, 1e-6)),
    ("profile:HELD.rejected", changed(profile.HELD, "rejected", 1, 2, 6)),
]
"""Numbers of `inverse.solve.profile` with values beside their own."""


def rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """A target that is the mean over each pixel, with noise of 1/255: the profile of the index."""
    bench = Bench(CASES[name], size)

    def outcome():
        solution, sure, _, recorder = solved(bench, bench.noisy(0), 0, "aware", "l2")
        calls = []
        linearize = type(solution.problem).linearize

        def counted(problem, y, comparison):
            calls.append(y)
            return linearize(problem, y, comparison)

        with mock.patch.object(type(solution.problem), "linearize", counted):
            drawn = profile.draw_profile(solution, 0, sure, 60, recorder)
        value = solution.problem.values(solution.y)
        ends = (np.array(drawn.interval) - value[0]) / sure.standard_error[0]
        shifts = np.interp(drawn.interval, drawn.value, drawn.others[1]) - value[1]
        x = " ".join(f"{shift / sure.standard_error[1]:+.3f}" for shift in shifts)
        return [" ".join(f"{end:+.3f}" for end in ends), x, str(len(calls))]

    yield from varied(name, bench, VARIED, outcome)
