"""What a residual may look like: a change of the picture by each number that was taken for granted."""

import dataclasses

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.judge.assumptions import Cause
from raytrace_jax.inverse.judge.change_scores import LEAST_LEFT
from raytrace_jax.inverse.judge.film_changes import FilmChange
from raytrace_jax.inverse.judge.picture_changes import Pixels, flat
from raytrace_jax.inverse.problem.fixed_numbers import FixedNumbers

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
    """

    causes: tuple[Cause, ...]
    changes: Float[np.ndarray, "suspects rows"]
    of_film: tuple[FilmChange, ...]
    least_left: Float[np.ndarray, " suspects"]

    @classmethod
    def of(cls, of_film: list[FilmChange], pixels: Pixels, numbers: FixedNumbers, by_number) -> "Suspects":
        """All fixed numbers, and what a film may do."""
        causes = [
            Cause(name, "%" if size > 0 else "", size / 100 if size > 0 else 1.0, "free it, or measure it", 1.0, 0.0)
            for name, size in zip(numbers.names, numbers.size, strict=True)
        ]
        for change in of_film:
            unit = change.effect.unit
            per_unit = 0.01 * change.value if unit == "%" else 1.0
            causes.append(Cause(change.name, unit, per_unit, change.effect.advice, 1.0, 0.0))
        least = np.full(len(causes), LEAST_LEFT)
        if pixels.edges == "aware":
            least[: len(numbers.parameters)][[p.is_color for p in numbers.parameters]] = LEAST_LEFT_OF_COLOR
        return cls(tuple(causes), np.concatenate([by_number, seen(of_film, pixels)]), tuple(of_film), least)

    def cause(self, place: int, amount: float, score: float) -> Cause:
        """One of them, as it was found."""
        at = place - (len(self.causes) - len(self.of_film))
        return self.causes[place]._replace(amount=self.of_film[at].amount(amount) if at >= 0 else amount, score=score)

    def without(self, granted) -> "Suspects":
        """All but some of the fixed numbers, which come first."""
        keep = np.concatenate([~granted, np.ones(len(self.causes) - len(granted), bool)])
        causes = tuple(cause for cause, kept in zip(self.causes, keep, strict=True) if kept)
        return Suspects(causes, self.changes[keep], self.of_film, self.least_left[keep])


def seen(changes: list[FilmChange], pixels: Pixels) -> Float[np.ndarray, "changes rows"]:
    """Changes of the picture as rows, weighted, of the pixels that are judged."""
    found = [flat(pixels.judged.of(one.change)[None] * pixels.root_weight) for one in changes]
    return np.concatenate(found) if found else np.zeros((0, 3 * len(pixels.judged.row)))
