"""The check of the model: fixed numbers that the answer rests on, and causes of a residual that is not noise."""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from raytrace_jax.inverse.judge.assumptions import FAR_SIGNIFICANT, Assumption, Cause, ModelCheck
from raytrace_jax.inverse.judge.changes import (
    PixelSample,
    extent_of,
    flat,
    number_changes,
    parameter_changes,
    pixels_to_check,
)
from raytrace_jax.inverse.judge.structure import PairScores, block_scatter, pair_scores
from raytrace_jax.inverse.judge.suspects import (
    Rows,
    Suspects,
    film_rows,
    fitted,
    orthogonal_to,
    score_changes,
    stated_changes,
    suspected_changes,
)
from raytrace_jax.inverse.judge.uncertainty import RANK_ROUNDINGS
from raytrace_jax.inverse.problem.fixed import FixedNumbers, fixed_numbers, root_covariance
from raytrace_jax.inverse.problem.observation import Observation
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.unknowns import Covariance, Image, Values

SIGNIFICANT = 4.5
"""Standard score from which on a change explains a residual. Of 114 changes the largest score of noise alone, white,
unequal, heavy-tailed or of all channels together, was 4.0 in 840 draws, on pictures of 160 x 120 and of 40 x 30; of
noise correlated over a pixel 4.8 in 200, more than 4.5 in one of them."""


def check_model(
    state: FitState,
    standard_error: Values,
    uncertain: Mapping[str, float],
    correlations: Mapping[tuple[str, str], float] | None = None,
    check_clock: Callable[[], None] = lambda: None,
) -> ModelCheck:
    """Check the model at an unblurred optimum.

    The estimate moves with a fixed number p as `d theta / dp = -(J^T W J)^-1 J^T W j`, j the picture's derivative by p
    and W the loss's weights. A residual can show of p only what J leaves of j. Whether it holds that is tested, and so
    are the changes that a camera makes. A number that is stated to be uncertain may be anything within what was stated:
    it is no cause.

    Args:
        uncertain: standard deviation by canonical name of a fixed number.
        check_clock: called before each few scenes are rendered; what it raises ends the check.
    """
    problem, y, linearization = state.problem, state.y, state.linearization
    # How the picture changes with the free parameters, the scene's fixed numbers, and the film's stated ones.
    pixels = dataclasses.replace(pixels_to_check(problem, y, state.stage, linearization), check_clock=check_clock)
    light = np.asarray(linearization.image if pixels.radiance is None else pixels.radiance, np.float64)
    light = light + np.asarray(problem.observation.bias, np.float64)
    numbers = fixed_numbers(problem, uncertain)
    free = flat(parameter_changes(pixels))
    by_number = flat(number_changes(pixels, numbers)) if numbers.names else np.zeros((0, free.shape[1]))
    of_film = stated_changes(problem, y, light, uncertain)
    by_number = np.concatenate([by_number, film_rows(of_film, pixels)])
    numbers = numbers.followed_by([c.name for c in of_film], [c.value for c in of_film])

    # The residual beyond what the stages of the observation make by themselves is evidence.
    residual, weight = np.asarray(state.residual, np.float64), state.under_loss("weight")
    bound = functools.reduce(np.maximum, (one.bound(problem.observation) for one in problem.stages), np.zeros(()))
    evidence = beyond(problem.observation, residual, weight, bound)
    rows = rows_of(pixels.judged, residual, evidence, weight)
    step = pixels.judged.of(np.broadcast_to(weighted(problem.observation, bound), residual.shape)).reshape(-1)

    # How far the estimate moves with each fixed number, and with those that are stated to be uncertain.
    sensitivity = -fitted(free, by_number, rows.weight)
    spread = np.array([uncertain.get(name, 0.0) for name in numbers.names])
    is_stated = spread > 0
    named = [name for name, one in zip(numbers.names, is_stated, strict=True) if one]
    moved = sensitivity[:, is_stated] @ root_covariance(named, spread[is_stated], correlations or {}).T
    assumptions = ranked(numbers, sensitivity, spread, standard_error)

    # What the residual looks like; the stated numbers are granted, as the free ones are.
    if not evidence.any():
        return ModelCheck(assumptions, (), PairScores(0.0, 0.0), moved @ moved.T, np.zeros((len(free), len(free))))
    suspects = Suspects.of(suspected_changes(problem, y, light, uncertain), pixels, numbers, by_number)
    granted = np.concatenate([free, by_number[is_stated]])
    rest = weight * evidence
    if is_stated.any():  # How hard the residual pulls once what is granted has been fitted to it; 0 at other pixels.
        judged, rest = pixels.judged, np.zeros(weight.shape)
        pulls = orthogonal_to(granted, rows.evidence[None], rows.weight)[0] * rows.weight * np.tile(judged.chance, 3)
        rest[:, judged.row, judged.column] = pulls.reshape(3, -1)
    pairs = pair_scores(rest, extent_of(problem))
    causes, structure = find_causes(rows, free, granted, suspects.without(is_stated), standard_error, step)

    # Errors that go together over many pixels count in the error, also without a cause.
    far_matters = False
    if pairs.far > FAR_SIGNIFICANT:
        slope = problem.slopes(y)
        jacobian = np.asarray(linearization.pixel_jacobian, np.float64)
        scatter = block_scatter(jacobian / np.where(slope, slope, 1.0)[:, None, None, None], weight, residual)
        structure = structure + scatter
        moves = largest_shift(np.sqrt(np.diagonal(scatter))[:, None], standard_error)[0] > 1
        jump = np.array(max((one.jump(problem.observation) for one in problem.stages), default=0.0))
        far_matters = bool(moves or beyond(problem.observation, evidence, weight, jump).any())
    return ModelCheck(assumptions, causes, pairs, moved @ moved.T, structure, far_matters)


