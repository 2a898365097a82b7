"""Two opinions on one index, of corners and of light, side by side."""

import numpy as np

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.photo.bundle import BALL
from raytrace_jax.photo.cameras import LENS
from raytrace_jax.photo.locate import Located

AGREE = 3.0
"""Corners and light may differ by so many of their errors."""


def told(located: Located) -> dict[str, object]:
    """What the corners say, as plain values."""
    names = ["turn.x", "turn.y", "turn.z", "shift.x", "shift.y", "shift.z"]
    names += ["fov", "k1", "k2", "principal_point.x", "principal_point.y"]
    names += ["index", "center.x", "center.y", "center.z", "radius"]
    sure = np.sqrt(np.diagonal(located.covariance))
    chosen = [*range(BALL.start, BALL.stop), *range(LENS.start, LENS.stop)]
    return {
        "parameters": {names[k]: {"value": float(located.numbers[k]), "error": float(sure[k])} for k in chosen},
        "names": names,
        "numbers": located.numbers.tolist(),
        "covariance": located.covariance.tolist(),
        "corners": {"direct": len(located.direct.pixels), "through": len(located.through.pixels)},
        "scatter": {"direct": located.sigma[0], "through": located.sigma[1]},
        "blur": located.blur,
        "size": list(located.size),
    }


def apart(located: Located, result: FitResult) -> float:
    """The difference of the fit's index and the corners', in errors.

    Both rest on the same camera and radius, whose part of the errors they have in common: what they may differ by is
    the corners' own part and the noise and structure of the fit.
    """
    index, error = located.index
    own = float(np.hypot(error, result["ball.ior"].error))
    return abs(result["ball.ior"].value - index) / own
