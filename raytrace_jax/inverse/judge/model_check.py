"""Whether the model is right: what the answer rests on, and what the residual looks like if it is not."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.images.quantization import rounding_of
from raytrace_jax.inverse.judge.assumptions import FAR_SIGNIFICANT, Assumption, Cause, ModelCheck
from raytrace_jax.inverse.judge.change_scores import Rows, fitted, orthogonal_to, score_changes
from raytrace_jax.inverse.judge.film_changes import stated_changes, suspected_changes
from raytrace_jax.inverse.judge.finite_shifts import finite_shifts
from raytrace_jax.inverse.judge.looked_at import SIDE, LookedAt, look_at
from raytrace_jax.inverse.judge.noise_correlation import PairScores, pair_scores
from raytrace_jax.inverse.judge.picture_changes import Pixels, flat, margin_at, number_changes, parameter_changes
from raytrace_jax.inverse.judge.scatter import block_scatter
from raytrace_jax.inverse.judge.suspects import Suspects, seen
from raytrace_jax.inverse.judge.uncertainty import RANK_ROUNDINGS
from raytrace_jax.inverse.problem.comparison import Comparison, evaluate
from raytrace_jax.inverse.problem.fixed_numbers import FixedNumbers, fixed_numbers
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.problem.stated import root_covariance
from raytrace_jax.util.numerics import TINY

MOST_PIXELS = 20_000
"""Of a picture, that are looked at: all of 160 x 120, some seconds of points and about ten of edge-aware pixels."""

SIGNIFICANT = 4.5
"""Standard scores from which on a change explains a residual. Of 114 changes the largest score of noise alone, white,
unequal, heavy-tailed or of all channels together, was 4.0 in 840 draws, on pictures of 160 x 120 and of 40 x 30; of
noise correlated over a pixel 4.8 in 200, more than 4.5 in one of them."""

LIKELY = 3.5
"""The same of further causes, where one was found: then something is wrong, and chance is no rival."""

STEP_OF_SAMPLES = 1 / 65535
"""Of white, in which a renderer is taken to have stored the samples whose means a target's pixels are: 16 bits."""

STORAGE_SLACK = 1.5
"""Steps of storing within which a residual is put down to it: the picture has roundings of its own."""

MOSTLY = 0.9
"""This share of the residuals has to be. Of noise as large as the step three quarters are, of half of that all."""

FLIPPED = 2
"""Samples a pixel of a grid that was told may lie on the other side of an edge than the same of the fit's picture: of a
painted board by POV-Ray, 320 x 240 with 8 x 8 samples, at a place right to 1.5e-8, less than one does."""

MOST_CAUSES = 8
"""That are named and counted, one after the other, each beside those before: a camera that nobody stated is five."""

SAME = 1 - 1e-6
"""Changes that take away the same but for rounding are the same."""

AS_GOOD = 0.5
"""A change that takes away this share of what the best one does may be the cause as well."""


def pixels_to_check(
    problem: Problem, y: Float[Array, " parameters"], comparison: Comparison, linearization: Linearization | None = None
) -> Pixels:
    """Those that stand for a picture.

    Of a point-sampled picture some at the rim of glass decide as much as all others: they are chosen in proportion to
    their derivatives. Edge-aware ones are alike, and of many at edges each takes longer than one of a whole picture;
    so their linearization is not asked for.
    """
    counts = np.asarray(problem.observation.root_weight) > 0
    decides = np.ones(counts.shape)
    if comparison.edges == "point" and linearization is not None:
        length = np.linalg.norm(np.asarray(linearization.jacobian, np.float64), axis=0)
        columns = np.asarray(linearization.columns, np.float64) / np.maximum(length, TINY)[:, None, None, None]
        decides = np.sqrt(np.sum(columns**2, axis=(0, 1)))
    margin = margin_at(problem, y)
    if not margin:
        return Pixels(problem, y, look_at(counts, decides, MOST_PIXELS), comparison.edges)
    # The film mixes pixels: those in the midst of larger squares are judged, and all around them are looked at.
    looked = look_at(np.ones_like(counts), np.where(counts, decides, 0.0), MOST_PIXELS, SIDE * 2 * margin)
    return Pixels(problem, y, looked, comparison.edges)


