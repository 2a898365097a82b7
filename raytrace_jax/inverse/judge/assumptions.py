"""The numbers that an answer takes for granted, causes of its residual, and the errors that follow from both."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.structure import PairScores
from raytrace_jax.util.digits import with_error
from raytrace_jax.util.text import listed

FAR_SIGNIFICANT = 3.0
"""Score above which correlation of distant pixels is structure, not noise. Noise alone reached 2.2 at most in the draws
for `model_check.SIGNIFICANT`."""

BEYOND_CHANCE = 3.0
"""How many times as far as chance moves an estimate from what was stated is a contradiction."""

LEAST_CHANCE = 0.1
"""Chance moves an estimate from what was stated by this share of its standard deviation at least: a picture that says
next to nothing does not contradict, and a solver rests somewhere near."""

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
        deviations: how far they are apart, in standard deviations of their difference. That is less than the one of
            what was stated, on which the estimate rests as well.
    """

    name: str
    found: tuple[float, float]
    stated: tuple[float, float]
    deviations: float

    @classmethod
    def of(
        cls, name: str, found: tuple[float, float], stated: tuple[float, float], excess: float = 0.0
    ) -> "Contradiction":
        """Compare an estimate with what was stated.

        Of least squares the difference has the variance before less that after: what was stated pulls the estimate the
        less, the more the picture says.

        Args:
            excess: variance of the difference beyond this.
        """
        apart = abs(found[0] - stated[0])
        variance = max(stated[1] ** 2 - found[1] ** 2 + excess, (LEAST_CHANCE * stated[1]) ** 2)
        return cls(name, found, stated, apart / math.sqrt(variance))

    @property
    def words(self) -> str:
        """`ball.radius: 2.0312(4), stated 2+-0.005 (6.2 times as far as by chance)`."""
        mean, spread = self.stated
        far = short_count(self.deviations)
        return (
            f"{self.name}: {with_error(*self.found)}, stated {mean:.8g}+-{spread:.2g} ({far} times as far as by chance)"
        )


def contradicted(compared: Iterable[Contradiction]) -> tuple[Contradiction, ...]:
    """Those that are beyond chance, the farthest first."""
    beyond = [one for one in compared if one.deviations > BEYOND_CHANCE]
    return tuple(sorted(beyond, key=lambda one: -one.deviations))


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
        unit = f" {self.unit}s" if self.unit in ("degree", "pixel") else ""
        larger = "larger" if self.shift > 0 else "smaller"
        return (
            f"{self.estimate} depends most on {self.on}: were that {self.change:.2g}{unit} larger, {self.estimate} "
            f"would be {abs(self.shift):.2g} {larger} ({short_count(self.errors)} total errors)"
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
        space = " " if self.unit else ""
        return f"{self.name} {self.amount / self.per_unit:+.2g}{space}{self.unit}"


@dataclasses.dataclass(frozen=True)
class ModelCheck:
    """The findings of a check of the model.

    Args:
        assumptions: what was taken for granted, the most consequential first.
        causes: what the residual looks like, the best explanation first.
        stated, structure: covariance of the estimate from numbers that are stated to be uncertain, and from what the
            residual shows; in the parameters' units.
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
        zero = np.zeros((count, count))
        return cls((), (), PairScores(0.0, 0.0), zero, zero)

    @property
    def covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        """Covariance of the estimate from stated uncertainties and from structure."""
        return self.stated + self.structure

    @property
    def is_structured(self) -> bool:
        """Whether the residual is more than noise."""
        return bool(self.causes) or (self.pairs.far > FAR_SIGNIFICANT and self.far_matters)


def looks_like(causes: tuple[Cause, ...]) -> str:
    """The causes of a residual, as a sentence of its own without its end."""
    return f". The residual looks like {listed(cause.words for cause in causes)}" if causes else ""


def dependences(
    assumptions: Sequence[Assumption], names: Sequence[str], total_error: np.ndarray
) -> tuple[Dependence, ...]:
    """For each estimate the number on which it depends most, of those whose uncertainty was not stated.

    An estimate that has no error, or depends on nothing, is left out.
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
    """Two digits of a number of errors, as people write it."""
    # A picture without noise has nearly no error, and anything is very many of them.
    rounded, most = float(f"{number:.1e}"), 100_000
    if rounded >= most:
        return f"more than {most:,}"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"
