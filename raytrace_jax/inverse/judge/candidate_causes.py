"""Candidate causes of a residual, each number that was taken for granted or that a film has, and their scores."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from ...scene.parameters import resolve
from ...scene.response import FILM, FILM_EFFECTS, FilmEffect, develop_compiled, neutral_response, without_idle
from ...scene.scene import CameraResponse
from ...scene.schema import RGB, Attribute, Range
from ...util.numerics import TINY, on_device, solve_normal
from ..problem.fixed import fixed_numbers, number_size
from ..problem.unknowns import Covariance, Image
from .assumptions import Cause
from .changes import SampledPicture, number_changes

SIGNIFICANT = 4.5
"""Standard score from which on a change explains a residual. Of 114 changes the largest score of noise alone, white,
unequal, heavy-tailed or of all channels together, was 4.0 in 840 draws, on pictures of 160 x 120 and of 40 x 30; of
noise correlated over a pixel 4.8 in 200, more than 4.5 in one of them."""


class CandidateCause(NamedTuple):
    """A fixed number of the scene, or a number of its film, that may be off.

    Args:
        name: `film.gain.r`; without a component where all channels of an effect change together.
        value, size: the number in the scene, of several channels the first; and `number_size`.
        change: the weighted residual's derivative by the number, as rows; of an effect that grows with the number's
            square, by the square.
        uncertainty: the standard deviation that was stated; 0 if nothing was.
        effect: what a film does with it; None for a number of the scene.
        linear: up to this amount the picture changes in proportion.
        least_left: the least fraction of the change that the free parameters must leave to tell it from theirs.
    """

    name: str
    value: float
    size: float
    attribute: Attribute
    change: Float[np.ndarray, " rows"]
    uncertainty: float = 0.0
    effect: FilmEffect | None = None
    linear: float = math.inf
    least_left: float = 1e-6

    @property
    def reach(self) -> Range:
        """The least and the largest amount, as one is found, with a value that a fit allows, and in proportion."""
        # A sharper target is one more blur cannot give, but a camera can: its square goes on below 0.
        if self.effect and self.effect.is_squared:
            return -math.inf, math.inf
        least, most = self.attribute.quantity.range_at(self.value)
        return max(least - self.value, -self.linear), min(most - self.value, self.linear)

    def amount(self, found: float) -> float:
        """The change of the number itself, from an amount that was found."""
        if not (self.effect and self.effect.is_squared):
            return found
        square = self.value**2 + found
        # The target is sharper than a picture without blur: by as much as a blur would take away.
        return math.copysign(math.sqrt(abs(square)), square) - self.value

    def is_possible(self, found: float) -> bool:
        """Whether the number can have the value that a found amount gives it."""
        there, limit = self.value + self.amount(found), self.attribute.limit
        least, most = self.attribute.quantity.range_at(self.value)
        return least <= there <= most and (limit is None or limit.holds(np.array(there)))

    def cause(self, found: float, score: float) -> Cause:
        """The cause with a found amount; for a value that cannot be, the advice is another one."""
        # Amounts are told in pixels, and in percent where a number has a size.
        unit = "px" if self.attribute.unit == "pixel" else "%" if self.size > 0 else ""
        unit, advice = (self.effect.unit, self.effect.advice) if self.effect else (unit, "free it, or measure it")
        advice = advice.replace("free it", f"free {self.name}")
        if not self.is_possible(found):
            limit = self.attribute.limit
            wanted = f"must be {limit.wanted}" if limit else "cannot change so much"
            advice = f"look at the residual, for {self.name} {wanted}"
        per_unit = self.size / 100 if unit == "%" else 1.0
        return Cause(self.name, unit, per_unit, advice, self.amount(found), score)


def scene_candidates(
    pixels: SampledPicture, uncertain: Mapping[str, float], only_stated: bool = False
) -> Iterator[CandidateCause]:
    """The fixed numbers of the scene, or those of them that are stated to be uncertain.

    A colour, or a gamma, may be off by half of its size if the picture is to change in proportion; other numbers by a
    tenth: most move edges across pixels, where a solver's step ends at a tenth too.
    """
    scene, numbers = pixels.problem.scene, fixed_numbers(pixels.problem, uncertain)
    numbers = {name: number for name, number in numbers.items() if name in uncertain or not only_stated}
    for (name, parameter), change in zip(numbers.items(), number_changes(pixels, numbers), strict=True):
        size, is_color = number_size(scene, parameter.address), parameter.is_color
        yield CandidateCause(
            name,
            float(parameter.address.read(scene)),
            size,
            parameter.attribute,
            change.reshape(-1),
            uncertain.get(name, 0.0),
            linear=(0.5 if is_color else 0.1) * size or math.inf,
            # A few points tell how a colour changes an edge-aware picture, and a free gain is exact: the light of a
            # checker, 160 x 120, leaves 3e-4 beside it where nothing is left.
            least_left=1e-3 if is_color and pixels.edges == "aware" else 1e-6,
        )


def film_candidates(
    pixels: SampledPicture, light: Image, uncertain: Mapping[str, float] = {}
) -> Iterator[CandidateCause]:
    """The film's numbers, and all channels of an effect together, but for those that are free.

    Of channels that are tied each is a candidate, but not all of them together. A scene without a film has one that
    does nothing.

    Args:
        light: the picture before the film.
        uncertain: standard deviation by name of a number: the step of its difference as well. The change is that per
            unit of the number itself.
    """
    problem = pixels.problem
    film = problem.scene_at(pixels.y).film or neutral_response(problem.observation.target.dtype)
    free = {resolve(problem.scene, name).address for name in problem.unknowns.names}
    leaders = {resolve(problem.scene, leader).address for _, leader in problem.unknowns.ties}
    alone, tied = ({(a.field, a.component or 0) for a in one if a.group == FILM} for one in (free - leaders, leaders))

    def developed(film: CameraResponse) -> Image:
        film, frame = without_idle(film), problem.raster().frame
        return np.asarray(develop_compiled(problem.array(light), film, frame), np.float64)

    before = developed(film)
    for effect in FILM_EFFECTS:
        values = np.atleast_1d(np.asarray(getattr(film, effect.name)))
        whole = f"{film.name}.{effect.name}"
        # What the light's numbers do differs, and all of them together are no likely cause.
        parts = {whole: range(len(values))} if effect.attribute.components in ((), RGB) else {}
        parts |= {f"{whole}.{one}": range(k, k + 1) for k, one in enumerate(effect.attribute.components)}
        for name, places in parts.items():
            value, stated = float(values[places[0]]), uncertain.get(name, 0.0)
            moving = {(effect.name, k) for k in places}
            if not stated and (moving <= alone or (len(moving) > 1 and moving & tied)):
                continue
            step, is_squared = stated or effect.step, effect.is_squared and not stated
            moved = values.copy()
            moved[places] += math.hypot(value, step) - value if is_squared else step
            moved = on_device(moved.reshape(effect.attribute.shape))
            change = developed(dataclasses.replace(film, **{effect.name: moved})) - before
            rows = pixels.sampled.of(change / (step**2 if is_squared else step)) * pixels.root_weight
            linear = math.inf if effect.is_linear or effect.unit != "%" else 0.5 * value
            yield CandidateCause(
                name, value, abs(value), effect.attribute, rows.reshape(-1), stated, effect=effect, linear=linear
            )


class Rows(NamedTuple):
    """Numbers of some pixels, as rows of a least-squares problem.

    Args:
        evidence: the weighted residuals, but 0 where one says nothing.
        weight: what each counts: the loss's weight over the pixel's probability.
        square: number of the square of pixels in which each is; the rows of one square may err together.
        bound: the largest residual that the stages of the observation make by themselves.
    """

    residual: Float[np.ndarray, " rows"]
    evidence: Float[np.ndarray, " rows"]
    weight: Float[np.ndarray, " rows"]
    square: Int[np.ndarray, " rows"]
    bound: Float[np.ndarray, " rows"]


def score_changes(rows: Rows, nuisance, changes, least_left: Float[np.ndarray, " changes"]):
    """Score changes of a picture as explanations of a residual, as far as no nuisance parameter makes up for them.

    The amount of a change is found by least squares. Its spread comes from what the change leaves of the residual,
    summed by squares of pixels (the sandwich: White 1980), so that it holds for noise of any distribution and unequal
    in size. What a square leaves is divided by one minus its fraction `f` of the change: otherwise a few squares that
    decide would seem to agree with themselves (the jackknife: MacKinnon and White 1985). Amount over spread follows
    Student's distribution of `1 / sum(f^2) - 1` degrees of freedom: the effective number of squares (Satterthwaite
    1946; Kish 1965) less one. The score is the value of a normal variable that chance exceeds as rarely.

    Args:
        nuisance: the changes by parameters that are free or stated to be uncertain, "parameters rows".
        changes: the changes, "changes rows".
        least_left: fraction of each change's squares that the nuisance must leave; below it the score is 0.

    Returns:
        For each change its standard score with a sign, at most 37, where chance is below 1e-300; how much of it the
        residual holds; and by how much the weighted sum of squares falls with it.
    """
    rest = orthogonal_to(nuisance, changes, rows.weight)
    by_square = square_totals(rest * rest * rows.weight, rows.square)
    left = by_square.sum(axis=1)
    is_seen = left > least_left * np.sum(changes * changes * rows.weight, axis=1)
    length = np.where(is_seen, left, 1.0)[:, None]
    fraction = by_square / length

    products = square_totals(rest * (rows.weight * rows.evidence), rows.square)
    evident = products.sum(axis=1, keepdims=True) / length
    errors = (products - evident * by_square) / np.maximum(1 - fraction, 1e-6)
    spread = np.maximum(np.sqrt(np.sum(errors**2, axis=1)), TINY)
    freedom = np.maximum(1 / np.maximum(np.sum(fraction**2, axis=1), TINY) - 1, 1e-6)
    # What only one square sees has no spread, and its ratio no end. Student's distribution is computed up to 1e100.
    ratio = np.minimum(np.abs(products.sum(axis=1)) / spread, 1e100)
    chance = special.stdtr(freedom, -ratio)
    score = -np.sign(evident[:, 0]) * special.ndtri(np.maximum(chance, TINY))

    # The amount is that of all residuals, also of those that are no evidence.
    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / length[:, 0], 0.0)
    return np.where(is_seen & products.any(axis=1), score, 0.0), amount, amount * in_all


def orthogonal_to(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "changes rows"]:
    """The rest of changes when the free parameters have been fitted to them, `change - J fitted(change)`."""
    return changes - fitted(free, changes, weight).T @ free


def fitted(free, changes, weight: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "parameters changes"]:
    """The free parameters' least-squares fit to changes, `(J^T W J)^-1 J^T W change`, J their derivatives.

    It is 0 along directions that the derivatives leave open.
    """
    pulled = free * weight
    return solve_normal(pulled @ free.T, pulled @ changes.T)


def square_totals(products: Float[np.ndarray, "changes rows"], square: Int[np.ndarray, " rows"]):
    """Sums over the rows of each square, "changes squares"."""
    if not square.size:
        return np.zeros((len(products), 1))
    order = np.argsort(square, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(square[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)


def largest_shift(shifts: Float[np.ndarray, "parameters changes"], standard_error) -> Float[np.ndarray, " changes"]:
    """The largest shift of an estimate by each change, in its standard errors; 0 where it has none."""
    error = np.where(np.isfinite(standard_error) & (standard_error > 0), standard_error, np.inf)
    return np.max(np.abs(shifts) / error[:, None], axis=0, initial=0)


def find_causes(
    rows: Rows, free, nuisance, candidates: Sequence[CandidateCause], standard_error
) -> tuple[tuple[Cause, ...], Covariance]:
    """The causes of a residual: one after the other, each beside those before.

    Several changes may explain it about as well. The best one is named, and the one that would move the estimate
    furthest counts in the error. Of a change of which the free parameters leave little the residual may seem to have
    many times what can be: it counts as far as its reach, if that explains half as much, and else not. A change that no
    row shows by more than the bound of the stages may be theirs as well, since equal colours are rounded alike over
    whole areas: it counts in the error and is no cause.

    Returns:
        The causes, the best explanation first; and what they do to the estimate, as a covariance.
    """
    structure, found = np.zeros((len(free), len(free))), []
    changes = np.reshape([one.change for one in candidates], (len(candidates), free.shape[1]))
    reach = np.reshape([one.reach for one in candidates], (-1, 2)).T
    least_left = np.array([one.least_left for one in candidates])
    sensitivity = -fitted(free, changes, rows.weight)
    for _ in range(8):  # A camera that nobody stated is five.
        scores, holds, gains = score_changes(rows, nuisance, changes, least_left)
        # Where one cause was found something is wrong, and chance is no rival of a further one.
        gain = np.where(np.abs(scores) > (3.5 if found else SIGNIFICANT), gains, 0.0)
        if not gain.any():
            break
        # The residual is the picture minus the target: the target has that much less of the change. Of an amount beyond
        # its reach the part s within it explains 1 - (1 - s)^2 of what all of it would.
        amount = -np.clip(-holds, *reach)
        share = np.divide(amount, holds, out=np.ones_like(amount), where=amount != holds)
        part = share * (2 - share)
        within = np.where(part > 0.5, gain * part, 0.0)
        # A value that cannot be is named only if no possible one explains about as much, and what is far beyond its
        # reach only if nothing else explains anything.
        are_possible = [one.is_possible(-float(held)) for one, held in zip(candidates, holds, strict=True)]
        possible = np.where(are_possible, within, 0.0)
        is_told = np.max(possible) > 0.5 * np.max(within)
        gain = possible if is_told else within if within.any() else gain
        # Where several do exactly the same the first is taken: a number of the scene before what a camera does.
        best = int(np.flatnonzero(gain >= (1 - 1e-6) * np.max(gain))[0])
        if np.any(np.abs(holds[best] * changes[best]) > rows.bound):
            found.append(candidates[best].cause(-float(holds[best]), abs(float(scores[best]))))
        # The error takes the worst of the rivals, as nothing tells them apart.
        shifts, rival = sensitivity * amount, (gain > 0.5 * gain[best]) & (within > 0)
        furthest = int(np.argmax(np.where(rival, largest_shift(shifts, standard_error), -1.0)))
        structure += rival[furthest] * np.outer(shifts[:, furthest], shifts[:, furthest])
        nuisance = np.concatenate([nuisance, changes[best : best + 1]])
    return tuple(found), structure
