"""The score test of a fit's model: which changes of the scene, or of the camera's response, the residual contains.

Each hypothesis is a number that was held fixed, and its column the residual's derivative by that number. The score of
the number, `j^T W r`, is 0 on average where the number is right: that is tested (Rao 1948; the Lagrange multiplier test
of Aitchison and Silvey 1958), beside the columns of all that is free or stated to be uncertain.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from ...scene.parameters import resolve
from ...scene.response import (
    FILM,
    RESPONSE_EFFECTS,
    ResponseEffect,
    apply_response_compiled,
    neutral_response,
    without_idle,
)
from ...scene.scene import CameraResponse
from ...scene.schema import RGB, Attribute, Range
from ...util.numerics import TINY, on_device, on_host, solve_normal
from ..problem.fixed import Spreads, fixed_numbers, moving_numbers, number_size
from ..problem.unknowns import Covariance, Image
from .columns import SampledPicture, number_columns

SIGNIFICANT = 4.5
"""Standard score from which on a change explains a residual. Of 114 changes the largest score of noise alone, white,
unequal, heavy-tailed or of all channels together, was 4.0 in 840 draws, on pictures of 160 x 120 and of 40 x 30; of
noise correlated over a pixel 4.8 in 200, more than 4.5 in one of them."""

Column = Float[np.ndarray, " rows"]
Columns = Float[np.ndarray, "_ rows"]


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


class Hypothesis(NamedTuple):
    """A fixed number of the scene, or of the camera's response, that may be off.

    Args:
        name: `film.gain.r`; without a component where all channels of an effect change together.
        value, size: the number in the scene, of several channels the first; and `number_size`.
        column: the weighted residual's derivative by the number, as rows; of an effect that grows with the number's
            square, by the square.
        uncertainty: the standard deviation that was stated; 0 if nothing was.
        effect: what the response does with it; None for a number of the scene.
        linear: up to this amount the picture changes in proportion.
        least_left: the least fraction of the column that the free parameters must leave to tell it from theirs.
    """

    name: str
    value: float
    size: float
    attribute: Attribute
    column: Column
    uncertainty: float = 0.0
    effect: ResponseEffect | None = None
    linear: float = math.inf
    least_left: float = 1e-6

    @property
    def reach(self) -> Range:
        """The least and the largest amount with a value that a fit allows, and in proportion."""
        # A sharper target is one more blur cannot give, but a camera can: its square goes on below 0.
        if self.effect and self.effect.is_squared:
            return -math.inf, math.inf
        least, most = self.attribute.quantity.range_at(self.value)
        return max(least - self.value, -self.linear), min(most - self.value, self.linear)

    def change(self, amount: float) -> float:
        """The change of the number itself by an amount of its column."""
        if not (self.effect and self.effect.is_squared):
            return amount
        square = self.value**2 + amount
        # The target is sharper than a picture without blur: by as much as a blur would take away.
        return math.copysign(math.sqrt(abs(square)), square) - self.value

    def is_possible(self, amount: float) -> bool:
        """Whether the number can have the value that an amount gives it."""
        value, limit = self.value + self.change(amount), self.attribute.limit
        least, most = self.attribute.quantity.range_at(self.value)
        return least <= value <= most and (limit is None or limit.holds(np.array(value)))

    def cause(self, amount: float, score: float) -> Cause:
        """The cause of that amount; for a value that cannot be, the advice is another one."""
        # Amounts are told in pixels, and in percent where a number has a size.
        unit = "px" if self.attribute.unit == "pixel" else "%" if self.size > 0 else ""
        unit, advice = (self.effect.unit, self.effect.advice) if self.effect else (unit, "free it, or measure it")
        advice = advice.replace("free it", f"free {self.name}")
        if not self.is_possible(amount):
            limit = self.attribute.limit
            must = f"must be {limit.wanted}" if limit else "cannot change so much"
            advice = f"look at the residual, for {self.name} {must}"
        per_unit = self.size / 100 if unit == "%" else 1.0
        return Cause(self.name, unit, per_unit, advice, self.change(amount), score)


def scene_hypotheses(pixels: SampledPicture, uncertain: Spreads, only_stated: bool = False) -> list[Hypothesis]:
    """The fixed numbers of the scene, or those of them that are stated to be uncertain.

    A colour, or a gamma, may be off by half of its size if the picture is to change in proportion; other numbers by a
    tenth: most move edges across pixels, where a solver's step ends at a tenth too.
    """
    scene, numbers = pixels.problem.scene, fixed_numbers(pixels.problem, uncertain)
    numbers = {name: (number,) for name, number in numbers.items() if name in uncertain or not only_stated}
    hypotheses = []
    for (name, (parameter,)), column in zip(numbers.items(), number_columns(pixels, numbers), strict=True):
        value, size = float(parameter.address.read(scene)), number_size(scene, parameter.address)
        linear = (0.5 if parameter.is_color else 0.1) * size or math.inf
        # A few points tell how a colour changes an edge-aware picture, and a free gain is exact: the light of a
        # checker, 160 x 120, leaves 3e-4 beside it where nothing is left.
        least_left, stated = 1e-3 if parameter.is_color and pixels.is_aware else 1e-6, uncertain.get(name, 0.0)
        column = column.reshape(-1)
        hypotheses.append(Hypothesis(name, value, size, parameter.attribute, column, stated, None, linear, least_left))
    return hypotheses


def response_hypotheses(
    pixels: SampledPicture, light: Image, uncertain: Mapping[str, float] = {}
) -> Iterator[Hypothesis]:
    """The numbers of the camera's response, and all channels of an effect together, but for those that are free.

    Of channels that are tied each is a hypothesis, but not all of them together. A scene without a response has one
    that does nothing.

    Args:
        light: the picture before the response.
        uncertain: standard deviation by name of a number: the step of its difference as well. The column is that per
            unit of the number itself.
    """
    problem = pixels.problem
    film = problem.scene_at(pixels.state.y).film
    if film is None:
        film = neutral_response(problem.dtype)
        if problem.whole.further_views:  # Each has its own, of the camera's name.
            film = dataclasses.replace(film, name=problem.scene.camera.name)
    free = set(moving_numbers(problem.scene, dataclasses.replace(problem.local, ties=())))
    leaders = {resolve(problem.scene, leader).address for _, leader in problem.local.ties}
    alone, tied = ({(a.field, a.component or 0) for a in each if a.group == FILM} for each in (free - leaders, leaders))

    def developed(film: CameraResponse) -> Image:
        film, frame = without_idle(film), problem.frame()
        return on_host(apply_response_compiled(problem.array(light), film, frame))

    before = developed(film)
    for effect in RESPONSE_EFFECTS:
        values = np.atleast_1d(np.asarray(getattr(film, effect.name)))
        components, whole = effect.attribute.components, f"{film.name}.{effect.name}"
        # What the light's numbers do differs, and all of them together are no likely cause.
        parts = {whole: range(len(values))} if components in ((), RGB) else {}
        parts |= {f"{whole}.{component}": range(k, k + 1) for k, component in enumerate(components)}
        for name, numbers in parts.items():
            value, stated, moving = (
                float(values[numbers[0]]),
                uncertain.get(name, 0.0),
                {(effect.name, k) for k in numbers},
            )
            if moving & alone or (len(numbers) > 1 and moving & tied):
                continue
            step, is_squared = stated or effect.step, effect.is_squared and not stated
            moved = values.copy()
            moved[numbers] += math.hypot(value, step) - value if is_squared else step
            moved = on_device(moved.reshape(effect.attribute.shape))
            change = developed(dataclasses.replace(film, **{effect.name: moved})) - before
            column = pixels.sampled.of(change / (step**2 if is_squared else step)) * pixels.root_weight
            linear = math.inf if effect.is_linear or effect.unit != "%" else 0.5 * value
            yield Hypothesis(name, value, abs(value), effect.attribute, column.reshape(-1), stated, effect, linear)


class Rows(NamedTuple):
    """Numbers of some pixels, as rows of a least-squares problem.

    Args:
        evidence: the weighted residuals, but 0 where one says nothing.
        weight: what each counts: the loss's weight over the pixel's probability.
        block: number of the block of pixels in which each is; the rows of one block may err together.
        bound: the largest residual that the storing of the target makes by itself.
    """

    residual: Column
    evidence: Column
    weight: Column
    block: Int[np.ndarray, " rows"]
    bound: Column


def score_columns(rows: Rows, nuisance: Columns, columns: Columns, least_left: Float[np.ndarray, " changes"]):
    """Standard scores of columns as explanations of a residual, after the nuisance columns have been projected out.

    The amount of a change is found by least squares. Its spread comes from what the change leaves of the residual,
    summed by blocks of pixels (the sandwich: White 1980), so that it holds for noise of any distribution and unequal
    in size. What a block leaves is divided by one minus its fraction `f` of the change: otherwise a few blocks that
    decide would seem to agree with themselves (the jackknife: MacKinnon and White 1985). Amount over spread follows
    Student's distribution of `1 / sum(f^2) - 1` degrees of freedom: the effective number of blocks (Satterthwaite
    1946; Kish 1965) less one. The score is the value of a normal variable that chance exceeds as rarely.

    Args:
        nuisance: the columns of the parameters that are free or stated to be uncertain, "parameters rows".
        least_left: fraction of each column's squares that the nuisance must leave; below it the score is 0.

    Returns:
        For each column its standard score with a sign, at most 37, where chance is below 1e-300; how much of it the
        residual holds; and by how much the weighted sum of squares falls with it.
    """
    rest = orthogonal_to(nuisance, columns, rows.weight)
    by_block = block_totals(rest * rest * rows.weight, rows.block)
    left = by_block.sum(axis=1)
    is_seen = left > least_left * np.sum(columns * columns * rows.weight, axis=1)
    length = np.where(is_seen, left, 1.0)[:, None]
    fraction = by_block / length

    products = block_totals(rest * (rows.weight * rows.evidence), rows.block)
    evident = products.sum(axis=1, keepdims=True) / length
    errors = (products - evident * by_block) / np.maximum(1 - fraction, 1e-6)
    spread = np.maximum(np.sqrt(np.sum(errors**2, axis=1)), TINY)
    freedom = np.maximum(1 / np.maximum(np.sum(fraction**2, axis=1), TINY) - 1, 1e-6)
    # What only one block sees has no spread, and its ratio no end. Student's distribution is computed up to 1e100.
    ratio = np.minimum(np.abs(products.sum(axis=1)) / spread, 1e100)
    chance = special.stdtr(freedom, -ratio)
    score = -np.sign(evident[:, 0]) * special.ndtri(np.maximum(chance, TINY))

    # The amount is that of all residuals, also of those that are no evidence.
    in_all = rest @ (rows.weight * rows.residual)
    amount = np.where(is_seen, in_all / length[:, 0], 0.0)
    return np.where(is_seen & products.any(axis=1), score, 0.0), amount, amount * in_all


def orthogonal_to(free: Columns, columns: Columns, weight: Column) -> Columns:
    """The rest of columns when the free parameters have been fitted to them, `j - J fitted(j)`."""
    return columns - fitted(free, columns, weight).T @ free


def fitted(free: Columns, columns: Columns, weight: Column) -> Float[np.ndarray, "parameters changes"]:
    """The free parameters' least-squares fit to columns, `(J^T W J)^-1 J^T W j`, J their own columns.

    It is 0 along directions that these leave open.
    """
    pulled = free * weight
    return solve_normal(pulled @ free.T, pulled @ columns.T)


def block_totals(products: Columns, block: Int[np.ndarray, " rows"]) -> Float[np.ndarray, "changes blocks"]:
    """Sums over the rows of each block."""
    if not block.size:
        return np.zeros((len(products), 1))
    order = np.argsort(block, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(block[order])) + 1]
    return np.add.reduceat(products[:, order], starts, axis=1)


def stacked(numbers: Sequence[Hypothesis], weight: Column) -> Columns:
    """The columns of some numbers, of as many rows as there are weights."""
    return np.reshape([number.column for number in numbers], (len(numbers), len(weight)))


def largest_shift(shifts: Float[np.ndarray, "parameters changes"], standard_error) -> Float[np.ndarray, " changes"]:
    """The largest shift of an estimate by each change, in its standard errors; 0 where it has none."""
    error = np.where(np.isfinite(standard_error) & (standard_error > 0), standard_error, np.inf)
    return np.max(np.abs(shifts) / error[:, None], axis=0, initial=0)


def find_causes(
    rows: Rows, free: Columns, nuisance: Columns, hypotheses: Sequence[Hypothesis], standard_error
) -> tuple[tuple[Cause, ...], Covariance]:
    """The causes of a residual: one after the other, each beside those before.

    An amount is clipped to its reach, since of a column of which the free parameters leave little the residual may seem
    to have many times what can be. It is kept if the clipped amount explains at least half of what all of it would.
    Several columns may explain the residual about as well: the best is named, and the one that would move the estimate
    furthest counts in the error. A column that no row shows by more than the bound of the target's storage may be due
    to that, since equal colours are rounded alike over whole areas: it counts in the error and is no cause.

    Returns:
        The causes, the best explanation first; and what they do to the estimate, as a covariance.
    """
    structure, causes = np.zeros((len(free), len(free))), []
    columns = stacked(hypotheses, rows.weight)
    reach = np.reshape([each.reach for each in hypotheses], (-1, 2)).T
    least_left = np.array([each.least_left for each in hypotheses])
    sensitivity = -fitted(free, columns, rows.weight)
    for _ in range(8):  # A camera that nobody stated is five.
        # Where one cause was found something is wrong, and chance is no rival of a further one.
        scores, holds, gains = score_columns(rows, nuisance, columns, least_left)
        gains = np.where(np.abs(scores) > (3.5 if causes else SIGNIFICANT), gains, 0.0)
        if not gains.any():
            break
        # The residual is the picture minus the target: the target has that much less of the column. Of an amount beyond
        # its reach the share s within it explains 1 - (1 - s)^2 of what all of it would.
        amount = -np.clip(-holds, *reach)
        share = np.divide(amount, holds, out=np.ones_like(amount), where=amount != holds)
        explained = np.where(share * (2 - share) > 0.5, gains * share * (2 - share), 0.0)
        # A value that cannot be is named only if no possible one explains half as much, and what is far beyond its
        # reach only if nothing else explains anything.
        possible = [each.is_possible(-float(held)) for each, held in zip(hypotheses, holds, strict=True)]
        named = np.where(possible, explained, 0.0)
        if np.max(named) <= 0.5 * np.max(explained):
            named = explained if explained.any() else gains
        # Where several do exactly the same the first is taken: a number of the scene before what a camera does.
        best = int(np.flatnonzero(named >= (1 - 1e-6) * np.max(named))[0])
        if np.any(np.abs(holds[best] * columns[best]) > rows.bound):
            causes.append(hypotheses[best].cause(-float(holds[best]), abs(float(scores[best]))))
        # The error takes the worst of the rivals, as nothing tells them apart.
        shifts, rivals = sensitivity * amount, (named > 0.5 * named[best]) & (explained > 0)
        furthest = int(np.argmax(np.where(rivals, largest_shift(shifts, standard_error), -1.0)))
        structure += rivals[furthest] * np.outer(shifts[:, furthest], shifts[:, furthest])
        nuisance = np.concatenate([nuisance, columns[best : best + 1]])
    return tuple(causes), structure
