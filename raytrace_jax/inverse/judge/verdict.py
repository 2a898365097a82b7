"""Whether a picture explains the target, whether another one does so as well, and the word for it."""

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.inverse.judge.uncertainty import Certainty
from raytrace_jax.inverse.problem.problem import Problem, weighted_residual
from raytrace_jax.inverse.problem.residual import BLOCK, Linearization
from raytrace_jax.inverse.result import Minimum, Status

SQUARE = 4
"""Side in pixels of the squares over which noise averages out and structure stays."""

STRUCTURE_SHARE = 0.5
"""Square means above this share of the residual's root mean square are structure; of white noise they are a fourth."""

NEGLIGIBLE = 0.02
"""Structure below this share of the target's contrast is that of a good model: two programs, two ways to sample."""

NEGLIGIBLE_ELSEWHERE = 0.2
"""The same for the pixels that no free parameter moves: they do not bias the estimate, but belong to the picture."""

EVIDENCE = 3.0
"""Standard errors by which the winner must be better than another minimum."""


def is_explained(
    residual: Float[np.ndarray, "3 height width"],
    target: Float[np.ndarray, "3 height width"],
    counts: Bool[np.ndarray, "height width"],
    matters: Bool[np.ndarray, "height width"],
) -> bool:
    """Whether a residual looks like noise, or is too small to matter, rather than like a picture of something.

    Args:
        residual: picture minus target.
        target: the target.
        counts: the pixels that count.
        matters: those of them that depend on a free parameter.
    """
    return all(
        not has_structure(residual, target, where, share)
        for where, share in ((matters & counts, NEGLIGIBLE), (counts, NEGLIGIBLE_ELSEWHERE))
    )


def explains(problem: Problem, found: Linearization, binning: int = 1) -> bool:
    """Whether the picture of a linearisation explains the target."""
    observation = problem.binned(binning)
    return is_explained(
        np.asarray(weighted_residual(problem, found, binning)),
        np.asarray(observation.target),
        np.asarray(observation.root_weight) > 0,
        np.asarray(found.matters),
    )


def has_structure(residual, target, where: Bool[np.ndarray, "height width"], negligible: float) -> bool:
    """Whether the means of small squares within a region are neither those of noise nor negligible."""
    means, contrast = square_means(residual, where), square_means(target, where)
    if means.shape[1] < 2:
        return False
    structure = float(np.sqrt(np.mean(means**2)))
    scatter = float(np.sqrt(np.mean(residual[:, where] ** 2)))
    return structure > max(STRUCTURE_SHARE * scatter, negligible * float(np.mean(contrast.std(axis=1))))


def square_means(image, where: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "3 squares"]:
    """Means over those squares of pixels that lie at least half within a region, of the pixels within."""
    counts = _square_sums(where.astype(float)[None], SQUARE)[0]
    full = counts >= SQUARE * SQUARE / 2
    return _square_sums(np.where(where, image, 0), SQUARE)[:, full] / counts[full]


def _square_sums(image: np.ndarray, side: int) -> np.ndarray:
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side).sum((2, 4))


def evidence(better: Float[np.ndarray, "3 height width"], other: Float[np.ndarray, "3 height width"]) -> float:
    """By how many standard errors one picture explains a target better than another (after Vuong 1989).

    The sums of squares differ by `2 better (other - better)`, which is as likely to help as to harm if both are equally
    good, and `(other - better)^2`. The scatter of the first, over squares of pixels since neighbours err together, is
    the measure; that of the second, which grows with the pictures' difference, would hide a clear one.

    Args:
        better, other: residuals of both, weighted and under the loss.
    """
    gain = float(np.sum(other**2 - better**2))
    chance = float(np.linalg.norm(_square_sums(2 * better * (other - better), BLOCK).sum(0)))
    return gain / chance if chance > 0 else float(np.inf if gain > 0 else 0)


def verdict(
    *,
    stopped: str | None,
    settled: bool,
    explained: bool,
    certainty: Certainty,
    runner_ups: tuple[Minimum, ...],
    max_steps: int,
) -> tuple[Status, str, str]:
    """The status of a fit, why, and what to do.

    Args:
        stopped: why the fit was stopped before its end, if it was.
        settled: whether the solver came to rest on the last level.
        explained: whether the residual is free of structure.
        certainty: how sure the estimate is.
        runner_ups: the other minima.
        max_steps: the steps that the solver had on each level.
    """
    open_ = ", ".join(certainty.undetermined)
    rivals = [minimum for minimum in runner_ups if minimum.explained and minimum.evidence < EVIDENCE]
    if stopped is not None:
        return (
            "interrupted",
            f"{stopped}; the values are those of the last accepted step",
            "go on with --resume (journal= in Python), or take the values as a rough estimate",
        )
    singular = not np.all(np.isfinite(certainty.standard_error))
    if certainty.undetermined and (explained or singular):
        return (
            "degenerate",
            f"the picture does not determine {open_}: it hardly changes along {certainty.weakest}",
            "fix one of these, free fewer, or add what is known with --prior",
        )
    if not settled:
        return (
            "not_converged",
            f"the solver was still moving after {max_steps} steps on a level",
            "allow more with --max-steps, or start nearer",
        )
    if not explained:
        return (
            "not_converged",
            "the solver came to rest, but the residual shows structure: the picture is not explained",
            "look at the residual: start nearer, free what differs, mask what the scene lacks, or check the settings",
        )
    if rivals:
        return (
            "ambiguous",
            f"{len(rivals)} other minim{'um explains' if len(rivals) == 1 else 'a explain'} the picture as well "
            f"(evidence {min(minimum.evidence for minimum in rivals):.1f} standard errors, wanted {EVIDENCE:g})",
            "compare the runner-ups in the report; a prior, a larger picture or less noise can decide",
        )
    return (
        "converged",
        "the solver came to rest, the picture is explained, and it determines every parameter",
        "the error bars hold for this model and noise; look at the residual once",
    )
