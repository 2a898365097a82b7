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
from raytrace_jax.inverse.judge.uncertainty import Certainty
from raytrace_jax.inverse.solve.last_level import Finished

ROUNDS = 5
"""How often the picture is made linear anew, at most."""

CLOSE = 0.1
"""A round that moves the mean by less than this share of the spread is the last."""

REACH = 6.0
"""Standard errors of the least squares from their estimate within which the set is looked for."""

MOST_VIOLATED = 1e-3
"""Share of the stored numbers that no parameters need to meet: pixels that an edge crosses, where programs differ."""

TOLERANCE = 1e-6
"""Share of half an interval by which a colour may lie outside: two programs do not round alike."""

ROOM = 1e-4
"""Standard errors around some point that the half spaces must leave, lest what they leave is a point."""

REWEIGHTINGS, LEAST_VIOLATION = 5, 0.01
"""Of violations, and below how many halves of an interval they all count the same."""

CHAINS, STEPS, STAGES = 50, 150, 4
"""Of the random walk, steps for each parameter: enough to know the mean to a few hundredths of the spread. Each stage
takes the lengths and directions of its steps from the one before."""

HalfSpaces = tuple[Float[np.ndarray, "rows parameters"], Float[np.ndarray, " rows"]]
"""Rows `a` and bounds `b` of `a x <= b`."""


def feasible(end: Finished, sure: Certainty, intervals: Intervals) -> tuple[Finished, Certainty] | None:
    """The mean of the feasible set near the end of a fit to a point-sampled target, and the set's spread as its errors.

    Args:
        end: where least squares ended.
        sure: how sure their estimate is.
        intervals: between which colours each number of the target was.

    Returns:
        The end there, and how sure it is; None if there is no such set, since more than rounding separates the target
        from the picture.
    """
    if not np.all(np.isfinite(sure.standard_error)) or not np.all(sure.standard_error > 0):
        return None
    problem = end.problem
    y = np.asarray(end.y, np.float64)
    unit = sure.standard_error / problem.slopes(end.y)
    for _ in range(ROUNDS):
        try:
            a, b = half_spaces(end, intervals, unit)
            points = random_walk(a, b, interior_point(a, b))
        except np.linalg.LinAlgError:
            return None
        center, spread = points.mean(axis=1), np.atleast_2d(np.cov(points))
        if np.max(np.abs(points)) > REACH - 1:
            return None
        y = y + unit * center
        found = problem.linearize(problem.array(y), end.measure)
        end = dataclasses.replace(end, y=problem.array(y), found=found)
        if np.max(np.abs(center) / np.sqrt(np.diagonal(spread))) < CLOSE:
            errors = np.sqrt(np.diagonal(spread))
            certain = dataclasses.replace(
                sure, standard_error=errors * sure.standard_error, correlation=spread / np.outer(errors, errors)
            )
            return end, certain
    return None


def half_spaces(end: Finished, intervals: Intervals, unit: Float[np.ndarray, " parameters"]) -> HalfSpaces:
    """What the stored numbers say of a small step, in units of each unknown, and the reach as a box around it.

    A number is left out where no step within reach meets its interval, or where few numbers stand against all others;
    raises LinAlgError if these are too many.
    """
    found, weight = end.found, np.asarray(end.problem.observation.root_weight, np.float64)
    counts = weight > 0
    scale = unit[:, None, None, None] / np.where(counts, weight, 1)
    rows, image = np.asarray(found.columns, np.float64) * scale * counts, np.asarray(found.image, np.float64)
    lower, upper = intervals
    half = float(np.median((upper - lower)[np.isfinite(upper - lower)])) / 2
    rows, low, high = rows / half, (lower - image) / half, (upper - image) / half
    tolerance = max(TOLERANCE, 20 * float(np.finfo(found.image.dtype).eps) / half)
    change = REACH * np.abs(rows).sum(0)
    matters = change > 0
    never = matters & ((high < -change) | (low > change))
    sides = [
        (sign * rows[:, near].T, sign * bound[near] + tolerance)
        for sign, bound in ((1.0, high), (-1.0, low))
        for near in [matters & ~never & (sign * bound < change)]
    ]
    a, b = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    # A linear program takes long where nothing fits.
    most = MOST_VIOLATED * np.sum(matters)
    narrower = b - ROOM * np.linalg.norm(a, axis=1)
    violated = violations(a, narrower) if np.sum(never) <= most else np.zeros(len(b), bool)
    if np.sum(never) + np.sum(violated) > most:
        raise np.linalg.LinAlgError("more than rounding separates the target from the picture")
    box = np.eye(len(unit))
    return np.concatenate([a[~violated], box, -box]), np.r_[b[~violated], np.full(2 * len(unit), REACH)]


def violations(a: Float[np.ndarray, "rows parameters"], b: Float[np.ndarray, " rows"]) -> Bool[np.ndarray, " rows"]:
    """The half spaces that a point lies outside of that lies outside of few, however far.

    The least sum of violations is found again with weights that count violations rather than add them up (reweighted
    l1 minimisation; Candes, Wakin and Boyd 2008).
    """
    count, parameters = a.shape
    rows = sparse.csr_array(sparse.hstack([sparse.csr_array(a), -sparse.eye_array(count)]))
    bounds = [(-REACH, REACH)] * parameters + [(0, None)] * count
    weight, violated = np.ones(count), np.ones(count, bool)
    for _ in range(REWEIGHTINGS):
        point = linear_program(np.r_[np.zeros(parameters), weight], rows, b, bounds)[:parameters]
        excess, last = a @ point - b, violated
        violated = excess > TOLERANCE
        if np.array_equal(violated, last):
            break
        weight = 1 / (np.maximum(excess, 0) + LEAST_VIOLATION)
    return violated


def interior_point(
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


def random_walk(
    a: Float[np.ndarray, "rows parameters"], b: Float[np.ndarray, " rows"], inside: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, "parameters points"]:
    """Points spread evenly over the polytope of half spaces, by hit-and-run from a point inside (Smith 1984)."""
    unbounded = [(None, None)] * len(inside)
    ends = [linear_program(side, a, b, unbounded) for sign in (1, -1) for side in sign * np.eye(len(inside))]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    # Most half spaces hold in all of this box: they bound nothing.
    size = np.abs(a) @ (high - low)
    bounding = a @ (low + high) / 2 + size / 2 > b - 1e-6 * size
    a, b = a[bounding], b[bounding]
    random, lengths = np.random.default_rng(0), np.diag(high - low)
    walkers = np.repeat(inside[:, None], CHAINS, axis=1)
    path = np.empty((0,))
    for _ in range(STAGES):
        steps = []
        for _ in range(STEPS * len(inside)):
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
