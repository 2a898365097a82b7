"""Which change of a picture a residual looks like: score tests (Rao 1948) that are measured by the residual itself."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from raytrace_jax.util.numerics import TINY

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
        score: its standard score: what noise alone makes about 1; infinite scores there are not.
        amount: how much of the change the residual holds.
        gain: by how much the weighted sum of squares falls with it.
    """

    score: Float[np.ndarray, " changes"]
    amount: Float[np.ndarray, " changes"]
    gain: Float[np.ndarray, " changes"]


def score_tests(
    rows: Rows, free: Float[np.ndarray, "parameters rows"], changes: Float[np.ndarray, "changes rows"]
) -> Scores:
    """Test changes of a picture, as far as no free parameter makes up for them.

    A change's score is its product with the residual over the root of the sum of squares of the products over squares
    of pixels (the sandwich: White 1980), so that it holds for noise of any distribution and unequal in size. It cannot
    exceed the root of the number of squares.
    """
    rest = orthogonal_to(free, changes, rows.weight)
    left = np.sum(rest * rest * rows.weight, axis=1)
    is_seen = left > LEAST_LEFT * np.sum(changes * changes * rows.weight, axis=1)
    products = square_totals(rest * (rows.weight * rows.evidence), rows.square)
    spread = np.sqrt(np.sum(products**2, axis=1))
    score = np.where(is_seen & (spread > 0), products.sum(axis=1) / np.where(spread > 0, spread, 1), 0.0)
    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / np.where(is_seen, left, 1), 0.0)
    return Scores(score, amount, amount * in_all)


def orthogonal_to(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "changes rows"]:
    """What is left of changes when the free parameters have been fitted to them."""
    length = np.maximum(np.sqrt(np.sum(free * free * weight, axis=1)), TINY)
    unit = free / length[:, None]
    part = np.linalg.lstsq((unit * weight) @ unit.T, (unit * weight) @ changes.T, rcond=1e-12)[0]
    return changes - part.T @ unit


def square_totals(
    products: Float[np.ndarray, "changes rows"], square: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "changes squares"]:
    """Sums over the rows of each square."""
    if not square.size:
        return np.zeros((len(products), 1))
    order = np.argsort(square, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(square[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)
