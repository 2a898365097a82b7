"""The check of the model: fixed numbers that the answer rests on, and causes of a residual that is not noise."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...util.numerics import MAD_TO_SIGMA, TINY, solve_normal
from ..problem.fixed import fixed_numbers, root_covariance
from ..problem.observation import Observation
from ..problem.problem import FitState
from ..problem.unknowns import Image, Values
from .assumptions import Assumption, ModelCheck
from .candidate_causes import (
    CandidateCause,
    Rows,
    film_candidates,
    find_causes,
    fitted,
    largest_shift,
    orthogonal_to,
    scene_candidates,
)
from .changes import extent_of, parameter_changes, pixels_to_check
from .structure import block_scatter, pair_scores


def expected_error(
    state: FitState,
    uncertain: Mapping[str, float],
    correlations: Mapping[tuple[str, str], float],
    check_clock: Callable[[], None] = lambda: None,
) -> Values:
    """About the standard errors of the unknowns, before the last steps: those of white noise, and of what is stated.

    It is a bound from below. The noise is that of the typical pixel, for those at edges are still off by how they are
    sampled. A few pixels tell what the scene's stated numbers do; the film's are left out. What is stated counts up to
    thirty errors of the noise: a tenth of that is left in no pixel of a picture of ten thousand.
    """
    problem, linearization = state.problem, state.linearization
    triangle = np.asarray(linearization.jacobian, np.float64)
    sigma = MAD_TO_SIGMA * float(linearization.typical)
    variance = sigma**2 * np.diagonal(solve_normal(triangle.T @ triangle, np.eye(triangle.shape[1])))
    names = fixed_numbers(problem, uncertain).keys() & uncertain
    if not names:
        return np.sqrt(variance)
    pixels = pixels_to_check(problem, state.y, state.stage, linearization, most=4000)
    pixels = dataclasses.replace(pixels, check_clock=check_clock)
    weight = (pixels.sampled.of(state.under_loss("weight")) / pixels.sampled.probability).reshape(-1)
    numbers = list(scene_candidates(pixels, uncertain, only_stated=True))
    free = parameter_changes(pixels)
    free, by_number = (np.reshape(each, (len(each), -1)) for each in (free, [one.change for one in numbers]))
    among = {pair: value for pair, value in correlations.items() if names.issuperset(pair)}
    moved = stated_moves(-fitted(free, by_number, weight), numbers, among)
    stated = np.sum(moved**2, axis=1) / np.maximum(problem.slopes(state.y) ** 2, TINY)
    return np.sqrt(np.minimum(variance + stated, 30**2 * variance))


def stated_moves(
    sensitivity, numbers: Sequence[CandidateCause], correlations: Mapping[tuple[str, str], float]
) -> Float[np.ndarray, "parameters parts"]:
    """How far each independent part of what is stated of some numbers moves the values, by their sensitivity."""
    stated = [k for k, one in enumerate(numbers) if one.uncertainty]
    spread = np.array([numbers[k].uncertainty for k in stated])
    return sensitivity[:, stated] @ root_covariance([numbers[k].name for k in stated], spread, correlations).T


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
    it is a nuisance and no cause.

    Args:
        uncertain: standard deviation by canonical name of a fixed number.
        check_clock: called before each few scenes are rendered; what it raises ends the check.
    """
    problem, linearization, observation = state.problem, state.linearization, state.problem.observation
    # How the picture changes with the free parameters, the scene's fixed numbers, and the film's.
    pixels = dataclasses.replace(pixels_to_check(problem, state.y, state.stage, linearization), check_clock=check_clock)
    sampled = pixels.sampled
    light = np.asarray(linearization.image if pixels.radiance is None else pixels.radiance, np.float64)
    changes = parameter_changes(pixels)
    free = changes.reshape(len(changes), -1)
    of_scene = list(scene_candidates(pixels, uncertain))
    of_film = list(film_candidates(pixels, light + np.asarray(observation.bias, np.float64), uncertain))

    # Evidence is the residual beyond quantisation, and beyond what other stages of the observation make by themselves.
    residual, weight = np.asarray(state.residual, np.float64), state.under_loss("weight")
    bound = functools.reduce(np.maximum, (one.bound(observation) for one in problem.stages), np.zeros(()))
    evidence = beyond(observation, residual, weight, bound)
    rows = Rows(
        residual=sampled.of(residual).reshape(-1),
        evidence=sampled.of(evidence).reshape(-1),
        weight=(sampled.of(weight) / sampled.probability).reshape(-1),
        square=np.tile(sampled.square, 3),
        bound=sampled.of(np.broadcast_to(weighted(observation, bound), residual.shape)).reshape(-1),
    )

    # How far the estimate moves with each fixed number, and with those that are stated to be uncertain.
    numbers = [*of_scene, *(one for one in of_film if one.uncertainty)]
    by_number = np.reshape([one.change for one in numbers], (len(numbers), free.shape[1]))
    sensitivity = -fitted(free, by_number, rows.weight)
    spread = np.array([one.uncertainty for one in numbers])
    named = [one.name for one in numbers if one.uncertainty]
    moved = stated_moves(sensitivity, numbers, correlations or {})
    assumptions = ranked(numbers, sensitivity, standard_error)

    # What the residual looks like beside what is free or stated to be uncertain.
    nuisance = np.concatenate([free, by_number[spread > 0]])
    pulls = weight * evidence
    if named:  # How hard the residual pulls once the nuisance has been fitted to it; 0 at other pixels.
        rest = orthogonal_to(nuisance, rows.evidence[None], rows.weight)[0] * rows.weight
        pulls = np.zeros(weight.shape)
        pulls[:, sampled.row, sampled.column] = rest.reshape(3, -1) * sampled.probability
    pairs = pair_scores(pulls, extent_of(problem))
    candidates = [one for one in (*of_scene, *of_film) if not one.uncertainty]
    causes, structure = find_causes(rows, free, nuisance, candidates, standard_error)

    # Errors that go together over many pixels count in the error, also without a cause.
    far_matters = False
    if pairs.is_far:
        slope = problem.slopes(state.y)
        jacobian = np.asarray(linearization.pixel_jacobian, np.float64)
        scatter = block_scatter(jacobian / np.where(slope, slope, 1.0)[:, None, None, None], weight, residual)
        structure = structure + scatter
        moves = largest_shift(np.sqrt(np.diagonal(scatter))[:, None], standard_error)[0] > 1
        jump = np.array(max((one.jump(observation) for one in problem.stages), default=0.0))
        far_matters = bool(moves or beyond(observation, evidence, weight, jump).any())
    return ModelCheck(assumptions, causes, pairs, moved @ moved.T, structure, far_matters)


