"""Changes that a residual may contain: by each number that was taken for granted, or by the film."""

import dataclasses
import itertools
import math
from collections.abc import Container, Iterator, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from raytrace_jax.inverse.judge.assumptions import Cause
from raytrace_jax.inverse.judge.changes import SampledPicture, flat
from raytrace_jax.inverse.problem.fixed import FixedNumbers
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.unknowns import Image, Vector
from raytrace_jax.scene.parameters import resolve
from raytrace_jax.scene.response import FILM, FILM_EFFECTS, FilmEffect, develop_compiled, neutral_response, without_idle
from raytrace_jax.scene.scene import CameraResponse
from raytrace_jax.scene.schema import Attribute, Range
from raytrace_jax.util.numerics import TINY, solve_normal

LEAST_LEFT = 1e-6
"""The least fraction of a change that the free parameters must leave; with less it cannot be told from theirs."""

LINEAR_PART, LINEAR_PART_OF_LIGHT = 0.1, 0.5
"""Fractions of its size by which a number of the scene, and a colour or a gamma, may be off if the picture is to change
in proportion. Most move edges across pixels, where a solver's step ends at a tenth too; the latter only change light.
"""


class Rows(NamedTuple):
    """Numbers of some pixels, as rows of a least-squares problem.

    Args:
        evidence: the weighted residuals, but 0 where one says nothing.
        weight: what each counts: the loss's weight over the pixel's chance to be looked at.
        square: number of the square of pixels in which each is; the rows of one square may err together.
    """

    residual: Float[np.ndarray, " rows"]
    evidence: Float[np.ndarray, " rows"]
    weight: Float[np.ndarray, " rows"]
    square: Int[np.ndarray, " rows"]


class Scores(NamedTuple):
    """Scores of some changes as explanations of a residual.

    Args:
        score: its standard score with a sign. Noise alone makes about 1; the largest is 37, where chance is below
            1e-300.
        amount: how much of the change the residual holds.
        gain: by how much the weighted sum of squares falls with it.
    """

    score: Float[np.ndarray, " changes"]
    amount: Float[np.ndarray, " changes"]
    gain: Float[np.ndarray, " changes"]


def score_changes(
    rows: Rows,
    free: Float[np.ndarray, "parameters rows"],
    changes: Float[np.ndarray, "changes rows"],
    least_left: Float[np.ndarray, " changes"] | float = LEAST_LEFT,
) -> Scores:
    """Score changes of a picture, as far as no free parameter makes up for them.

    The amount of a change is found by least squares. Its spread comes from what the change leaves of the residual,
    summed by squares of pixels (the sandwich: White 1980), so that it holds for noise of any distribution and unequal
    in size. What a square leaves is divided by one minus its fraction of the change: otherwise a few squares that
    decide would seem to agree with themselves (the jackknife: MacKinnon and White 1985). Amount over spread follows
    Student's distribution with as many degrees of freedom as squares decide, less one. The score is the value of a
    normal variable that chance exceeds as rarely.

    Args:
        free: the changes by the free parameters, and others that are granted.
        least_left: fraction of each change's squares that the free parameters must leave; below it the score is 0.
    """
    # What a change leaves beside the free parameters, and how much of that each square sees.
    rest = orthogonal_to(free, changes, rows.weight)
    by_square = square_totals(rest * rest * rows.weight, rows.square)
    left = by_square.sum(axis=1)
    is_seen = left > least_left * np.sum(changes * changes * rows.weight, axis=1)
    length = np.where(is_seen, left, 1.0)[:, None]
    fraction = by_square / length

    # The sandwich, and the number of squares that decide, `1 / sum(fraction^2)`.
    products = square_totals(rest * (rows.weight * rows.evidence), rows.square)
    evident = products.sum(axis=1, keepdims=True) / length
    errors = (products - evident * by_square) / np.maximum(1 - fraction, 1e-6)
    spread = np.maximum(np.sqrt(np.sum(errors**2, axis=1)), TINY)
    freedom = np.maximum(1 / np.maximum(np.sum(fraction**2, axis=1), TINY) - 1, 1e-6)
    # What only one square sees has no spread, and its ratio no end. Student's distribution is computed up to 1e100.
    ratio = np.minimum(np.abs(products.sum(axis=1)) / spread, 1e100)
    chance = stats.t.sf(ratio, freedom)
    score = np.sign(evident[:, 0]) * stats.norm.isf(np.maximum(chance, TINY))

    # The amount is that of all residuals, also of those that are no evidence.
    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / length[:, 0], 0.0)
    return Scores(np.where(is_seen & products.any(axis=1), score, 0.0), amount, amount * in_all)


