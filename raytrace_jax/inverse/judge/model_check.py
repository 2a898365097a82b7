"""The check of the model: fixed numbers that the answer rests on, and causes of a residual that is not noise."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...util.digits import Measurement, with_error
from ...util.numerics import MAD_TO_SIGMA, TINY, on_host, root_diagonal, solve_normal
from ...util.text import listed
from ..problem.fixed import Correlations, Spreads, fixed_numbers, root_covariance
from ..problem.noise import sample_jump, storage_bound
from ..problem.problem import FitState
from ..problem.unknowns import Covariance, Image, Values
from .columns import CheckClock, PixelSample, free_columns, pixels_to_check
from .score_test import (
    Cause,
    Column,
    Columns,
    Hypothesis,
    Rows,
    find_causes,
    fitted,
    largest_shift,
    orthogonal_to,
    response_hypotheses,
    scene_hypotheses,
    stacked,
)
from .structure import beyond, block_scatter, distant_correlation, weighted

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
    sensitivity: Values
    unit: str = ""


class Contradiction(NamedTuple):
    """A number that was stated and comes out otherwise.

    Args:
        found: the estimate and its standard deviation.
        stated: mean and standard deviation before.
        deviations: how far they are apart, in standard deviations of their difference.
    """

    name: str
    found: Measurement
    stated: Measurement
    deviations: float

    @classmethod
    def of(cls, name: str, found: Measurement, stated: Measurement, excess: float = 0.0):
        """Compare an estimate with what was stated.

        Of least squares `Var(estimate - stated mean) = stated variance - variance of the estimate`. It is at least a
        tenth of the stated standard deviation: a picture that says next to nothing does not contradict, and a solver
        rests somewhere near.

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
    return tuple(sorted((each for each in compared if each.deviations > 3.0), key=lambda each: -each.deviations))


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


@dataclasses.dataclass(frozen=True)
class ModelCheck:
    """The findings of a check of the model.

    Args:
        assumptions: the most consequential first.
        causes: the best explanation first.
        stated, structure: covariance of the estimate from numbers that are stated to be uncertain, and from what the
            residual shows.
        distant_correlation: standard score of the correlation of distant pixels, see `structure.distant_correlation`.
        is_structured: whether the residual is more than noise: it has a cause, or distant pixels correlate by more than
            single samples at edges make.
        displaced: words of `still.compare_still` on what is elsewhere than the scene says.
    """

    assumptions: tuple[Assumption, ...]
    causes: tuple[Cause, ...]
    stated: Covariance
    structure: Covariance
    distant_correlation: float = 0.0
    is_structured: bool = False
    displaced: str = ""

    @classmethod
    def nothing(cls, count: int) -> "ModelCheck":
        """The check of a fit of `count` parameters whose model was not looked at."""
        return cls((), (), np.zeros((count, count)), np.zeros((count, count)))

    @property
    def covariance(self) -> Covariance:
        """That of all systematic errors."""
        return self.stated + self.structure

    @property
    def looks(self) -> str:
        """What the residual looks like, after what is displaced, as the end of a sentence; empty without a cause."""
        causes = listed(cause.words for cause in self.causes)
        return self.displaced + (f". The residual looks like {causes}" if self.causes else "")

    def dependence(self, parameter: int, name: str, error: float) -> Dependence | None:
        """What an estimate with an error depends on most, of the numbers without a stated uncertainty."""
        exact = [number for number in self.assumptions if not number.uncertainty and number.size]
        if not exact or not 0 < error < math.inf:
            return None
        most = max(exact, key=lambda number: abs(float(number.sensitivity[parameter])) * number.size)
        change = WHAT_IF * most.size
        shift = float(most.sensitivity[parameter]) * change
        if not math.isfinite(shift) or not shift:
            return None
        return Dependence(name, most.name, change, most.unit, shift, abs(shift) / error)


def short_count(errors: float) -> str:
    """Two digits of a number of errors, as people write it."""
    rounded = float(f"{errors:.1e}")
    if rounded >= 100_000:  # A picture without noise has nearly no error, and anything is very many of them.
        return "more than 100,000"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"


