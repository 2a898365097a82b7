"""The profile likelihood of a parameter: its interval where the cost is not a parabola."""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.uncertainty import LARGEST_ERROR, Uncertainty
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.unknowns import Values, Vector
from raytrace_jax.inverse.result import PROFILE_95, Profile
from raytrace_jax.inverse.solve.solvers import levenberg_marquardt
from raytrace_jax.inverse.solve.steps import Recorder, hold
from raytrace_jax.util.numerics import TINY

FARTHEST_ERRORS = 3.0
"""The reach of a profile to either side in standard errors, beyond the 1.96 of a parabola's 95 % interval. The interval
of one that curves up less closes too, down to (1.96 / 3)^2 = 0.43 of a parabola's curvature."""


def find_profile(
    solution: FitState, place: int, uncertainty: Uncertainty, max_steps: int, recorder: Recorder
) -> Profile:
    """Hold one parameter at values to both sides of its estimate and fit the others again at each.

    Each point starts from its neighbour, moved along the regression of the other parameters on the held one.
    """
    problem = solution.problem
    name = problem.unknowns.names[place]
    estimate = problem.values(solution.y)
    # The step of the held parameter, and how the others move with it.
    error = uncertainty.standard_error[place]
    if not np.isfinite(error):
        error = LARGEST_ERROR * float(problem.scale[place])
    errors = np.where(np.isfinite(uncertainty.standard_error), uncertainty.standard_error, 0)
    along = uncertainty.correlation[:, place] * errors / max(float(errors[place]), TINY)
    along[place] = 1.0
    lowest = solution.linearization.cost

    # Go outwards on each side. Twice the rise of the cost, in units of the noise, is chi-square.
    points = {0.0: (estimate, 0.0)}
    for side in (-1, 1):
        values = estimate
        # Six points, half a standard error apart. A root of the profile that bends like x + c x^2, in standard errors,
        # is off by at most c/16 between two of them, where it is taken for straight.
        for step in side * FARTHEST_ERRORS * (np.arange(6) + 1) / 6:
            recorder.phase(f"profile of {name}, {step:+.2g} standard errors")
            guess = values + along * (estimate[place] + step * error - values[place])
            y, least = solve_held(solution, guess, place, max_steps)
            values = problem.values(y)
            points[float(step)] = values, 2 * (least - lowest) / uncertainty.sigma**2
    # Put both sides together, from the lowest value to the highest.
    ordered = [points[step] for step in sorted(points)]
    value = np.array([values[place] for values, _ in ordered])
    chi_square = np.array([square for _, square in ordered])
    others = np.stack([values for values, _ in ordered], axis=1)
    return Profile(name, value, chi_square, others, interval(value, chi_square))


def solve_held(solution: FitState, guess: Values, place: int, max_steps: int) -> tuple[Vector, float]:
    """Unknowns and cost with one parameter held."""
    problem = solution.problem
    start = problem.y_of(guess)
    # Chi-square is about the number of residuals, a million at 640 x 480 pixels, of which a decrease of 1e-10 is 1e-4.
    stage = dataclasses.replace(solution.stage, max_steps=max_steps, relative=1e-7, decrease=1e-10, rejected=3)
    state = levenberg_marquardt(problem, start, stage, linearize=lambda y: hold(problem.linearize(y, stage), [place]))
    return state.y, state.linearization.cost


def interval(value: Float[np.ndarray, " points"], chi_square: Float[np.ndarray, " points"]) -> tuple[float, float]:
    """Values where a profile crosses the 95 % bound on both sides of its lowest point; infinite if it never does."""
    lowest = int(np.argmin(chi_square))

    def crossing(places) -> float:
        for inner, outer in itertools.pairwise(places):
            if chi_square[outer] >= PROFILE_95:
                # The root of chi-square runs nearly straight, so that it is interpolated linearly.
                low, high = np.sqrt(np.maximum(chi_square[[inner, outer]], 0))
                fraction = (np.sqrt(PROFILE_95) - low) / (high - low)
                return float(value[inner] + fraction * (value[outer] - value[inner]))
        return float("inf")

    left, right = crossing(range(lowest, -1, -1)), crossing(range(lowest, len(value)))
    return (-left if np.isinf(left) else left), right
