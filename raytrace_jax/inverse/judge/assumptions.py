"""Sensitivity to fixed parameters, and candidate explanations of the residual."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...util.digits import with_error
from ...util.text import listed
from .structure import PairScores

WHAT_IF = 1e-3
"""Fraction of its size by which a number is taken to be off, in the sentence on what the answer rests on."""


class Assumption(NamedTuple):
    """A number of the scene that a fit took for granted.

    Args:
        size: how large it is: a single number's magnitude; for a vector's component the vector's length.
        uncertainty: the standard deviation that was stated; 0 if nothing was.
        sensitivity: how far each estimate moves per unit of the number.
    """

    name: str
    value: float
    size: float
    uncertainty: float
    sensitivity: Float[np.ndarray, " parameters"]
    unit: str = ""


class Contradiction(NamedTuple):
    """A number that was stated and comes out otherwise.

    Args:
        found: the estimate and its standard deviation.
        stated: mean and standard deviation before.
        deviations: how far they are apart, in standard deviations of their difference.
    """

    name: str
    found: tuple[float, float]
    stated: tuple[float, float]
    deviations: float

    @classmethod
    def of(cls, name: str, found: tuple[float, float], stated: tuple[float, float], excess: float = 0.0):
        """Compare an estimate with what was stated.

        Of least squares the difference has the variance before less that after: what was stated pulls the estimate the
        less, the more the picture says. It is at least a tenth of the standard deviation before: a picture that says
        next to nothing does not contradict, and a solver rests somewhere near.

        Args:
            excess: variance of the difference beyond this.
        """
        variance = max(stated[1] ** 2 - found[1] ** 2 + excess, (0.1 * stated[1]) ** 2)
        return cls(name, found, stated, abs(found[0] - stated[0]) / math.sqrt(variance))

    @property
    def words(self) -> str:
        """`ball.radius: 2.0312(4), stated 2+-0.005 (6.2 times as far as by chance)`."""
        stated = "{:.8g}+-{:.2g}".format(*self.stated)
        far = f"{short_count(self.deviations)} times as far as by chance"
        return f"{self.name}: {with_error(*self.found)}, stated {stated} ({far})"


def contradicted(compared: Iterable[Contradiction]) -> tuple[Contradiction, ...]:
    """Those of more than 3 standard deviations, the farthest first."""
    return tuple(sorted((one for one in compared if one.deviations > 3.0), key=lambda one: -one.deviations))


class Dependence(NamedTuple):
    """The fixed number that an estimate depends on most, if all that count as exact are off by the same share.

    Args:
        change: how much larger the fixed number might be: a thousandth of its `Assumption.size`.
        shift: how much larger the estimate then is.
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
        # Other units are the scene's own, and not worth saying.
        change = f"{self.change:.2g}" + (f" {self.unit}s" if self.unit in ("degree", "pixel") else "")
        shift = f"{abs(self.shift):.2g} {'larger' if self.shift > 0 else 'smaller'}"
        return (
            f"{self.estimate} depends most on {self.on}: were that {change} larger, {self.estimate} would be {shift} "
            f"({short_count(self.errors)} total errors)"
        )


class Cause(NamedTuple):
    """A change of the picture that a residual looks like.

    Args:
        name: a fixed number of the scene, or what a camera or a program may do to a picture.
        unit: the amount's unit in words: `%`, `px`, or empty for the number's own.
        per_unit: the amount that is one such unit.
        amount: how much more of it the target has than the scene says.
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
        return f"{self.name} {self.amount / self.per_unit:+.2g} {self.unit}".rstrip()


@dataclasses.dataclass(frozen=True)
class ModelCheck:
    """The findings of a check of the model.

    Args:
        assumptions: the most consequential first.
        causes: the best explanation first.
        stated, structure: covariance of the estimate from numbers that are stated to be uncertain, and from what the
            residual shows.
        far_matters: whether correlation of distant pixels, if there is any, speaks against the model: it moves an
            estimate by more than its standard error, or is more than single samples at edges make.
    """

    assumptions: tuple[Assumption, ...]
    causes: tuple[Cause, ...]
    pairs: PairScores
    stated: Float[np.ndarray, "parameters parameters"]
    structure: Float[np.ndarray, "parameters parameters"]
    far_matters: bool = True

    @classmethod
    def nothing(cls, count: int) -> "ModelCheck":
        """The check of a fit of so many parameters whose model was not looked at."""
        return cls((), (), PairScores(0.0, 0.0), np.zeros((count, count)), np.zeros((count, count)))

    @property
    def covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        return self.stated + self.structure

    @property
    def is_structured(self) -> bool:
        """Whether the residual is more than noise."""
        return bool(self.causes) or (self.pairs.is_far and self.far_matters)


def looks_like(causes: tuple[Cause, ...]) -> str:
    """The causes of a residual, as a sentence without its end."""
    return f". The residual looks like {listed(cause.words for cause in causes)}" if causes else ""


def dependences(
    assumptions: Sequence[Assumption], names: Sequence[str], total_error: np.ndarray
) -> tuple[Dependence, ...]:
    """For each estimate with an error the number on which it depends most, of those without a stated uncertainty."""
    found, exact = [], [one for one in assumptions if not one.uncertainty and one.size]
    for k, (name, error) in enumerate(zip(names, map(float, total_error), strict=True)):
        if exact and 0 < error < math.inf:
            most = max(exact, key=lambda one, k=k: abs(float(one.sensitivity[k])) * one.size)
            change = WHAT_IF * most.size
            shift = float(most.sensitivity[k]) * change
            if math.isfinite(shift) and shift:
                found.append(Dependence(name, most.name, change, most.unit, shift, abs(shift) / error))
    return tuple(found)


def short_count(number: float) -> str:
    """Two digits of a number of errors, as people write it."""
    rounded = float(f"{number:.1e}")
    if rounded >= 100_000:  # A picture without noise has nearly no error, and anything is very many of them.
        return "more than 100,000"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"
