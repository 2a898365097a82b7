"""What corners say of an index, and what the light says, side by side."""

from collections.abc import Sequence

import numpy as np

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.photo.budget import budget
from raytrace_jax.photo.bundle import BALL, OWN
from raytrace_jax.photo.cameras import LENS
from raytrace_jax.photo.locate import Located, Together

AGREE = 3.0
"""Corners and light may differ by so many of their errors."""


NAMES = (
    *("turn.x", "turn.y", "turn.z", "shift.x", "shift.y", "shift.z"),
    *("fov", "k1", "k2", "principal_point.x", "principal_point.y"),
    *("index", "center.x", "center.y", "center.z", "radius"),
)
"""The numbers of a photograph, as `photo.bundle` has them."""


def told(located: Located) -> dict[str, object]:
    """What the corners of a photograph say, as plain values."""
    return {
        "parameters": _parameters(located, [*range(BALL.start, BALL.stop), *range(LENS.start, LENS.stop)]),
        "names": list(NAMES),
        "numbers": located.numbers.tolist(),
        "covariance": located.covariance.tolist(),
        "corners": {"direct": len(located.direct.pixels), "through": len(located.through.pixels)},
        "scatter": {"direct": located.sigma[0], "through": located.sigma[1]},
        "blur": located.blur,
        "size": list(located.size),
    }


def told_together(together: Together, names: Sequence[str]) -> dict[str, object]:
    """What the corners of photographs with these names say, as plain values; a single one says what `told` has."""
    assert together.adjusted is not None, "a ball is found"
    parts = budget(together.adjusted)
    made_of: dict[str, object] = {"budget": parts._asdict() | {"advice": parts.advice}}
    if len(names) == 1:
        return told(together.located[0]) | made_of
    order = [names[k] for k in (*together.located, *together.bare)]
    first, own = next(iter(together.located.values())), [NAMES[k] for k in OWN]
    photographs: dict[str, dict[str, object]] = {
        names[k]: told(one) | {"alone": dict(zip(("value", "error"), together.alone[k], strict=True))}
        for k, one in together.located.items()
    }
    photographs |= {names[k]: {"no_ball": str(reason)} for k, reason in together.bare.items()}
    photographs |= {names[k]: {"refused": str(reason)} for k, reason in together.refused.items()}
    return {
        "parameters": _parameters(first, [k for k in range(BALL.stop) if k not in OWN]),
        "names": [
            *(f"{order[0]}: {name}" if name in own else name for name in NAMES),
            *(f"{photograph}: {name}" for photograph in order[1:] for name in own),
        ],
        "numbers": together.adjusted.joint.tolist(),
        "covariance": together.adjusted.covariance.tolist(),
        "photographs": photographs,
    } | made_of


def _parameters(located: Located, places: Sequence[int]) -> dict[str, dict[str, float]]:
    """Numbers and their errors by name."""
    sure = np.sqrt(np.diagonal(located.covariance))
    return {NAMES[k]: {"value": float(located.numbers[k]), "error": float(sure[k])} for k in places}


def apart(located: Located, result: FitResult) -> float:
    """The difference of the fit's index and the corners', in errors.

    Both rest on the same camera and radius, whose part of the errors they have in common: what they may differ by is
    the corners' own part and the noise and structure of the fit.
    """
    index, error = located.index
    own = float(np.hypot(error, result["ball.ior"].error))
    return abs(result["ball.ior"].value - index) / own
