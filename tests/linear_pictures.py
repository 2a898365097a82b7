"""Noisy pictures that are linear in three numbers, and what `quantify_uncertainty` says of them."""

import dataclasses

import numpy as np
from linear_fit import linear_names, linear_problem
from scipy import ndimage

from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.problem import FitState

SIZE = (64, 80)
SIGMA = 0.02
A, B, C = linear_names(3)
POINT = Stage("point")


def smooth_columns():
    """Derivatives as pictures have them: neighbours are alike, parameters are correlated."""
    # A stream of its own: noise drawn as the columns are would lie along them.
    columns = np.random.default_rng([0, 2]).normal(size=(3, 3, *SIZE))
    columns = ndimage.gaussian_filter(columns, (0, 0, 4, 4))
    columns /= columns.std(axis=(1, 2, 3), keepdims=True)
    columns[1:] += 0.6 * columns[:1]
    return columns


COLUMNS = smooth_columns()
TRUTH = np.array([0.3, -0.2, 0.5])
ROWS = COLUMNS.reshape(3, -1).T
PSEUDO_INVERSE = np.linalg.pinv(ROWS)
TEXTBOOK = SIGMA * np.sqrt(np.diag(np.linalg.inv(ROWS.T @ ROWS)))
"""Standard errors under white noise."""


def picture(values, columns=COLUMNS):
    return np.tensordot(values, columns, 1)


def state_at(problem, y=None, stage=POINT, settled=True):
    """The state of a fit at unknowns, or at the start."""
    state = FitState.at(problem, problem.start() if y is None else problem.array(y), stage)
    return dataclasses.replace(state, settled=settled)


def judged(noise, stage=POINT, sigma=None, values=None, columns=COLUMNS, **options):
    """How sure the least-squares estimate, or given values, of a picture with such noise are."""
    truth = np.resize(TRUTH, len(columns))
    target = picture(truth, columns) + noise
    if values is None:
        rows = columns.reshape(len(columns), -1).T
        length = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)  # Whatever the units are.
        values = np.linalg.lstsq(rows / length, target.reshape(-1), rcond=1e-12)[0] / length
    problem = linear_problem(columns, target, **options)
    y = problem.y_of(values)
    return quantify_uncertainty(state_at(problem, y, stage), sigma)


def white(seed=0):
    return SIGMA * np.random.default_rng(seed).normal(size=(3, *SIZE))
