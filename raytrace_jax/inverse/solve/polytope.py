"""Polytopes of half spaces: a point inside, points spread evenly over them, and what contradicts the rest."""

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse
from scipy.optimize import linprog

VIOLATED = 1e-6
"""How far outside of a half space a point must lie to violate it: ten times what a linear program is solved to.
1e-7 and 1e-5 do the same on two scenes (experiments/tuning)."""

MOST_COUNTS, SMALL_VIOLATION = 5, 0.01
"""How often violations are counted anew, and the size below which they all count the same: far above `VIOLATED`, and
far below those that are worth telling, which are of the order of 1. Half and double of each do the same on two scenes
(experiments/tuning)."""

BARELY = 1e-6
"""A half space that holds in all of a box but this share of its size may bound the polytope in it, for rounding. 1e-8
and 1e-4 do the same on two scenes (experiments/tuning)."""

CHAINS, STEPS, STAGES = 50, 150, 4
"""Of the random walk, steps for each parameter: enough to know the mean to a few hundredths of the spread. Each stage
takes the lengths and directions of its steps from the one before. Half or double of each gives the same errors and
error bars (experiments/tuning)."""

HalfSpaces = tuple[Float[np.ndarray, "rows parameters"], Float[np.ndarray, " rows"]]
"""Rows `a` and bounds `b` of `a x <= b`."""


def violations(
    a: Float[np.ndarray, "rows parameters"], b: Float[np.ndarray, " rows"], reach: float
) -> Bool[np.ndarray, " rows"]:
    """The half spaces that a point lies outside of that lies outside of few, however far.

    The least sum of violations is found again with weights that count violations rather than add them up (reweighted
    l1 minimisation; Candes, Wakin and Boyd 2008).

    Args:
        a, b: the half spaces.
        reach: how far from the origin the point may lie in each coordinate.
    """
    count, parameters = a.shape
    rows = sparse.csr_array(sparse.hstack([sparse.csr_array(a), -sparse.eye_array(count)]))
    bounds = [(-reach, reach)] * parameters + [(0, None)] * count
    weight, violated = np.ones(count), np.ones(count, bool)
    for _ in range(MOST_COUNTS):
        point = linear_program(np.r_[np.zeros(parameters), weight], rows, b, bounds)[:parameters]
        excess, last = a @ point - b, violated
        violated = excess > VIOLATED
        if np.array_equal(violated, last):
            break
        weight = 1 / (np.maximum(excess, 0) + SMALL_VIOLATION)
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

    Args:
        a, b: the half spaces.
        inside: where all walkers start.
        seed: of the random numbers.

    Returns:
        The last stage's points: `CHAINS` of each step, step after step.
    """
    unbounded = [(None, None)] * len(inside)
    ends = [linear_program(side, a, b, unbounded) for sign in (1, -1) for side in sign * np.eye(len(inside))]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    # Most half spaces hold in all of this box: they bound nothing.
    size = np.abs(a) @ (high - low)
    bounding = a @ (low + high) / 2 + size / 2 > b - BARELY * size
    a, b = a[bounding], b[bounding]
    random, lengths = np.random.default_rng(seed), np.diag(high - low)
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
