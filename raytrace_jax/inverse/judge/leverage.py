"""What a few residuals that decide an estimate hide of their own errors."""

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.change_scores import solve_normal

SMALL = 0.01
"""Leverages below this shrink a residual by less than a hundredth."""

LARGEST = 1 - 1e-6
"""Of a leverage: a residual that alone decides a number is 0 but for rounding, and tells nothing of its error."""


def hidden_scatter(
    columns: Float[np.ndarray, "parameters rows"],
    weight: Float[np.ndarray, " rows"],
    score: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "parameters parameters"]:
    """What the sum over residuals of their pulls' outer products lacks.

    An estimate follows a residual by its leverage h and leaves 1 - h of its error to be seen, so the pull that it would
    have on an estimate made without it is 1 / (1 - h) times what is seen (the jackknife: MacKinnon and White 1985). Of
    a picture of many pixels nothing is hidden, but at the rim of glass one pixel may decide.

    Args:
        columns: derivative of the residuals.
        weight: of each in the estimate.
        score: how hard each pulls.
    """
    leverage = leverages(columns, weight)
    decides = leverage > SMALL
    left = 1 - np.minimum(leverage[decides], LARGEST)
    hidden = score[decides] ** 2 * (1 / left**2 - 1)
    return (columns[:, decides] * hidden) @ columns[:, decides].T


def leverages(
    columns: Float[np.ndarray, "parameters rows"], weight: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """How far the fit follows each residual: 0 is not at all, 1 wherever it goes."""
    pulled = columns * weight
    return np.sum(pulled * solve_normal(pulled @ columns.T, columns), axis=0)
