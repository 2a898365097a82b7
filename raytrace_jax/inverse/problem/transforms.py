"""Bounded parameters as smooth functions of unbounded unknowns, because least-squares solvers know no bounds."""

import dataclasses
from typing import Literal

import jax
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.nature import Nature

Kind = Literal["free", "above", "between"]

MARGIN = 1e-3
"""A start on a bound is moved inside by this, in units or of the range: there the unknown would be infinite,
and near there it hardly moves the value. From an alpha of 1 the last level comes to the answer on one of two scenes
with 1e-3, on none with 1e-4, on both with 1e-2 and 0.1 (experiments/tuning)."""

AT_BOUND = 1e-9
"""A value nearer to its bound, in units or of the range, is there: the unknown, 21 from the middle, goes no farther. It
would for ever, as what is infinitely far away cannot be reached, until its derivative is less than the least number."""


@dataclasses.dataclass(frozen=True)
class Transform:
    """How one scalar parameter follows from its unknown `y`.

    `free`: `unit * y`; `above`: `lower + unit * softplus(y)`; `between`: from `lower` to `upper` by `sigmoid(y)`.
    """

    kind: Kind = "free"
    lower: float = 0.0
    upper: float = 1.0
    unit: float = 1.0

    def to_value(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter's value; smooth and increasing in `y`."""
        if self.kind == "above":
            return self.lower + self.unit * jax.nn.softplus(y)
        if self.kind == "between":
            return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(y)
        # Not even multiplied by 1: XLA takes the smallest numbers for 0 where it calculates.
        return y if self.unit == 1 else self.unit * y

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest unknown that a solver may try."""
        if self.kind == "free":
            return -np.inf, np.inf
        least = float(np.log(AT_BOUND))  # Of both, softplus and sigmoid, but for a rounding.
        return least, np.inf if self.kind == "above" else -least

    def to_unknown(self, value: float) -> float:
        """The unknown that gives a value; a value at or beyond a bound is first moved just inside."""
        if self.kind == "above":
            excess = max((value - self.lower) / self.unit, MARGIN)
            return float(excess + np.log(-np.expm1(-excess)))
        if self.kind == "between":
            inside = min(max((value - self.lower) / (self.upper - self.lower), MARGIN), 1 - MARGIN)
            return float(np.log(inside) - np.log1p(-inside))
        return value / self.unit


def default_transform(nature: Nature, value: float, unit: float = 1.0) -> Transform:
    """The transform that keeps a number of this nature, which starts at `value`, in its range.

    `unit` is what a number of about 1 means for it: with lengths that of the scene.
    """
    lower, upper = nature.range_at(value)
    if np.isinf(lower):
        return Transform(unit=unit)
    return Transform("above", lower, unit=unit) if np.isinf(upper) else Transform("between", lower, upper)
