"""What changes of a picture mean for a fit: whether the residual holds one, and how far one moves the estimate."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from raytrace_jax.util.numerics import TINY, solve_normal

TINY_SHARE = 1e-6
"""Least value of one minus a square's share, and of degrees of freedom, where one square is all that sees a change."""

LEAST_LEFT = 1e-6
"""Least share of a change that the free parameters must leave; a change of which less is left cannot be told apart from
theirs."""


class Rows(NamedTuple):
    """Numbers of some pixels, as rows of a least-squares problem.

    Args:
        residual: the weighted residuals.
        evidence: the weighted residuals, but 0 where one says nothing.
        weight: what each counts: the loss's weight over the pixel's chance to be looked at.
        square: number of the square of pixels in which each is; the rows of one square may err together.
    """

    residual: Float[np.ndarray, " rows"]
    evidence: Float[np.ndarray, " rows"]
    weight: Float[np.ndarray, " rows"]
    square: Int[np.ndarray, " rows"]


class Scores(NamedTuple):
    """How well each of some changes explains a residual.

    Args:
        score: its standard score with a sign. Noise alone makes about 1; the largest is 37, where chance is below
            1e-300.
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

    The amount of a change is found by least squares. Its spread comes from what the change leaves of the residual,
    summed by squares of pixels (the sandwich: White 1980), so that it holds for noise of any distribution and unequal
    in size. What a square leaves is divided by one minus the square's share in the change: otherwise a few squares that
    decide would seem to agree with themselves (the jackknife: MacKinnon and White 1985). Amount over spread follows
    Student's distribution with as many degrees of freedom as squares decide, less one. The score is the value of a
    normal variable that chance exceeds as rarely.

    Args:
        rows: the residual.
        free: the changes by the free parameters, and others that are granted.
        changes: the changes to test.
        least_left: share of each change's sum of squares that the free parameters must leave; below it the score is 0.
    """
    # What a change leaves beside the free parameters, and how much of that each square sees.
    rest = orthogonal_to(free, changes, rows.weight)
    by_square = square_totals(rest * rest * rows.weight, rows.square)
    left = by_square.sum(axis=1)
    is_seen = left > least_left * np.sum(changes * changes * rows.weight, axis=1)
    length = np.where(is_seen, left, 1.0)[:, None]
    share = by_square / length

    # The sandwich, and the number of squares that decide, `1 / sum(share^2)`.
    products = square_totals(rest * (rows.weight * rows.evidence), rows.square)
    evident = products.sum(axis=1, keepdims=True) / length
    errors = (products - evident * by_square) / np.maximum(1 - share, TINY_SHARE)
    spread = np.maximum(np.sqrt(np.sum(errors**2, axis=1)), TINY)
    freedom = np.maximum(1 / np.maximum(np.sum(share**2, axis=1), TINY) - 1, TINY_SHARE)
    # What only one square sees has no spread, and its ratio no end. Student's distribution is computed up to 1e100.
    ratio = np.minimum(np.abs(products.sum(axis=1)) / spread, 1e100)
    chance = stats.t.sf(ratio, freedom)
    score = np.sign(evident[:, 0]) * stats.norm.isf(np.maximum(chance, TINY))

    # The amount is that of all residuals, also of those that are no evidence.
    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / length[:, 0], 0.0)
    return Scores(np.where(is_seen & products.any(axis=1), score, 0.0), amount, amount * in_all)


def orthogonal_to(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "changes rows"]:
    """What is left of changes when the free parameters have been fitted to them."""
    return changes - fitted(free, changes, weight).T @ free


def fitted(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "parameters changes"]:
    """The free parameters' least-squares fit to changes, `(J^T W J)^-1 J^T W change`, J their derivatives.

    It is 0 along directions that the derivatives leave open.
    """
    pulled = free * weight
    return solve_normal(pulled @ free.T, pulled @ changes.T)


def square_totals(
    products: Float[np.ndarray, "changes rows"], square: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "changes squares"]:
    """Sums over the rows of each square."""
    if not square.size:
        return np.zeros((len(products), 1))
    order = np.argsort(square, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(square[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)
