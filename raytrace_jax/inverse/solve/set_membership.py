"""The estimate from a target that was stored in 8 or 16 bits: the mean of all values that give its stored numbers.

Storing a picture is not noise. Each stored number says for certain between which two colours its pixel lay, and what
all of them say together bounds the parameters far more closely than the mean of as many independent errors: with n
numbers to 1/n, where least squares know them to 1/sqrt(n). The values that meet all intervals are the feasible set of
set-membership estimation (Milanese and Vicino 1991): a polytope, as the picture is linear over so small a change. With
nothing else known the parameters are spread evenly over it.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse
from scipy.optimize import linprog

from raytrace_jax.images.quantization import Intervals
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.statistics.uncertainty import Uncertainty


@dataclasses.dataclass(frozen=True)
class FeasibleSetPlan:
    """How the feasible set is looked for. What other values do was measured on two scenes (experiments/tuning).

    Args:
        most_rounds: how often the picture is made linear anew. Of the stored pictures that are recognised two rounds
            lose half or more, three none, and ten find no more.
        close: a round that moves the mean by less than this share of the spread is the last: it adds less than a
            hundredth to the error, squared. Half and double do the same.
        reach: standard errors of the least squares from their estimate within which the set is looked for. With 3 one
            set of six is missed on one scene and six of seven on another; 12 finds the same ones as 6.
        end_of_reach: a set that comes nearer than so many standard errors to the end of this reach may go on beyond it:
            it is refused. Half and double do the same.
        most_violated: share of the stored numbers that no parameters need to meet: pixels that an edge crosses, where
            programs differ. Of small pictures they are more at times: at 120 x 90 pixels 5e-4 recognises 10 of 16, 1e-3
            13 and 2e-3 14.
        outside: share of half an interval by which a colour may lie outside, since two programs do not round alike.
            1e-8 does the same, 1e-4 lets estimates be far off.
        outside_roundings: by so many roundings of the dtype a colour may lie outside in any case.
        least_room: radius, in standard errors, of a ball that must fit between the half spaces, lest what they leave is
            a point. A tenth and ten times of it do the same.
        violated: how far outside of a half space a point must lie to violate it: ten times what a linear program is
            solved to. 1e-7 and 1e-5 do the same.
        most_counts: how often violations are counted anew. Half and double do the same.
        small_violation: violations below this size all count the same: far above `violated`, and far below those that
            are worth telling, which are of the order of 1. Half and double do the same.
        barely: a half space that holds in all of a box but this share of its size may bound the polytope in it, for
            rounding. 1e-8 and 1e-4 do the same.
        chains: walkers of the random walk. Half or double of this and of the next two gives the same errors and error
            bars.
        steps: steps of a stage, for each parameter: enough to know the mean to a few hundredths of the spread.
        stages: stages of the walk; each takes the lengths and directions of its steps from the one before.
    """

    most_rounds: int = 5
    close: float = 0.1
    reach: float = 6.0
    end_of_reach: float = 1.0
    most_violated: float = 1e-3
    outside: float = 1e-6
    outside_roundings: int = 20
    least_room: float = 1e-4
    violated: float = 1e-6
    most_counts: int = 5
    small_violation: float = 0.01
    barely: float = 1e-6
    chains: int = 50
    steps: int = 150
    stages: int = 4


FEASIBLE = FeasibleSetPlan()


HalfSpaces = tuple[Float[np.ndarray, "rows parameters"], Float[np.ndarray, " rows"]]
"""Rows `a` and bounds `b` of `a x <= b`."""


def violations(
    a: Float[np.ndarray, "rows parameters"], b: Float[np.ndarray, " rows"], reach: float
) -> Bool[np.ndarray, " rows"]:
    """The fewest half spaces, or nearly, without which the others have a point in common.

    A linear program finds the point with the least sum of violations. Weights of one over each violation's size then
    make the sum count violations rather than add them up, and it is solved again (reweighted l1 minimisation; Candes,
    Wakin and Boyd 2008).

    Args:
        a, b: the half spaces.
        reach: how far from the origin the point may lie in each coordinate.
    """
    count, parameters = a.shape
    rows = sparse.csr_array(sparse.hstack([sparse.csr_array(a), -sparse.eye_array(count)]))
    bounds = [(-reach, reach)] * parameters + [(0, None)] * count
    weight, violated = np.ones(count), np.ones(count, bool)
    for _ in range(FEASIBLE.most_counts):
        point = linear_program(np.r_[np.zeros(parameters), weight], rows, b, bounds)[:parameters]
        excess, last = a @ point - b, violated
        violated = excess > FEASIBLE.violated
        if np.array_equal(violated, last):
            break
        weight = 1 / (np.maximum(excess, 0) + FEASIBLE.small_violation)
    return violated


def chebyshev_center(
    a: Float[np.ndarray, "rows parameters"], b: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " parameters"]:
    """The center of the largest ball within half spaces; raises LinAlgError if there is no room."""
    parameters = a.shape[1]
    rows = np.c_[a, np.linalg.norm(a, axis=1)]
    solved = linear_program(np.r_[np.zeros(parameters), -1], rows, b, [(None, None)] * parameters + [(0, None)])
    if solved[-1] <= 0:
        raise np.linalg.LinAlgError("the half spaces touch in one point")
    return solved[:-1]


def linear_program(cost: np.ndarray, rows: np.ndarray | sparse.csr_array, b: np.ndarray, bounds: list) -> np.ndarray:
    """The `x` with the least `cost x` that meets `rows x <= b` and the bounds; raises LinAlgError if there is none."""
    solved = linprog(cost, A_ub=rows, b_ub=b, bounds=bounds)
    if not solved.success:
        raise np.linalg.LinAlgError(solved.message)
    return solved.x


def hit_and_run(
    a: Float[np.ndarray, "rows parameters"],
    b: Float[np.ndarray, " rows"],
    inside: Float[np.ndarray, " parameters"],
    seed: int = 0,
) -> Float[np.ndarray, "parameters points"]:
    """Points spread evenly over the polytope of half spaces, by hit-and-run from a point inside (Smith 1984).

    Each step draws a direction and moves to a point drawn evenly from the chord through the polytope along it. From
    either end the same chord and the same density lead to the other, so that the even distribution stays as it is, and
    walkers tend to it from anywhere. Directions with the polytope's own covariance keep steps long in a narrow one.

    Args:
        a, b: the half spaces.
        inside: where all walkers start.
        seed: of the random numbers.

    Returns:
        The last stage's points: `FEASIBLE.chains` of each step, step after step.
    """
    unbounded = [(None, None)] * len(inside)
    ends = [linear_program(side, a, b, unbounded) for sign in (1, -1) for side in sign * np.eye(len(inside))]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    # Most half spaces hold in all of this box, around the polytope: they bound nothing.
    size = np.abs(a) @ (high - low)
    bounding = a @ (low + high) / 2 + size / 2 > b - FEASIBLE.barely * size
    a, b = a[bounding], b[bounding]
    random, lengths = np.random.default_rng(seed), np.diag(high - low)
    walkers = np.repeat(inside[:, None], FEASIBLE.chains, axis=1)
    path = np.empty((0,))
    for _ in range(FEASIBLE.stages):
        # Directions have the shape of the box in the first stage, then that of the path of the stage before.
        steps = []
        for _ in range(FEASIBLE.steps * len(inside)):
            along = lengths @ random.standard_normal(walkers.shape)
            speed, room = a @ along, np.maximum(b[:, None] - a @ walkers, 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                reached = np.where(speed == 0, np.inf, room / np.abs(speed))
            forth = np.min(np.where(speed > 0, reached, np.inf), axis=0)
            back = np.min(np.where(speed < 0, reached, np.inf), axis=0)
            walkers = walkers + along * random.uniform(-back, forth)
            steps.append(walkers)
        path = np.concatenate(steps, axis=1)
        lengths = np.linalg.cholesky(np.atleast_2d(np.cov(path)))
    return path


def central_estimate(
    solution: FitState, uncertainty: Uncertainty, intervals: Intervals
) -> tuple[FitState, Uncertainty] | None:
    """The mean of the feasible set near the end of a fit to a point-sampled target, and the set's spread as its errors.

    Args:
        solution: where least squares ended.
        uncertainty: how sure their estimate is.
        intervals: between which colours each number of the target was.

    Returns:
        The solution there, and how sure it is; None if there is no such set, because more than rounding separates the
        target from the picture.
    """
    errors = uncertainty.standard_error
    if not np.all(np.isfinite(errors)) or not np.all(errors > 0):
        return None
    problem = solution.problem
    y = np.asarray(solution.y, np.float64)
    unit = errors / problem.slopes(solution.y)
    # The picture is linear only over a small change: the set is found anew from each mean, until that stays.
    for _ in range(FEASIBLE.most_rounds):
        try:
            a, b = half_spaces(solution, intervals, unit)
            points = hit_and_run(a, b, chebyshev_center(a, b))
        except np.linalg.LinAlgError:
            return None
        center, covariance = points.mean(axis=1), np.atleast_2d(np.cov(points))
        if np.max(np.abs(points)) > FEASIBLE.reach - FEASIBLE.end_of_reach:
            return None
        y = y + unit * center
        linearization = problem.linearize(problem.array(y), solution.comparison)
        solution = dataclasses.replace(solution, y=problem.array(y), linearization=linearization)
        spread = np.sqrt(np.diagonal(covariance))
        if np.max(np.abs(center) / spread) < FEASIBLE.close:
            covariance = covariance * np.outer(errors, errors)
            return solution, dataclasses.replace(uncertainty, standard_error=spread * errors, covariance=covariance)
    return None


def half_spaces(solution: FitState, intervals: Intervals, unit: Float[np.ndarray, " parameters"]) -> HalfSpaces:
    """What the stored numbers say of a small step, in units of each unknown, and the reach as a box around it.

    A number is left out if no step within reach meets its interval, or if it is one of the few that stand against all
    others. Raises LinAlgError if these are too many.
    """
    # The picture and its change by a unit of each unknown, in units of half an interval.
    linearization = solution.linearization
    weight = np.asarray(solution.problem.observation.root_weight, np.float64)
    counts = weight > 0
    scale = unit[:, None, None, None] / np.where(counts, weight, 1)
    rows = np.asarray(linearization.columns, np.float64) * scale * counts
    image = np.asarray(linearization.image, np.float64)
    lower, upper = intervals
    half = float(np.median((upper - lower)[np.isfinite(upper - lower)])) / 2
    rows, low, high = rows / half, (lower - image) / half, (upper - image) / half
    tolerance = max(
        FEASIBLE.outside, FEASIBLE.outside_roundings * float(np.finfo(linearization.image.dtype).eps) / half
    )
    # Set aside the numbers that no step changes, and those that no step within reach brings into their interval. Keep
    # the half spaces that reach across the box.
    change = FEASIBLE.reach * np.abs(rows).sum(0)
    matters = change > 0
    never = matters & ((high < -change) | (low > change))
    sides = [
        (sign * rows[:, near].T, sign * bound[near] + tolerance)
        for sign, bound in ((1.0, high), (-1.0, low))
        for near in [matters & ~never & (sign * bound < change)]
    ]
    a, b = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    # Find those that stand against all others, which must leave some room. Do not look if too many fail already: a
    # linear program takes long where nothing fits.
    most = FEASIBLE.most_violated * np.sum(matters)
    narrower = b - FEASIBLE.least_room * np.linalg.norm(a, axis=1)
    violated = violations(a, narrower, FEASIBLE.reach) if np.sum(never) <= most else np.zeros(len(b), bool)
    if np.sum(never) + np.sum(violated) > most:
        raise np.linalg.LinAlgError("more than rounding separates the target from the picture")
    box = np.eye(len(unit))
    return np.concatenate([a[~violated], box, -box]), np.r_[b[~violated], np.full(2 * len(unit), FEASIBLE.reach)]