def beyond(observation: Observation, residual: Image, weight: Image, bound: np.ndarray) -> Image:
    """The residuals, but 0 where a bound of them, or the roundings of the fit's precision, may have made them.

    Storing rounds equal colours equally, over whole areas, and that is not noise. Where nearly all residuals of flat
    areas are within the bound there is no noise beside it, and only what is beyond is evidence. Elsewhere all are. At
    edges random samples make noise of their own, which tells nothing of the flat areas.

    Args:
        bound: of each of the target's numbers, in its own unit.
    """
    target, counts = np.asarray(observation.target), observation.seen
    within = np.abs(residual) <= weighted(observation, bound)
    values, neighbours = np.asarray(target, np.float64), (1, 3, 3)
    span = ndimage.maximum_filter(values, neighbours) - ndimage.minimum_filter(values, neighbours)
    is_flat = counts & (span <= 4.0 * bound)
    looked_at = is_flat if np.mean(is_flat) > 0.05 else counts
    # Of noise as large as the bound three quarters are within it, of half of that all.
    outside = np.where(within, 0.0, residual) if np.mean(within[looked_at]) > 0.9 else residual
    # A thousand roundings: the digits of sums over a hundred thousand pixels.
    rounding = 1e3 * float(np.finfo(target.dtype).eps) * float(np.max(weighted(observation, np.abs(target))))
    return outside if np.sqrt(np.mean((weight * outside) ** 2)) >= rounding else np.zeros_like(outside)


def weighted(observation: Observation, size: np.ndarray) -> np.ndarray:
    """Sizes in the target's unit in that of its weighted residual; 0 where the weight is 0."""
    # A clamped number's step has no end: it must not meet a weight of 0.
    root = np.asarray(observation.root_weight, np.float64)
    return np.where(root > 0, size, 0.0) * root


def ranked(numbers: Sequence[CandidateCause], sensitivity, standard_error) -> tuple[Assumption, ...]:
    """The fixed numbers as assumptions, ranked by how far the same share of each moves an estimate, the most first."""
    consequence = largest_shift(sensitivity, standard_error) * np.array([one.size for one in numbers])
    found = [
        Assumption(one.name, one.value, one.size, one.uncertainty, shifts, one.attribute.unit)
        for one, shifts in zip(numbers, sensitivity.T, strict=True)
    ]
    return tuple(found[k] for k in np.argsort(-consequence, kind="stable"))