def expected_error(
    state: FitState,
    uncertain: Spreads,
    correlations: Correlations,
    check_clock: CheckClock = lambda: None,
) -> Values:
    """About the standard errors of the unknowns, before the last steps: those of white noise, and of what is stated.

    It is a bound from below. The noise is that of the typical pixel, for those at edges are still off by how they are
    sampled. A few pixels tell what the scene's stated numbers do; the response's are left out. What is stated counts up
    to thirty errors of the noise: a tenth of that is left in no pixel of a picture of ten thousand.
    """
    problem, triangle = state.problem, on_host(state.joint.jacobian)
    sigma = MAD_TO_SIGMA * state.typical
    variance = sigma**2 * np.diagonal(solve_normal(triangle.T @ triangle, np.eye(triangle.shape[1])))
    if not any(fixed_numbers(view, uncertain).keys() & uncertain for view in problem.views):
        return np.sqrt(variance)
    views = []
    for view in state.views:
        pixels = pixels_to_check(view, 4000, check_clock)
        weight = (pixels.sampled.of(view.under_loss("weight")) / pixels.sampled.probability).reshape(-1)
        views.append((weight, scene_hypotheses(pixels, uncertain, only_stated=True), free_columns(pixels)))
    weights, hypotheses, free = zip(*views, strict=True)
    weight, numbers = np.concatenate(weights), merged(hypotheses, [len(each) for each in weights])
    sensitivity = -fitted(side_by_side(free), stacked(numbers, weight), weight)
    names = {number.name for number in numbers}
    among = {pair: value for pair, value in correlations.items() if names.issuperset(pair)}
    stated = np.sum(stated_moves(sensitivity, numbers, among) ** 2, axis=1)
    stated /= np.maximum(problem.slopes(state.y) ** 2, TINY)
    return np.sqrt(np.minimum(variance + stated, 30**2 * variance))


def side_by_side(columns: Sequence[Float[np.ndarray, "numbers 3 _"]]) -> Columns:
    """The columns of numbers at the pixels of all views, as rows of one problem."""
    return np.concatenate([each.reshape(len(each), -1) for each in columns], axis=1)


def merged(views: Sequence[Sequence[Hypothesis]], lengths: Sequence[int]) -> list[Hypothesis]:
    """The hypotheses of all views by their names; a view that does not show a number has a column of 0.

    Args:
        lengths: the number of each view's rows.
    """
    by_name = [{each.name: each for each in view} for view in views]
    names = dict.fromkeys(name for view in by_name for name in view)
    found = []
    for name in names:
        columns = [view[name].column if name in view else np.zeros(n) for view, n in zip(by_name, lengths, strict=True)]
        one = next(view[name] for view in by_name if name in view)
        found.append(one._replace(column=np.concatenate(columns)))
    return found


def stated_moves(
    sensitivity: Float[np.ndarray, "parameters numbers"], numbers: Sequence[Hypothesis], correlations: Correlations
) -> Float[np.ndarray, "parameters parts"]:
    """How far each independent part of what is stated of some numbers moves the values, by their sensitivity."""
    stated = [k for k, number in enumerate(numbers) if number.uncertainty]
    spread = np.array([numbers[k].uncertainty for k in stated])
    return sensitivity[:, stated] @ root_covariance([numbers[k].name for k in stated], spread, correlations).T


def check_model(
    state: FitState,
    standard_error: Values,
    uncertain: Spreads,
    correlations: Correlations = MappingProxyType({}),
    check_clock: CheckClock = lambda: None,
) -> ModelCheck:
    """Check the model at an unblurred optimum.

    The estimate moves with a fixed number p as `d theta / dp = -(J^T W J)^-1 J^T W j`, j the picture's derivative by p
    and W the loss's weights. A residual can show of p only what J leaves of j. Whether it holds that is tested, and so
    are the changes that a camera makes. A number that is stated to be uncertain may be anything within what was stated:
    it is a nuisance and no cause.

    Args:
        uncertain: standard deviation by canonical name of a fixed number.
        check_clock: called before each few scenes are rendered; raise in it to abort.
    """
    problem = state.problem
    views = [checked_view(view, uncertain, check_clock) for view in state.views]
    rows = joined_rows([view.rows for view in views])
    lengths = [len(view.rows.residual) for view in views]
    free = side_by_side([view.free for view in views])
    of_scene, of_response = (merged(each, lengths) for each in zip(*(view.hypotheses for view in views), strict=True))

    # How far the estimate moves with each fixed number, ranked by what the same share of each does to it.
    numbers = [*of_scene, *(each for each in of_response if each.uncertainty)]
    columns = stacked(numbers, rows.weight)
    sensitivity = -fitted(free, columns, rows.weight)
    moved = stated_moves(sensitivity, numbers, correlations)
    consequence = largest_shift(sensitivity, standard_error) * np.array([each.size for each in numbers])
    ranked = [(numbers[k], sensitivity[:, k]) for k in np.argsort(-consequence, kind="stable")]
    assumptions = tuple(
        Assumption(n.name, n.value, n.size, n.uncertainty, shift, n.attribute.unit) for n, shift in ranked
    )

    # What the residual looks like beside what is free or stated to be uncertain.
    is_stated = [each.uncertainty > 0 for each in numbers]
    nuisance = np.concatenate([free, columns[is_stated]])
    pulls = [view.weight * view.evidence for view in views]
    if any(is_stated):  # How hard the residual pulls once the nuisance has been fitted to it; 0 at other pixels.
        rest = orthogonal_to(nuisance, rows.evidence[None], rows.weight)[0] * rows.weight
        parts = zip(views, np.split(rest, np.cumsum(lengths)[:-1]), strict=True)
        pulls = [view.spread_out(part) for view, part in parts]
    hypotheses = [each for each in (*of_scene, *of_response) if not each.uncertainty]
    causes, structure = find_causes(rows, free, nuisance, hypotheses, standard_error)

    # Errors that go together over many pixels count in the error, also without a cause. They speak against the model if
    # they move an estimate by more than its standard error, or are more than single samples at edges make.
    pairs = zip(pulls, problem.views, strict=True)
    correlation, is_structured = max(distant_correlation(pull, view.extent) for pull, view in pairs), bool(causes)
    if correlation > 3.0:
        slope = problem.slopes(state.y)
        slope = np.where(slope, slope, 1.0)[:, None, None, None]
        scatter = block_scatter(
            [
                (on_host(view.linearization.pixel_jacobian) / slope, checked.weight, view.residual)
                for view, checked in zip(state.views, views, strict=True)
            ]
        )
        structure = structure + scatter
        is_structured |= bool(largest_shift(root_diagonal(scatter)[:, None], standard_error)[0] > 1)
        is_structured |= any(view.is_beyond_samples for view in views)
    return ModelCheck(assumptions, causes, moved @ moved.T, structure, correlation, is_structured)


