"""The word for how a fit ended, why, and what to do."""

from collections.abc import Sequence

import numpy as np

from raytrace_jax.inverse.judge.assumptions import ModelCheck, looks_like, short_count
from raytrace_jax.inverse.result import PROFILE_95, Minimum, Profile, Status
from raytrace_jax.inverse.statistics.goodness_of_fit import EVIDENCE
from raytrace_jax.inverse.statistics.uncertainty import Uncertainty
from raytrace_jax.util.text import listed


def verdict(
    *,
    settled: bool,
    explained: bool,
    finite: bool = True,
    check: ModelCheck,
    excess: float,
    uncertainty: Uncertainty,
    runner_ups: tuple[Minimum, ...],
    max_steps: int,
    next_move: float = 0.0,
    knows_samples: bool = False,
    unseen: tuple[str, ...] = (),
) -> tuple[Status, str, str]:
    """The status of a fit that came to its end, why, and what to do.

    Args:
        settled: whether the solver came to rest on the last level.
        explained: whether the picture is near the target, so that what is left can be told from what noise leaves.
        finite: whether the picture and its derivatives are finite.
        check: whether what is left is more than noise, and what it looks like.
        excess: by how many standard errors chi-square is too large for the noise that was given; 0 if none was.
        uncertainty: how sure the estimate is.
        runner_ups: the other minima.
        max_steps: the steps that the solver had on each level.
        next_move: length in standard errors of the step that would come next, if the last steps ended on their own; 0
            if the solver had used up its steps.
        knows_samples: whether it is known how the target was sampled.
        unseen: balls without which the picture explains the target as well.
    """
    # No answer: the picture is broken, or far from the target.
    open_ = ", ".join(uncertainty.undetermined)
    rivals = [minimum for minimum in runner_ups if minimum.explained and minimum.evidence < EVIDENCE]
    if not finite:
        return (
            "not_converged",
            "at the parameters where the solver ended, the picture or one of its derivatives is not finite",
            "start nearer, or free fewer numbers",
        )
    if not explained:
        return (
            "not_converged",
            f"{'the solver came to rest' if settled else 'the solver was still moving'}, but the residual shows "
            f"structure: the picture is far from explained{looks_like(check.causes)}",
            "look at the residual: start nearer, free what differs, mask what the scene lacks, or check the settings",
        )
    # An answer whose error is unknown or without end.
    if np.all(np.isnan(uncertainty.standard_error)):
        return (
            "not_converged",
            "the errors of the estimate are unknown: sums of squares of the residual, or of the derivatives, are "
            "beyond the precision's largest number",
            "scale the target to colours of about 1 (its values may now be 0 to 255), or use --precision 64",
        )
    if unseen:
        return (
            "degenerate",
            f"the target does not show {listed(unseen)}: without it the picture explains the target as well, and its "
            "index and position may be anything",
            "check that it is there, and start nearer, or leave it out of the scene",
        )
    if uncertainty.undetermined:
        return (
            "degenerate",
            f"the picture does not determine {open_}: the change {uncertainty.weakest} leaves it almost as it is",
            "fix one of these, free fewer, or add what is known with --prior",
        )
    # An answer that still moves.
    if not settled and next_move > 0:
        return (
            "not_converged",
            "the last steps, on the picture sampled as the target is, did not come to rest: the next one would be "
            f"{short_count(next_move)} standard errors long",
            ("" if knows_samples else "say how the target was sampled with --target-samples, ")
            + "fit a larger picture, or start nearer",
        )
    if not settled:
        return (
            "not_converged",
            f"the solver was still moving after {max_steps} steps on a level",
            "allow more with --max-steps, or start nearer",
        )
    # A model that leaves more than noise.
    if check.is_structured:
        return (
            "model_incomplete",
            "the residual is more than noise: something in the target differs from the scene"
            + looks_like(check.causes),
            f"{check.causes[0].advice}; or state how well it is known with --uncertain"
            if check.causes
            else "look at the residual: free what differs, or mask what the scene lacks",
        )
    if excess > 0:
        return (
            "model_incomplete",
            "the residual is larger than the noise that was stated: chi-square "
            f"{uncertainty.reduced_chi_square:.3g} is {excess:.0f} standard errors above 1",
            "correct --sigma or leave it out, and look at the residual",
        )
    # An answer beside others, or the only one.
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
        "these errors cover the picture's noise and what was stated with --uncertain; every other number of the scene "
        "counts as exact",
    )


def interrupted(stopped: str, is_known: bool, has_moved: bool) -> tuple[Status, str, str]:
    """The status of a fit that was stopped, why, and what to do.

    Args:
        stopped: what stopped it.
        is_known: whether there are error bars.
        has_moved: whether the solver has taken any step.
    """
    way = "run it again with more time (--max-seconds)"
    if not has_moved:
        return "interrupted", f"{stopped}, before the first step: nothing was fitted", way
    values = "the values are those of the last accepted step" + ("" if is_known else ", without error bars")
    return "interrupted", f"{stopped}; {values}", f"{way}, or take the values as a rough estimate"


def bounds_in_words(at_bound: Sequence[tuple[str, float]]) -> str:
    """The estimates that ran to a bound, as the end of a sentence."""
    return "".join(f"; {name} is at its bound, {bound:g}" for name, bound in at_bound)


def above_one_in_words(names: Sequence[str]) -> str:
    """A note that indices below 1 were not tried, as the end of a sentence."""
    if not names:
        return ""
    return (
        f"; {listed(names)} began above 1 and stayed there: for a ball thinner than its surroundings, -D {names[0]}=0.9"
    )


def profiles_in_words(profiles: Sequence[Profile], names: Sequence[str], standard_error: np.ndarray) -> str:
    """Which profiles contradict the error bar of their parameter, as the end of a sentence."""
    found = ""
    for profile in profiles:
        error = standard_error[list(names).index(profile.name)]
        half = (profile.interval[1] - profile.interval[0]) / 2
        if not (np.isfinite(half) and np.isfinite(error) and error > 0):
            continue
        ratio = half / (np.sqrt(PROFILE_95) * error)
        # A profile contradicts the error bar if its 95 % interval is 1.3 times as wide, or as narrow.
        if not 1 / 1.3 < ratio < 1.3:
            found += (
                f"; the 95 % interval of the profile of {profile.name} is {short_count(ratio)} times as wide as its "
                "error bar says"
            )
    return found


def chi_square_excess(
    residual: np.ndarray, counts: np.ndarray, sigma: float | None, tolerance: float = 0.02, significant: float = 5.0
) -> float:
    """How many standard errors the mean square of a residual is above that of noise of standard deviation `sigma`.

    It is 0 where they do not, or where a standard deviation larger by the share `tolerance` would explain it: nobody
    knows it better.
    """
    if sigma is None:
        return 0.0
    squares = (residual[:, counts] / sigma) ** 2
    mean, error = float(squares.mean()), float(squares.std() / np.sqrt(max(squares.size, 1)))
    excess = (mean - 1) / error if error > 0 else 0.0
    return excess if excess > significant and mean > (1 + tolerance) ** 2 else 0.0