def check_model(
    problem: Problem,
    y: Float[Array, " parameters"],
    linearization: Linearization,
    comparison: Comparison,
    standard_error: Float[np.ndarray, " parameters"],
    uncertain: Mapping[str, float],
    target_samples: int | None = None,
    correlations: Mapping[tuple[str, str], float] | None = None,
) -> ModelCheck:
    """Check the model at an unblurred optimum.

    The estimate moves with a fixed number p as `d theta / dp = -(J^T W J)^-1 J^T W j`, j the picture's derivative by p
    and W the loss's weights. What is left of j beside J is what a residual can show of p: it is tested for being in
    there, and so are the changes that a camera makes. Numbers stated to be uncertain may be anything within what was
    stated: they are no causes.

    Args:
        problem: what was fitted.
        y: the unknowns.
        linearization, comparison: the problem there.
        standard_error: of the estimate.
        uncertain: standard deviation by canonical name of a fixed number.
        target_samples: of the target's pixels, a side, where they are known to be means of a regular grid.
        correlations: of what is uncertain, by pairs of names.
    """
    pixels = pixels_to_check(problem, y, comparison, linearization)
    light = np.asarray(linearization.image if pixels.light is None else pixels.light, np.float64)
    light = light + np.asarray(problem.observation.bias, np.float64)
    numbers = fixed_numbers(problem, uncertain)
    free = flat(parameter_changes(pixels))
    by_number = flat(number_changes(pixels, numbers)) if numbers.names else np.zeros((0, free.shape[1]))
    of_film = stated_changes(problem, y, light, uncertain)
    by_number = np.concatenate([by_number, seen(of_film, pixels)])
    numbers = numbers.followed_by([c.name for c in of_film], [c.value for c in of_film])
    residual = np.asarray(problem.residual_of(linearization), np.float64)
    weight = evaluate(comparison.loss, "weight", residual, comparison.loss_scale)
    # Without a grid that was told an edge-aware comparison takes the pixels for means of whatever samples.
    is_mean = (target_samples or 1) > 1 or (comparison.edges == "aware" and target_samples is None)
    rounding = rounding_of(np.asarray(problem.observation.target, np.float64))
    of_samples = STEP_OF_SAMPLES if is_mean else 0.0
    evidence = beyond_storage(problem, residual, np.maximum(rounding, of_samples))
    rows = rows_of(pixels.judged, residual, evidence, weight)
    step = pixels.judged.of(weighted(problem, np.maximum(2 * rounding, of_samples))).reshape(-1)

    sensitivity = -fitted(free, by_number, rows.weight)
    spread = np.array([uncertain.get(name, 0.0) for name in numbers.names])
    is_stated = spread > 0
    named = [name for name, one in zip(numbers.names, is_stated, strict=True) if one]
    stated = root_covariance(named, spread[is_stated], correlations or {}) @ by_number[is_stated]
    moved = finite_shifts(comparison, rows.residual, 1 / np.tile(pixels.judged.share, 3), free, stated)
    assumptions = ranked(numbers, sensitivity, spread, standard_error)

    if is_rounding(problem, weight * evidence):
        return ModelCheck(assumptions, (), PairScores(0.0, 0.0), moved @ moved.T, np.zeros((len(free), len(free))))
    suspects = Suspects.of(suspected_changes(problem, y, light, uncertain), pixels, numbers, by_number)
    granted = np.concatenate([free, by_number[is_stated]])
    pairs = pair_scores(rest_of(granted, rows, pixels.judged, weight.shape) if is_stated.any() else weight * evidence)
    causes, structure = find_causes(rows, free, granted, suspects.without(is_stated), standard_error, step)
    far_matters = False
    if pairs.far > FAR_SIGNIFICANT:
        slope = problem.slopes(y)
        by_value = np.asarray(linearization.columns, np.float64) / np.where(slope, slope, 1.0)[:, None, None, None]
        scatter = block_scatter(by_value, weight, residual)
        structure = structure + scatter
        moves = largest_shift(np.sqrt(np.diagonal(scatter))[:, None], standard_error)[0] > 1
        far_matters = bool(moves or not may_be_flips(problem, evidence, target_samples))
    return ModelCheck(assumptions, causes, pairs, moved @ moved.T, structure, far_matters)


def rows_of(looked: LookedAt, residual, evidence, weight: Float[np.ndarray, "3 height width"]) -> Rows:
    """What is looked at of residuals, of what they are evidence for, and of the weight that the loss gives them."""
    counted = looked.of(weight) / looked.share
    flat_residual, flat_evidence = looked.of(residual).reshape(-1), looked.of(evidence).reshape(-1)
    return Rows(flat_residual, flat_evidence, counted.reshape(-1), np.tile(looked.square, 3))