def rows_of(sample: PixelSample, residual, evidence, weight: Image) -> Rows:
    """The looked-at pixels' residuals, evidence and weights under the loss, as rows."""
    counted = sample.of(weight) / sample.chance
    flat_residual, flat_evidence = sample.of(residual).reshape(-1), sample.of(evidence).reshape(-1)
    return Rows(flat_residual, flat_evidence, counted.reshape(-1), np.tile(sample.square, 3))


def beyond(observation: Observation, residual: Image, weight: Image, bound: np.ndarray) -> Image:
    """The residuals, but 0 where a bound of them, or the roundings of the fit's precision, may have made them.

    Storing rounds equal colours equally, over whole areas, and that is not noise. Where nearly all residuals of flat
    areas are within the bound there is no noise beside it, and only what is beyond is evidence. Elsewhere all are. At
    edges random samples make noise of their own, which tells nothing of the flat areas.

    Args:
        bound: of each of the target's numbers, in its own unit.
    """
    target, counts = np.asarray(observation.target), observation.counts
    within = np.abs(residual) <= weighted(observation, bound)
    values = np.asarray(target, np.float64)
    neighbours = (1, 3, 3)
    span = ndimage.maximum_filter(values, neighbours) - ndimage.minimum_filter(values, neighbours)
    is_flat = counts & (span <= 4.0 * bound)
    judged = is_flat if np.mean(is_flat) > 0.05 else np.broadcast_to(counts, is_flat.shape)
    # Of noise as large as the bound three quarters are within it, of half of that all.
    outside = np.where(within, 0.0, residual) if np.mean(within[judged]) > 0.9 else residual
    rounding = RANK_ROUNDINGS * float(np.finfo(target.dtype).eps) * float(np.max(weighted(observation, np.abs(target))))
    return outside if np.sqrt(np.mean((weight * outside) ** 2)) >= rounding else np.zeros_like(outside)


def weighted(observation: Observation, size: np.ndarray) -> np.ndarray:
    """Sizes in the target's unit in that of its weighted residual; 0 where the weight is 0."""
    # A clamped number's step has no end: it must not meet a weight of 0.
    root = np.asarray(observation.root_weight, np.float64)
    return np.where(root > 0, size, 0.0) * root


