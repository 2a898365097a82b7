"""Which change of a picture a residual looks like: tests of one change at a time, measured by the residual itself."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from raytrace_jax.util.numerics import TINY

TINY_SHARE = 1e-6
"""What is left of 1, of shares and of degrees of freedom, where one square is all."""

LARGEST_RATIO = 1e100
"""Of an amount to its spread: Student's distribution is computed up to there."""

LEAST_LEFT = 1e-6
"""A change of which less than this share is no change by a free parameter looks like one of these: nothing tells it."""


class Rows(NamedTuple):
    """Numbers of some pixels, as rows of a least-squares problem.

    Args:
        residual: the weighted residuals.
        evidence: the same, 0 where one says nothing.
        weight: what each counts: the loss's weight, over the chance that the pixel had to be looked at.
        square: in which square of pixels each is; those of one may err together.
    """

    residual: Float[np.ndarray, " rows"]
    evidence: Float[np.ndarray, " rows"]
    weight: Float[np.ndarray, " rows"]
    square: Int[np.ndarray, " rows"]


class Scores(NamedTuple):
    """How well each of some changes explains a residual.

    Args:
        score: its standard score, signed: noise alone makes about 1; 37 at most, where chance is less than 1e-300.
        amount: how much of the change the residual holds.
        gain: by how much the weighted sum of squares falls with it.
    """

    score: Float[np.ndarray, " changes"]
    amount: Float[np.ndarray, " changes"]
    gain: Float[np.ndarray, " changes"]


def score_changes(
    rows: Rows,
    free: Float[np.ndarray, "parameters rows"],
    changes: Float[np.ndarray, "changes rows"],
    least_left: Float[np.ndarray, " changes"] | float = LEAST_LEFT,
) -> Scores:
    """Score changes of a picture, as far as no free parameter makes up for them.

    The amount of a change is that of least squares, its spread that of what it leaves, summed over squares of pixels
    (the sandwich: White 1980), each over one less its share in the change, so that a few squares that decide do not
    seem to agree with themselves (the jackknife: MacKinnon and White 1985). So it holds for noise of any distribution
    and unequal in size. The ratio follows Student's distribution, with as many degrees of freedom as squares decide,
    and is told as the score of a normal one.

    Args:
        rows: the residual.
        free: the changes by the free parameters, and others that are granted.
        changes: those that are tested.
        least_left: the share of a change, in squares, that no free parameter has to make up for, or nothing is told.
    """
    rest = orthogonal_to(free, changes, rows.weight)
    by_square = square_totals(rest * rest * rows.weight, rows.square)
    left = by_square.sum(axis=1)
    is_seen = left > least_left * np.sum(changes * changes * rows.weight, axis=1)
    length = np.where(is_seen, left, 1.0)[:, None]
    share = by_square / length

    products = square_totals(rest * (rows.weight * rows.evidence), rows.square)
    evident = products.sum(axis=1, keepdims=True) / length
    errors = (products - evident * by_square) / np.maximum(1 - share, TINY_SHARE)
    spread = np.maximum(np.sqrt(np.sum(errors**2, axis=1)), TINY)
    freedom = np.maximum(1 / np.maximum(np.sum(share**2, axis=1), TINY) - 1, TINY_SHARE)
    # What only one square sees has no spread: its ratio has no end, and says nothing.
    ratio = np.minimum(np.abs(products.sum(axis=1)) / spread, LARGEST_RATIO)
    chance = stats.t.sf(ratio, freedom)
    score = np.sign(evident[:, 0]) * stats.norm.isf(np.maximum(chance, TINY))

    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / length[:, 0], 0.0)
    return Scores(np.where(is_seen & products.any(axis=1), score, 0.0), amount, amount * in_all)


def orthogonal_to(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "changes rows"]:
    """What is left of changes when the free parameters have been fitted to them."""
    return changes - fitted(free, changes, weight).T @ free


def fitted(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "parameters changes"]:
    """`(J^T W J)^-1 J^T W` of changes, J the derivatives by the free parameters; nothing where these are open."""
    pulled = free * weight
    return solve_normal(pulled @ free.T, pulled @ changes.T)


def solve_normal(normal: Float[np.ndarray, "parameters parameters"], right: Float[np.ndarray, "parameters *changes"]):
    """The solution of normal equations in columns of length one; nothing along what these leave open."""
    length = np.sqrt(np.maximum(np.diagonal(normal), 0))
    length = np.where(length > 0, length, 1.0)
    by_row = length.reshape(-1, *[1] * (right.ndim - 1))
    return np.linalg.lstsq(normal / np.outer(length, length), right / by_row, rcond=1e-12)[0] / by_row


def square_totals(
    products: Float[np.ndarray, "changes rows"], square: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "changes squares"]:
    """Sums over the rows of each square."""
    if not square.size:
        return np.zeros((len(products), 1))
    order = np.argsort(square, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(square[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)