def beyond_storage(
    problem: Problem, residual: Float[np.ndarray, "3 height width"], moved: Float[np.ndarray, "3 height width"]
) -> Float[np.ndarray, "3 height width"]:
    """The residuals that are evidence: not those that storing the target may have made.

    Storing rounds equal colours equally, over whole areas, which is not noise. Where nearly all residuals are within
    its step, there is no noise beside it, and only what is beyond the step is evidence.

    Args:
        problem: what was fitted.
        residual: the weighted residual.
        moved: how far storing may have moved each of the target's numbers. Of means of samples that were stored
            themselves the target's own numbers do not show it.
    """
    within = np.abs(residual) <= weighted(problem, STORAGE_SLACK * moved)
    counts = np.asarray(problem.observation.root_weight) > 0
    return np.where(within, 0.0, residual) if np.mean(within[:, counts]) > MOSTLY else residual


def weighted(problem: Problem, step: Float[np.ndarray, "3 height width"]) -> Float[np.ndarray, "3 height width"]:
    """Steps of the target's numbers as those of its weighted residual; a clamped number's has no end."""
    root = np.asarray(problem.observation.root_weight, np.float64)
    return np.where(root > 0, step, 0.0) * root


def rest_of(granted, rows: Rows, looked: LookedAt, shape: tuple[int, ...]) -> Float[np.ndarray, "3 height width"]:
    """The scores of the residual without what is granted, 0 where nothing was looked up."""
    rest = orthogonal_to(granted, rows.evidence[None], rows.weight)[0] * rows.weight * np.tile(looked.share, 3)
    image = np.zeros(shape)
    image[:, looked.row, looked.column] = rest.reshape(3, -1)
    return image


def may_be_flips(problem: Problem, evidence: Float[np.ndarray, "3 height width"], target_samples: int | None) -> bool:
    """Whether all that a residual shows may be samples of a known grid on the other side of an edge, a few a pixel."""
    if target_samples is None:
        return False
    target, root = (np.asarray(x, np.float64) for x in (problem.observation.target, problem.observation.root_weight))
    return bool(np.all(np.abs(evidence) <= FLIPPED * np.ptp(target) / target_samples**2 * root))


def is_rounding(problem: Problem, residual: Float[np.ndarray, "3 height width"]) -> bool:
    """Whether a residual is no more than what the roundings of the fit's precision leave."""
    target = np.asarray(problem.observation.target)
    rounding = RANK_ROUNDINGS * float(np.finfo(target.dtype).eps) * float(np.max(np.abs(target)))
    return float(np.sqrt(np.mean(residual**2))) < rounding


def largest_shift(shifts: Float[np.ndarray, "parameters changes"], standard_error) -> Float[np.ndarray, " changes"]:
    """How far any estimate is moved, in its standard errors; one that has none does not count."""
    error = np.where(np.isfinite(standard_error) & (standard_error > 0), standard_error, np.inf)
    return np.max(np.abs(shifts) / error[:, None], axis=0, initial=0)


def ranked(numbers: FixedNumbers, sensitivity, spread, standard_error) -> tuple[Assumption, ...]:
    """The fixed numbers; those that move the estimate most, in standard errors for the same share of each, first."""
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
) -> tuple[tuple[Cause, ...], Float[np.ndarray, "parameters parameters"]]:
    """What the residual looks like, one cause after the other, each beside those before.

    Of changes that explain it about as well the one counts that would move the estimate furthest. A change that no
    row shows by more than the `step` with which it was stored may be storage as well: equal colours are rounded alike
    over whole areas. It counts in the error and is no cause.

    Returns:
        The causes, the best explanation first; and what they do to the estimate, as a covariance.
    """
    sensitivity = -fitted(free, suspects.changes, rows.weight)
    structure, found = np.zeros((len(free), len(free))), []
    for _ in range(MOST_CAUSES):
        tests = score_changes(rows, granted, suspects.changes, suspects.least_left)
        gain = np.where(np.abs(tests.score) > (LIKELY if found else SIGNIFICANT), tests.gain, 0.0)
        if not gain.any():
            break
        # The residual is the picture minus the target: the target has that much less of the change. What cannot be is
        # named only where nothing that can be explains about as much.
        possible = np.where(suspects.are_possible(-tests.amount), gain, 0.0)
        gain = possible if np.max(possible) > AS_GOOD * np.max(gain) else gain
        # Of those that do exactly the same the first: a number of the scene before what a camera does.
        best = int(np.flatnonzero(gain >= SAME * np.max(gain))[0])
        if np.any(np.abs(tests.amount[best] * suspects.changes[best]) > step):
            found.append(suspects.cause(best, -float(tests.amount[best]), abs(float(tests.score[best]))))
        shifts = sensitivity * tests.amount
        rival = gain > AS_GOOD * gain[best]
        furthest = int(np.argmax(np.where(rival, largest_shift(shifts, standard_error), -1.0)))
        structure += np.outer(shifts[:, furthest], shifts[:, furthest])
        granted = np.concatenate([granted, suspects.changes[best : best + 1]])
    return tuple(found), structure
