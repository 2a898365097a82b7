"""What an answer rests on, what its residual looks like, and what both make of its error."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.noise_correlation import PairScores
from raytrace_jax.util.words import listed

FAR_SIGNIFICANT = 3.0
"""The same of pairs of pixels that are far apart; the largest of these draws was 2.2, as large ones have thin tails."""

WHAT_IF = 1e-3
"""The share by which a number might be off, in the sentence on what the answer rests on: a tenth of a percent."""

NAMED_UNITS = ("degree", "pixel")
"""Units that are worth saying; the others are the scene's own."""

MOST_WORTH_COUNTING = 100_000
"""Errors; of a picture without noise they are nearly nothing, and anything is that many of them."""


class Assumption(NamedTuple):
    """A number of the scene that a fit took for granted.

    Args:
        name: its canonical name.
        value: in the scene.
        size: how large it is: of a single number its magnitude, of a vector's component the vector's length.
        uncertainty: the standard deviation that was stated; 0 if nothing was.
        sensitivity: how far each estimate moves for each unit of it, in the estimate's unit per the number's.
        unit: what one of it is, for people.
    """

    name: str
    value: float
    size: float
    uncertainty: float
    sensitivity: Float[np.ndarray, " parameters"]
    unit: str = ""


class Dependence(NamedTuple):
    """The number, of those that count as exact, that an estimate depends on most if each is off by the same share.

    Args:
        estimate: the free number.
        on: the number of the scene.
        change: by how much that might be larger, a thousandth of its size; of a vector's component, of its length.
        unit: of the change, for people.
        shift: by how much the estimate then is larger.
        errors: the shift in total errors of the estimate.
    """

    estimate: str
    on: str
    change: float
    unit: str
    shift: float
    errors: float

    @property
    def words(self) -> str:
        """`ball.ior depends most on ball.radius: were that 0.0023 larger, ball.ior would be 0.0015 larger (...)`."""
        unit = f" {self.unit}s" if self.unit in NAMED_UNITS else ""
        larger = "larger" if self.shift > 0 else "smaller"
        return (
            f"{self.estimate} depends most on {self.on}: were that {self.change:.2g}{unit} larger, {self.estimate} "
            f"would be {abs(self.shift):.2g} {larger} ({short_count(self.errors)} total errors)"
        )


class Cause(NamedTuple):
    """A change of the picture that a residual looks like.

    Args:
        name: a fixed number of the scene, or what a camera or a program may do to a picture.
        unit: of the amount, for people: `%`, `px`, or empty for the number's own.
        per_unit: what of the amount is one of that unit.
        advice: what to do about it.
        amount: by how much the target has more of it than the scene says.
        score: the standard score of the finding; noise alone makes about 1.
    """

    name: str
    unit: str
    per_unit: float
    advice: str
    amount: float
    score: float

    @property
    def words(self) -> str:
        """`vitreous.radius +0.2 %`."""
        space = " " if self.unit else ""
        return f"{self.name} {self.amount / self.per_unit:+.2g}{space}{self.unit}"


@dataclasses.dataclass(frozen=True)
class ModelCheck:
    """What a check of the model found.

    Args:
        assumptions: what was taken for granted, the most consequential first.
        causes: what the residual looks like, the best explanation first.
        pairs: whether neighbours err together.
        stated, structure: covariance of the estimate from numbers stated to be uncertain, and from what the residual
            shows; in the parameters' units.
        far_matters: whether what pixels that are far apart have in common, if they have, speaks against the model: it
            moves an estimate by more than its standard error, or is more than single samples at edges make.
    """

    assumptions: tuple[Assumption, ...]
    causes: tuple[Cause, ...]
    pairs: PairScores
    stated: Float[np.ndarray, "parameters parameters"]
    structure: Float[np.ndarray, "parameters parameters"]
    far_matters: bool = True

    @classmethod
    def nothing(cls, count: int) -> "ModelCheck":
        """Of a fit of so many parameters whose model was not checked."""
        zero = np.zeros((count, count))
        return cls((), (), PairScores(0.0, 0.0), zero, zero)

    @property
    def covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        """Of the estimate, from both."""
        return self.stated + self.structure

    @property
    def is_structured(self) -> bool:
        """Whether the residual is more than noise."""
        return bool(self.causes) or (self.pairs.far > FAR_SIGNIFICANT and self.far_matters)


def looks_like(causes: tuple[Cause, ...]) -> str:
    """What a residual looks like, as a sentence of its own without its end."""
    return f". The residual looks like {listed(cause.words for cause in causes)}" if causes else ""


def dependences(
    assumptions: Sequence[Assumption], names: Sequence[str], total_error: np.ndarray
) -> tuple[Dependence, ...]:
    """What each estimate depends on most, of the numbers whose uncertainty was not stated.

    An estimate without an error, or that depends on nothing, has none.

    Args:
        assumptions: of all numbers.
        names: of the estimates.
        total_error: of the estimates.
    """
    exact = [one for one in assumptions if not one.uncertainty and one.size]
    found = []
    for k, name in enumerate(names):
        if not exact or not (np.isfinite(total_error[k]) and total_error[k] > 0):
            continue
        most = max(exact, key=lambda one, k=k: abs(float(one.sensitivity[k])) * one.size)
        change = WHAT_IF * most.size
        shift = float(most.sensitivity[k]) * change
        if np.isfinite(shift) and shift:
            found.append(Dependence(name, most.name, change, most.unit, shift, abs(shift) / float(total_error[k])))
    return tuple(found)


def short_count(number: float) -> str:
    """Two digits of a number, as people write it."""
    rounded = float(f"{number:.1e}")
    if rounded >= MOST_WORTH_COUNTING:
        return f"more than {MOST_WORTH_COUNTING:,}"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"
