"""The profile likelihood of a parameter: what the error bar is when the problem is not a parabola."""

import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.uncertainty import LARGEST_ERROR, Certainty
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.result import PROFILE_95, Profile
from raytrace_jax.inverse.solve.last_level import Finished
from raytrace_jax.inverse.solve.least_squares import Progress, Tolerance, solve_level
from raytrace_jax.inverse.solve.recorder import Recorder

REACH = 3.0
"""How far a profile goes to either side, in standard errors."""

POINTS = 6
"""Points of a profile on either side of the estimate."""

TOLERANCE = Tolerance(1e-7, 1e-10, 3)
"""Of each point's solve."""


def profile(finished: Finished, name: str, sure: Certainty, max_steps: int, recorder: Recorder) -> Profile:
    """Hold one parameter at values to both sides of its estimate and fit the others again at each.

    Each point starts from its neighbour, moved along the regression of the others on the held one.

    Args:
        finished: the optimum.
        name: the parameter to hold.
        sure: how sure the estimate is.
        max_steps: steps of each solve at most.
        recorder: is told of the stages.
    """
    problem = finished.problem
    place = problem.unknowns.names.index(name)
    estimate = problem.values(finished.y)
    error = sure.standard_error[place]
    if not np.isfinite(error):
        error = LARGEST_ERROR * float(problem.scale()[place])
    errors = np.where(np.isfinite(sure.standard_error), sure.standard_error, 0)
    along = sure.correlation[:, place] * errors / max(float(errors[place]), 1e-300)
    along[place] = 1.0
    lowest = cost(problem.linearize(finished.y, finished.measure))

    points = {0.0: (estimate, 0.0)}
    for side in (-1, 1):
        values = estimate
        for step in side * REACH * (np.arange(POINTS) + 1) / POINTS:
            recorder.phase(f"profile of {name}, {step:+.2g} standard errors")
            guess = values + along * (estimate[place] + step * error - values[place])

            def solve(guess=guess):
                y, least = solve_held(finished, guess, place, max_steps)
                return {"value": problem.values(y).tolist(), "cost": least}

            outcome = recorder.stage(f"profile of {name} at {step:+.3g}", solve)
            values = np.asarray(outcome["value"])
            points[float(step)] = values, 2 * (outcome["cost"] - lowest) / sure.sigma**2
    ordered = [points[step] for step in sorted(points)]
    value = np.array([values[place] for values, _ in ordered])
    chi_square = np.array([square for _, square in ordered])
    others = np.stack([values for values, _ in ordered], axis=1)
    return Profile(name, value, chi_square, others, interval(value, chi_square))


def cost(found: Linearization) -> float:
    """Half the sum of squares."""
    return 0.5 * float((found.residual**2).sum())


def solve_held(
    finished: Finished, guess: Float[np.ndarray, " parameters"], place: int, max_steps: int
) -> tuple[Float[Array, " parameters"], float]:
    """Unknowns and cost with one parameter held: a solver that sees no derivative along it leaves it where it is."""
    problem = finished.problem

    def held(y):
        found = problem.linearize(y, finished.measure)
        return eqx.tree_at(lambda tree: tree.jacobian, found, found.jacobian.at[:, place].set(0))

    progress = Progress(problem.array(problem.unknowns.unknowns(guess)))
    solve_level(held, progress, TOLERANCE, max_steps, lambda *step: None)
    return progress.y, cost(held(progress.y))


def interval(value: Float[np.ndarray, " points"], chi_square: Float[np.ndarray, " points"]) -> tuple[float, float]:
    """Where a profile crosses the 95 % bound to the left and to the right of its lowest point."""
    lowest = int(np.argmin(chi_square))

    def crossing(places) -> float:
        for inner, outer in itertools.pairwise(places):
            if chi_square[outer] >= PROFILE_95:
                # Roots of a profile run nearly straight.
                low, high = np.sqrt(np.maximum(chi_square[[inner, outer]], 0))
                share = (np.sqrt(PROFILE_95) - low) / (high - low)
                return float(value[inner] + share * (value[outer] - value[inner]))
        return float("inf")

    left, right = crossing(range(lowest, -1, -1)), crossing(range(lowest, len(value)))
    return (-left if np.isinf(left) else left), right
