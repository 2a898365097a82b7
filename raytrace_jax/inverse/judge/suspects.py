"""What a residual may look like: a change of the picture by each number that was taken for granted."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.inverse.judge.assumptions import Cause
from raytrace_jax.inverse.judge.change_scores import LEAST_LEFT
from raytrace_jax.inverse.judge.film_changes import FilmChange
from raytrace_jax.inverse.judge.picture_changes import Pixels, flat
from raytrace_jax.inverse.problem.fixed_numbers import FixedNumbers
from raytrace_jax.scene.limits import Limit

LEAST_LEFT_OF_COLOR = 1e-3
"""The same as `LEAST_LEFT` of a colour, whose change of an edge-aware picture a few points tell: beside a free gain,
which is the exact one, they leave 3e-4 of the light of a checker, 160 x 120, where there is nothing left."""


@dataclasses.dataclass(frozen=True)
class Suspects:
    """What a residual may look like.

    Args:
        causes: by name, with amounts of 1.
        changes: of the picture, for each.
        of_film: those that the film may do, which come last.
        least_left: the share of each that free parameters must leave, so that it tells anything.
        stated: the value of each in the scene, and what it may be; none where anything may be.
    """

    causes: tuple[Cause, ...]
    changes: Float[np.ndarray, "suspects rows"]
    of_film: tuple[FilmChange, ...]
    least_left: Float[np.ndarray, " suspects"]
    stated: tuple[tuple[float, Limit | None], ...] = ()

    @classmethod
    def of(cls, of_film: list[FilmChange], pixels: Pixels, numbers: FixedNumbers, by_number) -> "Suspects":
        """All fixed numbers, and what a film may do."""
        causes = [
            Cause(
                name, "%" if size > 0 else "", size / 100 if size > 0 else 1.0, f"free {name}, or measure it", 1.0, 0.0
            )
            for name, size in zip(numbers.names, numbers.size, strict=True)
        ]
        for change in of_film:
            unit = change.effect.unit
            per_unit = 0.01 * change.value if unit == "%" else 1.0
            advice = change.effect.advice.replace("free it", f"free {change.name}")
            causes.append(Cause(change.name, unit, per_unit, advice, 1.0, 0.0))
        least = np.full(len(causes), LEAST_LEFT)
        if pixels.edges == "aware":
            least[: len(numbers.parameters)][[p.is_color for p in numbers.parameters]] = LEAST_LEFT_OF_COLOR
        # The numbers that are traced come first, then those of the film that are stated, which are no suspects.
        limits = [parameter.attribute.limit for parameter in numbers.parameters]
        limits += [None] * (len(numbers.names) - len(limits)) + [change.effect.attribute.limit for change in of_film]
        values = [*numbers.value, *(change.value for change in of_film)]
        stated = tuple(zip(map(float, values), limits, strict=True))
        return cls(tuple(causes), np.concatenate([by_number, seen(of_film, pixels)]), tuple(of_film), least, stated)

    def amount(self, place: int, found: float) -> float:
        """By how much the target has more of one of them, for an amount that was found."""
        at = place - (len(self.causes) - len(self.of_film))
        return self.of_film[at].amount(found) if at >= 0 else found

    def are_possible(self, found: Float[np.ndarray, " suspects"]) -> Bool[np.ndarray, " suspects"]:
        """Whether each of them can be as the amounts that were found say: no blur is less than 0."""
        return np.array([self.is_possible(place, float(amount)) for place, amount in enumerate(found)], bool)

    def is_possible(self, place: int, found: float) -> bool:
        """Whether one of them can be as an amount says."""
        value, limit = self.stated[place] if self.stated else (0.0, None)
        return limit is None or limit.holds(np.array(value + self.amount(place, found)))

    def cause(self, place: int, found: float, score: float) -> Cause:
        """One of them, as it was found; what it cannot be, it only looks like."""
        cause = self.causes[place]._replace(amount=self.amount(place, found), score=score)
        if self.is_possible(place, found):
            return cause
        limit = self.stated[place][1]
        assert limit is not None
        return cause._replace(advice=f"look at the residual, for {cause.name} must be {limit.wanted}")

    def without(self, granted) -> "Suspects":
        """All but some of the fixed numbers, which come first."""
        keep = np.concatenate([~granted, np.ones(len(self.causes) - len(granted), bool)])
        causes = tuple(cause for cause, kept in zip(self.causes, keep, strict=True) if kept)
        stated = tuple(one for one, kept in zip(self.stated, keep, strict=True) if kept) if self.stated else ()
        return Suspects(causes, self.changes[keep], self.of_film, self.least_left[keep], stated)


def seen(changes: list[FilmChange], pixels: Pixels) -> Float[np.ndarray, "changes rows"]:
    """Changes of the picture as rows, weighted, of the pixels that are judged."""
    found = [flat(pixels.judged.of(one.change)[None] * pixels.root_weight) for one in changes]
    return np.concatenate(found) if found else np.zeros((0, 3 * len(pixels.judged.row)))