def largest_shift(shifts: Float[np.ndarray, "parameters changes"], standard_error) -> Float[np.ndarray, " changes"]:
    """The largest shift of an estimate by each change, in its standard errors; 0 where it has none."""
    error = np.where(np.isfinite(standard_error) & (standard_error > 0), standard_error, np.inf)
    return np.max(np.abs(shifts) / error[:, None], axis=0, initial=0)


def ranked(numbers: FixedNumbers, sensitivity, spread, standard_error) -> tuple[Assumption, ...]:
    """The fixed numbers as assumptions, ranked by how far the same share of each moves an estimate, the most first."""
    consequence = largest_shift(sensitivity, standard_error) * numbers.size
    return tuple(
        Assumption(
            numbers.names[k],
            float(numbers.value[k]),
            float(numbers.size[k]),
            float(spread[k]),
            sensitivity[:, k],
            numbers.parameters[k].attribute.unit if k < len(numbers.parameters) else "",
        )
        for k in np.argsort(-consequence, kind="stable")
    )


def find_causes(
    rows: Rows, free, granted, suspects: Suspects, standard_error, step: Float[np.ndarray, " rows"]
) -> tuple[tuple[Cause, ...], Covariance]:
    """The causes of a residual: one after the other, each beside those before.

    Several changes may explain it about as well. The best one is named, and the one that would move the estimate
    furthest counts in the error. Of a change of which the free parameters leave little the residual may seem to have
    many times what can be: it counts as far as its reach, if that explains half as much, and else not. A change that no
    row shows by more than the `step` that the stages make may be theirs as well, since equal colours are rounded alike
    over whole areas: it counts in the error and is no cause.

    Returns:
        The causes, the best explanation first; and what they do to the estimate, as a covariance.
    """
    sensitivity = -fitted(free, suspects.changes, rows.weight)
    structure, found = np.zeros((len(free), len(free))), []
    for _ in range(8):  # A camera that nobody stated is five.
        tests = score_changes(rows, granted, suspects.changes, suspects.least_left)
        # Where one cause was found something is wrong, and chance is no rival of a further one.
        gain = np.where(np.abs(tests.score) > (3.5 if found else SIGNIFICANT), tests.gain, 0.0)
        if not gain.any():
            break
        # The residual is the picture minus the target: the target has that much less of the change. Of an amount beyond
        # its reach the part s within it explains 1 - (1 - s)^2 of what all of it would.
        amount = -suspects.within_reach(-tests.amount)
        share = np.divide(amount, tests.amount, out=np.ones_like(amount), where=amount != tests.amount)
        part = share * (2 - share)
        within = np.where(part > 0.5, gain * part, 0.0)
        # A value that cannot be is named only if no possible one explains about as much, and what is far beyond its
        # reach only if nothing else explains anything.
        are_possible = [suspects.is_possible(place, -float(found)) for place, found in enumerate(tests.amount)]
        possible = np.where(are_possible, within, 0.0)
        is_told = np.max(possible) > 0.5 * np.max(within)
        gain = possible if is_told else within if within.any() else gain
        # Where several do exactly the same the first is taken: a number of the scene before what a camera does.
        best = int(np.flatnonzero(gain >= (1 - 1e-6) * np.max(gain))[0])
        if np.any(np.abs(tests.amount[best] * suspects.changes[best]) > step):
            found.append(suspects.cause(best, -float(tests.amount[best]), abs(float(tests.score[best]))))
        # The error takes the worst of the rivals, as nothing tells them apart.
        shifts, rival = sensitivity * amount, (gain > 0.5 * gain[best]) & (within > 0)
        furthest = int(np.argmax(np.where(rival, largest_shift(shifts, standard_error), -1.0)))
        structure += rival[furthest] * np.outer(shifts[:, furthest], shifts[:, furthest])
        granted = np.concatenate([granted, suspects.changes[best : best + 1]])
    return tuple(found), structure
