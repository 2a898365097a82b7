"""Bounded parameters in units in which a solver can treat them alike."""

import dataclasses
import math
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.nature import Nature

Kind = Literal["free", "above", "between"]

AT_BOUND = 1e-30
"""How near a value comes to its lower bound, in units or of the range: a radius of 0 is none, and of a colour this is
0."""


@dataclasses.dataclass(frozen=True)
class Transform:
    """How one scalar parameter follows from its unknown `y`: linearly, from end to end of its reach.

    `free`: `unit * y`; `above`: `lower + unit * y`; `between`: from `lower` to `upper` for y from 0 to 1. What lies
    beyond has the value of the end, should a solver go there that does not know the reach.
    """

    kind: Kind = "free"
    lower: float = 0.0
    upper: float = 1.0
    unit: float = 1.0

    def to_value(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter's value; its derivative at an end is that inside."""
        if self.kind == "free":
            # Not even multiplied by 1: XLA takes the smallest numbers for 0 where it calculates.
            return y if self.unit == 1 else self.unit * y
        least, most = self.reach
        inside = jnp.where(y < least, least, jnp.where(y > most, most, y))
        return self.lower + self.width * inside

    def to_unknown(self, value: float) -> float:
        """The unknown that gives a value; a value at or beyond a bound is first moved just inside."""
        if self.kind == "free":
            return value / self.unit
        least, most = self.reach
        return min(max((value - self.lower) / self.width, least), most)

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the largest value."""
        if self.kind == "free":
            return -math.inf, math.inf
        return self.lower, math.inf if self.kind == "above" else self.upper

    @property
    def width(self) -> float:
        """What 1 of the unknown is of a bounded value."""
        return self.unit if self.kind == "above" else self.upper - self.lower

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest unknown that a solver may try."""
        if self.kind == "free":
            return -math.inf, math.inf
        return AT_BOUND, math.inf if self.kind == "above" else 1.0


def default_transform(nature: Nature, value: float, unit: float = 1.0) -> Transform:
    """The transform that keeps a number of this nature, which starts at `value`, in its range.

    `unit` is what a number of about 1 means for it: with lengths that of the scene.
    """
    lower, upper = nature.range_at(value)
    if np.isinf(lower):
        return Transform(unit=unit)
    return Transform("above", lower, unit=unit) if np.isinf(upper) else Transform("between", lower, upper)