class CheckedView(NamedTuple):
    """What a view tells a check of the model: at its sampled pixels, and of all of them.

    Args:
        free: the derivative of the weighted residual by each free number.
        hypotheses: of the scene's fixed numbers, and of the response's.
        weight, evidence: of each of the target's numbers, as in `Rows`, but not over the pixel's probability.
    """

    state: FitState
    sampled: PixelSample
    rows: Rows
    free: Float[np.ndarray, "parameters 3 pixels"]
    hypotheses: tuple[list[Hypothesis], list[Hypothesis]]
    weight: Image
    evidence: Image

    def spread_out(self, rows: Column) -> Image:
        """Numbers at the sampled pixels as a picture of what each stands for; 0 at other pixels."""
        image = np.zeros(self.weight.shape)
        image[:, self.sampled.row, self.sampled.column] = rows.reshape(3, -1) * self.sampled.probability
        return image

    @property
    def is_beyond_samples(self) -> bool:
        """Whether the evidence is more than single samples at edges make."""
        observation, jump = self.state.problem.observation, np.array(sample_jump(self.state))
        return bool(beyond(observation, self.evidence, self.weight, jump).any())


def checked_view(state: FitState, uncertain: Spreads, check_clock: CheckClock) -> CheckedView:
    """Sample a view's pixels, with their derivatives by what is free, by the scene's fixed numbers, and the response's.

    Evidence is the residual beyond what the storing of the target makes by itself.
    """
    linearization, observation = state.linearization, state.problem.observation
    pixels = pixels_to_check(state, check_clock=check_clock)
    sampled = pixels.sampled
    light = on_host(linearization.image if pixels.radiance is None else pixels.radiance)
    free = free_columns(pixels)
    of_scene = scene_hypotheses(pixels, uncertain)
    of_response = list(response_hypotheses(pixels, light + on_host(observation.bias), uncertain))
    residual, weight = on_host(state.residual), state.under_loss("weight")
    bound = storage_bound(state.problem)
    evidence = beyond(observation, residual, weight, bound)
    rows = Rows(
        residual=sampled.of(residual).reshape(-1),
        evidence=sampled.of(evidence).reshape(-1),
        weight=(sampled.of(weight) / sampled.probability).reshape(-1),
        block=np.tile(sampled.block, 3),
        bound=sampled.of(weighted(observation, bound)).reshape(-1),
    )
    return CheckedView(state, sampled, rows, free, (of_scene, of_response), weight, evidence)


def joined_rows(views: Sequence[Rows]) -> Rows:
    """The rows of all views, whose blocks are not each other's."""
    first = np.cumsum([0, *(view.block.max(initial=-1) + 1 for view in views[:-1])])
    views = [view._replace(block=view.block + start) for view, start in zip(views, first.tolist(), strict=True)]
    return Rows(*(np.concatenate(parts) for parts in zip(*views, strict=True)))
