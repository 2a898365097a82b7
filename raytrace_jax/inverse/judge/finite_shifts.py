"""How far an estimate moves when the picture changes by more than the loss takes at its word."""

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.change_scores import fitted, solve_normal
from raytrace_jax.inverse.problem.comparison import Comparison, evaluate

SMALL = 0.1
"""Of the loss's scale: residuals that change by less pull in proportion to the change, but for a hundredth."""

SMALLEST = 1e-6
"""Of the loss's scale: of less a secant is rounding, and the weight does."""

ROUNDS = 12
"""Halfway to the next guess each, so that a thousandth of the first one's error is left."""


def finite_shifts(
    comparison: Comparison,
    residual: Float[np.ndarray, " rows"],
    counts: Float[np.ndarray, " rows"],
    free: Float[np.ndarray, "parameters rows"],
    changes: Float[np.ndarray, "changes rows"],
) -> Float[np.ndarray, "parameters changes"]:
    """By how much the estimate moves with changes of the residual as large as they are.

    A robust loss does not follow what is much larger than its scale: a few pixels at the rim of glass that decide where
    a change is small do not where it is large. So the weight of each residual is the secant of the loss's pull over
    the change that it undergoes once the estimate has moved, of either sign; the two are found in turns.

    Args:
        comparison: whose loss it is.
        residual: at the estimate.
        counts: how much each residual counts besides the loss.
        free: the residual's derivatives by the free parameters.
        changes: of the residual, before the estimate moves.
    """
    weight = evaluate(comparison.loss, "weight", residual, comparison.loss_scale) * counts
    shifts = -fitted(free, changes, weight)
    large = np.max(np.abs(changes), axis=0, initial=0) > SMALL * comparison.loss_scale
    if comparison.loss == "l2" or not large.any():
        return shifts

    # What the others contribute to the normal equations stays as it is.
    rest = free[:, ~large] * weight[~large]
    normal, right = rest @ free[:, ~large].T, rest @ changes[:, ~large].T
    free, changes, counts = free[:, large], changes[:, large], counts[large]
    still = weight[large] / counts
    for _ in range(ROUNDS):
        moved = changes + shifts.T @ free
        both = np.stack([residual[large] + moved, residual[large] - moved])
        ahead, behind = evaluate(comparison.loss, "score", both, comparison.loss_scale)
        is_moved = np.abs(moved) > SMALLEST * comparison.loss_scale
        secant = np.where(is_moved, (ahead - behind) / np.where(is_moved, 2 * moved, 1), still)
        # A loss that falls off may pull less after a change than before: that is no weight.
        secant = np.maximum(secant, 0) * counts
        for k, each in enumerate(secant):
            pulled = free * each
            shifts[:, k] -= (
                shifts[:, k] + solve_normal(normal + pulled @ free.T, right[:, k] + pulled @ changes[k])
            ) / 2
    return shifts
