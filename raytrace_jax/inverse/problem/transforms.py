"""Units in which a solver can treat parameters alike: the size of large changes, and how values stay in bounds."""

import dataclasses
import math
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.parameters import resolve
from raytrace_jax.scene.scene import Scene, world_length
from raytrace_jax.scene.schema import Quantity
from raytrace_jax.scene.setting_words import ModelName

Kind = Literal["free", "above", "between"]


@dataclasses.dataclass(frozen=True)
class Transform:
    """How one scalar parameter follows from its unknown `y`: linearly, from end to end of its reach.

    `free`: `unit * y`; `above`: `lower + unit * y`; `between`: from `lower` to `upper` for y from 0 to 1. An unknown
    beyond its reach gives the value of the end, for solvers that do not know the reach.
    """

    kind: Kind = "free"
    lower: float = 0.0
    upper: float = 1.0
    unit: float = 1.0

    def to_value(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter's value; at an end the derivative is that of the inside."""
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
        """How much a bounded value changes while its unknown changes by 1."""
        return self.unit if self.kind == "above" else self.upper - self.lower

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest unknown that a solver may try."""
        if self.kind == "free":
            return -math.inf, math.inf
        # A radius of 0 is none: a value comes as near to its bound as this, in units or shares of its range.
        return 1e-30, math.inf if self.kind == "above" else 1.0


def default_transform(quantity: Quantity, value: float, unit: float = 1.0) -> Transform:
    """The transform that keeps a number of this quantity, which starts at `value`, in its range.

    `unit` is the size at which such a number counts as 1; see `natural_unit`.
    """
    lower, upper = quantity.range_at(value)
    if np.isinf(lower):
        return Transform(unit=unit)
    return Transform("above", lower, unit=unit) if np.isinf(upper) else Transform("between", lower, upper)


UNITS_OF_A_WORLD = 10
"""How many natural units of length a scene measures; for the course's scenes the unit is then their world unit."""

LEAST_SCALE = 0.1
"""The natural scale, in units, of a number that is 0 and so has no size of its own."""


def natural_unit(scene: Scene, quantity: Quantity, model: ModelName = "classic") -> float:
    """The size at which a parameter of this quantity counts as 1, scaled with the scene by the quantity's dimension."""
    return (float(world_length(scene)) / UNITS_OF_A_WORLD) ** quantity.dimension_in(model)


def natural_scale(scene: Scene, name: str, model: ModelName = "classic") -> float:
    """How large a change of a parameter is a large one: the step of a search, the measure of an error.

    An index counts from 1, a position in radii of its sphere, anything else by its own size, as its `Quantity` says.
    """
    address, block, attribute, _ = resolve(scene, name)
    value, quantity = float(address.read(scene)), attribute.quantity
    unit = natural_unit(scene, quantity, model)
    if quantity.scale == "index":
        return max(abs(value - 1), LEAST_SCALE)
    if quantity.scale == "block":
        return max(_length(block.read(scene, side)) for side in quantity.sized_by)
    if quantity.scale == "vector":
        return max(_length(address.entry.read(scene)), unit)
    return max(abs(value), LEAST_SCALE * unit)


def _length(value: Array) -> float:
    """The length of a vector, the magnitude of a number."""
    return float(np.linalg.norm(value)) if value.ndim else abs(float(value))
