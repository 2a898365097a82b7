"""The profile likelihood of a parameter: what the error bar is when the problem is not a parabola."""

import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.uncertainty import LARGEST_ERROR, Uncertainty
from raytrace_jax.inverse.result import PROFILE_95, Profile
from raytrace_jax.inverse.solve.least_squares import Tolerance, levenberg_marquardt
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.state import FitState
from raytrace_jax.util.numerics import TINY

FARTHEST_ERRORS = 3.0
"""How far a profile goes to either side, in standard errors: beyond the 1.96 of a parabola's 95 % interval. One that
curves up less is closed too, down to (1.96 / 3)^2 = 0.43 of a parabola's curvature."""

POINTS = 6
"""Points of a profile on either side of the estimate: half a standard error apart. A root of it that bends like
x + c x^2, in standard errors, is off by at most c/16 between two of them, where it is taken for straight."""

HELD = Tolerance(relative=1e-7, decrease=1e-10, rejected=3)
"""Of each point's solve: chi-square to a hundredth and better. All of it is about the number of residuals, a million at
640 x 480 pixels, of which a decrease of 1e-10 is 1e-4."""


def draw_profile(
    solution: FitState, place: int, uncertainty: Uncertainty, max_steps: int, recorder: Recorder
) -> Profile:
    """Hold one parameter at values to both sides of its estimate and fit the others again at each.

    Each point starts from its neighbour, moved along the regression of the others on the held one.

    Args:
        solution: the optimum.
        place: number of the parameter to hold.
        uncertainty: how sure the estimate is.
        max_steps: steps of each solve at most.
        recorder: is told of the stages.
    """
    problem = solution.problem
    name = problem.unknowns.names[place]
    estimate = problem.values(solution.y)
    error = uncertainty.standard_error[place]
    if not np.isfinite(error):
        error = LARGEST_ERROR * float(problem.scale[place])
    errors = np.where(np.isfinite(uncertainty.standard_error), uncertainty.standard_error, 0)
    along = uncertainty.correlation[:, place] * errors / max(float(errors[place]), TINY)
    along[place] = 1.0
    lowest = solution.linearization.cost

    points = {0.0: (estimate, 0.0)}
    for side in (-1, 1):
        values = estimate
        for step in side * FARTHEST_ERRORS * (np.arange(POINTS) + 1) / POINTS:
            recorder.phase(f"profile of {name}, {step:+.2g} standard errors")
            guess = values + along * (estimate[place] + step * error - values[place])

            def solve(guess=guess):
                y, least = solve_held(solution, guess, place, max_steps)
                return {"value": problem.values(y).tolist(), "cost": least}

            outcome = recorder.stage(f"profile of {name} at {step:+.3g}", solve)
            values = np.asarray(outcome["value"])
            points[float(step)] = values, 2 * (outcome["cost"] - lowest) / uncertainty.sigma**2
    ordered = [points[step] for step in sorted(points)]
    value = np.array([values[place] for values, _ in ordered])
    chi_square = np.array([square for _, square in ordered])
    others = np.stack([values for values, _ in ordered], axis=1)
    return Profile(name, value, chi_square, others, interval(value, chi_square))


def solve_held(
    solution: FitState, guess: Float[np.ndarray, " parameters"], place: int, max_steps: int
) -> tuple[Float[Array, " parameters"], float]:
    """Unknowns and cost with one parameter held: a solver that sees no derivative along it leaves it where it is."""
    problem = solution.problem

    def linearize_held(y):
        linearization = problem.linearize(y, solution.comparison)
        return eqx.tree_at(lambda tree: tree.jacobian, linearization, linearization.jacobian.at[:, place].set(0))

    start = problem.array(problem.unknowns.unknowns(guess))
    state = levenberg_marquardt(problem, start, solution.comparison, HELD, max_steps, linearize=linearize_held)
    return state.y, state.linearization.cost


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