def orthogonal_to(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "changes rows"]:
    """The rest of changes when the free parameters have been fitted to them."""
    return changes - fitted(free, changes, weight).T @ free


def fitted(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "parameters changes"]:
    """The free parameters' least-squares fit to changes, `(J^T W J)^-1 J^T W change`, J their derivatives.

    It is 0 along directions that the derivatives leave open.
    """
    pulled = free * weight
    return solve_normal(pulled @ free.T, pulled @ changes.T)


def square_totals(
    products: Float[np.ndarray, "changes rows"], square: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "changes squares"]:
    """Sums over the rows of each square."""
    if not square.size:
        return np.zeros((len(products), 1))
    order = np.argsort(square, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(square[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)


class FilmChange(NamedTuple):
    """The picture's change with a number of its film, or with one number of all three channels.

    Args:
        name: the number's name, `film.gain.r`; without a component where all channels change together.
        value: the number in the scene; that of the first channel where all change together.
    """

    name: str
    effect: FilmEffect
    value: float
    change: Image

    def amount(self, found: float) -> float:
        """The change of the number itself, from an amount that was found.

        For an effect that grows with the number's square the amount is the change of the square.
        """
        if not self.effect.is_squared:
            return found
        square = self.value**2 + found
        # The target is sharper than a picture without blur: by as much as a blur would take away.
        return math.copysign(math.sqrt(abs(square)), square) - self.value

    @property
    def reach(self) -> Range:
        """The least and the largest amount, as one is found."""
        # A sharper target is one more blur cannot give, but a camera can: its square goes on below 0.
        if self.effect.is_squared:
            return -math.inf, math.inf
        is_linear = self.effect.is_linear or self.effect.unit != "%"
        return reach_of(self.effect.attribute, self.value, math.inf if is_linear else LINEAR_PART_OF_LIGHT * self.value)


def reach_of(attribute: Attribute, value: float, linear: float) -> Range:
    """The least and the largest change of a number that stays where a fit keeps it, and is no larger than `linear`."""
    least, most = attribute.quantity.range_at(value)
    return max(least - value, -linear), min(most - value, linear)


def suspected_changes(problem: Problem, y: Vector, light: Image, uncertain: Container[str] = ()) -> list[FilmChange]:
    """The changes by each of the film's numbers, and by all channels together, that may explain a residual.

    Free numbers are no suspects, and neither are those that are stated to be uncertain.

    Args:
        problem: what was fitted; a scene without a film has one that does nothing.
    """
    film = film_at(problem, y)
    free = {resolve(problem.scene, name).address for name in problem.unknowns.names}
    leaders = {resolve(problem.scene, leader).address for _, leader in problem.unknowns.ties}
    alone = {(one.field, one.component) for one in free - leaders if one.group == FILM}
    tied = {(one.field, one.component) for one in leaders if one.group == FILM}
    # Differences of the developed picture, by a step that each effect knows.
    before, found = developed(problem, light, film), []
    for name, effect, which, start in film_parts(film):
        moving = {(effect.name, k if effect.attribute.components else None) for k in which}
        # A number that is free alone is no suspect. Of tied channels each is one, but not all of them together.
        if moving <= alone or (len(moving) > 1 and moving & tied) or name in uncertain:
            continue
        moved = start + effect.step if not effect.is_squared else math.hypot(start, effect.step)
        amount = effect.step if not effect.is_squared else effect.step**2
        after = developed(problem, light, with_numbers(film, effect, which, moved - start))
        found.append(FilmChange(name, effect, start, (after - before) / amount))
    return found


def stated_changes(problem: Problem, y: Vector, light: Image, uncertain: Mapping[str, float]) -> list[FilmChange]:
    """The changes by the film's numbers that are stated to be uncertain, per unit of each number.

    Args:
        uncertain: standard deviation by canonical name of a fixed number. It is the step of the difference as well.
    """
    film, found = film_at(problem, y), []
    for name, effect, which, value in film_parts(film):
        if name in uncertain:
            after = developed(problem, light, with_numbers(film, effect, which, uncertain[name]))
            found.append(FilmChange(name, effect, value, (after - developed(problem, light, film)) / uncertain[name]))
    return found


def film_parts(film: CameraResponse) -> Iterator[tuple[str, FilmEffect, list[int], float]]:
    """The parts of a film that may be off: all channels of an effect, and each number.

    Each has its name, its effect, its places in the effect's value, and the number at the first of them.
    """
    for effect in FILM_EFFECTS:
        value = np.atleast_1d(np.asarray(getattr(film, effect.name), np.float64))
        name, components = f"{film.name}.{effect.name}", effect.attribute.components
        if len(components) != 1:
            yield name, effect, list(range(len(value))), float(value[0])
        yield from ((f"{name}.{one}", effect, [k], float(value[k])) for k, one in enumerate(components))


def film_at(problem: Problem, y: Vector) -> CameraResponse:
    """The film at the unknowns, with all effects."""
    return problem.scene_at(y).film or neutral_response(problem.observation.target.dtype)


def with_numbers(film: CameraResponse, effect: FilmEffect, which: list[int], by: float) -> CameraResponse:
    """The film with some of an effect's numbers moved."""
    value = np.array(getattr(film, effect.name))
    value.reshape(-1)[which] += by
    return dataclasses.replace(film, **{effect.name: jnp.asarray(value)})


def developed(problem: Problem, light: Image, film: CameraResponse) -> Image:
    """The picture developed by a film; effects that do nothing are left out."""
    active = without_idle(film)
    active = dataclasses.replace(
        active, **{e.name: problem.array(v) for e in FILM_EFFECTS if (v := getattr(active, e.name)) is not None}
    )
    return np.asarray(develop_compiled(problem.array(light), active, problem.raster().frame), np.float64)


@dataclasses.dataclass(frozen=True)
class Suspects:
    """The changes that a residual may contain.

    Args:
        causes: one for each suspect, with an amount of 1.
        of_film: the suspects of the film, which come last.
        least_left: fraction of each change that the free parameters must leave, or it tells nothing.
        stated: each number's value in the scene, and its attribute.
        reach: the least and the largest amount of each up to which its number can be what it says, and its change is in
            proportion.
    """

    causes: tuple[Cause, ...]
    changes: Float[np.ndarray, "suspects rows"]
    of_film: tuple[FilmChange, ...]
    least_left: Float[np.ndarray, " suspects"]
    stated: tuple[tuple[float, Attribute | None], ...]
    reach: tuple[Range, ...]

    @classmethod
    def of(cls, of_film: list[FilmChange], pixels: SampledPicture, numbers: FixedNumbers, by_number) -> "Suspects":
        """Make suspects of all fixed numbers, and of what a film may do."""
        # Amounts are told in pixels, and in percent where a number has a size.
        causes, of_picture = [], {k for k, p in enumerate(numbers.parameters) if p.attribute.unit == "pixel"}
        for k, (name, size) in enumerate(zip(numbers.names, numbers.size, strict=True)):
            unit, per_unit = ("px", 1.0) if k in of_picture else ("%", size / 100) if size > 0 else ("", 1.0)
            causes.append(Cause(name, unit, per_unit, f"free {name}, or measure it", 1.0, 0.0))
        for change in of_film:
            unit = change.effect.unit
            per_unit = 0.01 * change.value if unit == "%" else 1.0
            advice = change.effect.advice.replace("free it", f"free {change.name}")
            causes.append(Cause(change.name, unit, per_unit, advice, 1.0, 0.0))
        least = np.full(len(causes), LEAST_LEFT)
        if pixels.edges == "aware":
            # A few points tell how a colour changes an edge-aware picture, and a free gain is exact: the light of a
            # checker, 160 x 120, leaves 3e-4 beside it where nothing is left.
            least[: len(numbers.parameters)][[p.is_color for p in numbers.parameters]] = 1e-3
        # The numbers that are traced come first, then those of the film that are stated, which are no suspects.
        attributes = [parameter.attribute for parameter in numbers.parameters]
        attributes += [None] * (len(numbers.names) - len(attributes)) + [change.effect.attribute for change in of_film]
        values = [*numbers.value, *(change.value for change in of_film)]
        stated = tuple(zip(map(float, values), attributes, strict=True))
        reach = [(-math.inf, math.inf)] * len(numbers.names) + [change.reach for change in of_film]
        for k, parameter in enumerate(numbers.parameters):
            linear = (LINEAR_PART_OF_LIGHT if parameter.is_color else LINEAR_PART) * float(numbers.size[k])
            reach[k] = reach_of(parameter.attribute, stated[k][0], linear or math.inf)
        changes = np.concatenate([by_number, film_rows(of_film, pixels)])
        return cls(tuple(causes), changes, tuple(of_film), least, stated, tuple(reach))

    def amount(self, place: int, found: float) -> float:
        """The amount by which the target exceeds the scene, for one that was found."""
        at = place - (len(self.causes) - len(self.of_film))
        return self.of_film[at].amount(found) if at >= 0 else found

    def is_possible(self, place: int, found: float) -> bool:
        """Whether the number at a place can have the value that a found amount gives it."""
        value, attribute = self.stated[place]
        if attribute is None:
            return True
        there, (least, most) = value + self.amount(place, found), attribute.quantity.range_at(value)
        return least <= there <= most and (attribute.limit is None or attribute.limit.holds(np.array(there)))

    def within_reach(self, found: Float[np.ndarray, " suspects"]) -> Float[np.ndarray, " suspects"]:
        """The found amounts, each of which is moved to the end of its reach where it lies beyond."""
        least, most = np.reshape(self.reach, (-1, 2)).T
        return np.clip(found, least, most)

    def cause(self, place: int, found: float, score: float) -> Cause:
        """The cause at a place with its amount and score; for a value that cannot be, the advice is another one."""
        cause = self.causes[place]._replace(amount=self.amount(place, found), score=score)
        if self.is_possible(place, found):
            return cause
        attribute = self.stated[place][1]
        limit = attribute and attribute.limit
        wanted = f"must be {limit.wanted}" if limit else "cannot change so much"
        return cause._replace(advice=f"look at the residual, for {cause.name} {wanted}")

    def without(self, granted) -> "Suspects":
        """The suspects without some of the fixed numbers, which come first."""
        keep = np.concatenate([~granted, np.ones(len(self.causes) - len(granted), bool)])
        changes, least = self.changes[keep], self.least_left[keep]
        causes, stated = tuple(itertools.compress(self.causes, keep)), tuple(itertools.compress(self.stated, keep))
        return Suspects(causes, changes, self.of_film, least, stated, tuple(itertools.compress(self.reach, keep)))


def film_rows(changes: list[FilmChange], pixels: SampledPicture) -> Float[np.ndarray, "changes rows"]:
    """Changes by the film as weighted rows of the judged pixels."""
    found = [flat(pixels.judged.of(one.change)[None] * pixels.root_weight) for one in changes]
    return np.concatenate(found) if found else np.zeros((0, 3 * len(pixels.judged.row)))
