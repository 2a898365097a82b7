"""Bounded parameters as smooth functions of unbounded unknowns, because least-squares solvers know no bounds."""

import dataclasses
from typing import Literal

import jax
import numpy as np
from jaxtyping import Array, Float

Kind = Literal["free", "above", "unit"]

MARGIN = 1e-3
"""A start that lies on a bound is moved this far inside: at the bound itself the unknown would be infinite."""


@dataclasses.dataclass(frozen=True)
class Transform:
    """How one scalar parameter follows from its unknown `y`.

    `free`: the value is `y`; `above`: `lower + softplus(y)`, so above `lower`; `unit`: `sigmoid(y)`, so in (0, 1).
    """

    kind: Kind = "free"
    lower: float = 0.0

    def to_value(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter's value; smooth and increasing in `y`."""
        if self.kind == "above":
            return self.lower + jax.nn.softplus(y)
        return jax.nn.sigmoid(y) if self.kind == "unit" else y

    def to_unknown(self, value: float) -> float:
        """The unknown that gives a value; a value at or beyond a bound is first moved just inside."""
        if self.kind == "above":
            excess = max(value - self.lower, MARGIN)
            return float(excess + np.log(-np.expm1(-excess)))
        if self.kind == "unit":
            inside = min(max(value, MARGIN), 1 - MARGIN)
            return float(np.log(inside) - np.log1p(-inside))
        return value


def default_transform(name: str, value: float) -> Transform:
    """The bound that a parameter has by its nature, told by its name.

    `ior` stays above 1, or above 0 if it starts below 1 (a bubble); a radius, an energy and a hardness above 0; weights
    of rays in (0, 1); colours and emissivities above 0 unless they start negative.
    """
    attribute = name.rsplit(".", 1)[-1]
    if attribute == "ior":
        return Transform("above", 1.0 if value >= 1 else 0.0)
    if attribute in ("radius", "energy", "hardness"):
        return Transform("above")
    if attribute in ("alpha", "reflectivity", "fresnel", "transmission"):
        return Transform("unit")
    if attribute in ("r", "g", "b") and value >= 0:
        return Transform("above")
    return Transform()
