"""Whether one picture explains a target better than another."""

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.squares import square_sums

BLOCK = 8
"""Side in pixels of the squares within which errors may go together: that of a JPEG's blocks."""

EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


def vuong_evidence(better: Float[np.ndarray, "3 height width"], other: Float[np.ndarray, "3 height width"]) -> float:
    """By how many standard errors one picture explains a target better than another (after Vuong 1989).

    The sums of squares differ by `2 better (other - better)`, which is as likely to help as to harm if both are equally
    good, and `(other - better)^2`. The scatter of the first, over squares of pixels since neighbours err together, is
    the measure; that of the second, which grows with the pictures' difference, would hide a clear one.

    Args:
        better, other: residuals of both, weighted and under the loss.
    """
    gain = float(np.sum(other**2 - better**2))
    chance = float(np.linalg.norm(square_sums(2 * better * (other - better), BLOCK).sum(0)))
    return gain / chance if chance > 0 else float(np.inf if gain > 0 else 0)
