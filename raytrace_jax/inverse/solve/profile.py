"""The profile likelihood of a parameter: its interval where the cost is not a parabola."""

import itertools

import numpy as np
from jaxtyping import Float

from ...util.numerics import TINY
from ..judge.uncertainty import LARGEST_ERROR, Uncertainty
from ..problem.problem import FitState
from ..result import PROFILE_95, Profile
from .solvers import LevenbergMarquardt, levenberg_marquardt
from .steps import Recorder


def find_profile(
    solution: FitState, place: int, uncertainty: Uncertainty, max_steps: int, recorder: Recorder
) -> Profile:
    """Hold one parameter at values to both sides of its estimate and fit the others again at each.

    Each point starts from its neighbour, moved along the regression of the other parameters on the held one. The values
    reach to three standard errors on either side, beyond the 1.96 of a parabola's 95 % interval. The interval of a
    profile that curves up less closes too, down to (1.96 / 3)^2 = 0.43 of a parabola's curvature.
    """
    problem = solution.problem
    name, estimate = problem.unknowns.names[place], problem.values(solution.y)
    # The step of the held parameter, and how the others move with it.
    error = uncertainty.standard_error[place]
    if not np.isfinite(error):
        error = LARGEST_ERROR * float(problem.scale[place])
    errors = np.where(np.isfinite(uncertainty.standard_error), uncertainty.standard_error, 0)
    along = uncertainty.correlation[:, place] * errors / max(float(errors[place]), TINY)
    along[place] = 1.0
    # Chi-square is about the number of residuals, a million at 640 x 480 pixels, of which a decrease of 1e-10 is 1e-4.
    method = LevenbergMarquardt(max_steps, relative=1e-7, decrease=1e-10)

    # Go outwards on each side. Twice the rise of the cost, in units of the noise, is chi-square.
    points = {0.0: (estimate, 0.0)}
    for side in (-1, 1):
        values = estimate
        # Six points, half a standard error apart. A root of the profile that bends like x + c x^2, in standard errors,
        # is off by at most c/16 between two of them, where it is taken for straight.
        for step in side * 0.5 * np.arange(1, 7):
            recorder.phase(f"profile of {name}, {step:+.2g} standard errors")
            guess = problem.y_of(values + along * (estimate[place] + step * error - values[place]))
            least = levenberg_marquardt(problem, guess, solution.stage, method=method, held=[place])
            values, rise = problem.values(least.y), least.linearization.cost - solution.linearization.cost
            points[float(step)] = values, 2 * rise / uncertainty.sigma**2
    # Put both sides together, from the lowest value to the highest.
    ordered = [points[step] for step in sorted(points)]
    value = np.array([values[place] for values, _ in ordered])
    chi_square = np.array([square for _, square in ordered])
    others = np.stack([values for values, _ in ordered], axis=1)
    return Profile(name, value, chi_square, others, interval(value, chi_square))


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
