"""Bounded parameters as smooth functions of unbounded unknowns, because least-squares solvers know no bounds."""

import dataclasses
from typing import Literal

import jax
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.nature import Nature

Kind = Literal["free", "above", "between"]

MARGIN = 1e-3
"""A start on a bound is moved inside by this, of the range if it has two ends: there the unknown would be infinite."""


@dataclasses.dataclass(frozen=True)
class Transform:
    """How one scalar parameter follows from its unknown `y`.

    `free`: the value is `y`; `above`: `lower + softplus(y)`; `between`: from `lower` to `upper` by `sigmoid(y)`.
    """

    kind: Kind = "free"
    lower: float = 0.0
    upper: float = 1.0

    def to_value(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter's value; smooth and increasing in `y`."""
        if self.kind == "above":
            return self.lower + jax.nn.softplus(y)
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(y) if self.kind == "between" else y

    def to_unknown(self, value: float) -> float:
        """The unknown that gives a value; a value at or beyond a bound is first moved just inside."""
        if self.kind == "above":
            excess = max(value - self.lower, MARGIN)
            return float(excess + np.log(-np.expm1(-excess)))
        if self.kind == "between":
            inside = min(max((value - self.lower) / (self.upper - self.lower), MARGIN), 1 - MARGIN)
            return float(np.log(inside) - np.log1p(-inside))
        return value


def default_transform(nature: Nature, value: float) -> Transform:
    """The transform that keeps a number of this nature, which starts at `value`, in its range."""
    lower, upper = nature.range_at(value)
    if np.isinf(lower):
        return Transform()
    return Transform("above", lower) if np.isinf(upper) else Transform("between", lower, upper)
