"""The word for how a fit ended, why, and what to do."""

from collections.abc import Sequence

import numpy as np

from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.judge.vuong import EVIDENCE
from raytrace_jax.inverse.result import PROFILE_95, Assumption, Cause, Minimum, Profile, Status
from raytrace_jax.util.words import listed

WHAT_IF = 1e-3
"""The share by which a number might be off, in the sentence on what the answer rests on: a tenth of a percent."""

DISAGREEING = 1.3
"""A profile whose 95 % interval is so many times as wide as that of the error bar, or as narrow, contradicts it."""

MOST_WORTH_COUNTING = 100_000
"""Standard errors; of a picture without noise they are nearly nothing, and anything is that many of them."""


def verdict(
    *,
    stopped: str | None,
    settled: bool,
    explained: bool,
    finite: bool = True,
    structured: bool,
    causes: tuple[Cause, ...],
    excess: float,
    uncertainty: Uncertainty,
    runner_ups: tuple[Minimum, ...],
    max_steps: int,
    has_moved: bool = True,
    can_go_on: bool = True,
    next_move: float = 0.0,
) -> tuple[Status, str, str]:
    """The status of a fit, why, and what to do.

    Args:
        stopped: why the fit was stopped before its end, if it was.
        settled: whether the solver came to rest on the last level.
        explained: whether the picture is near the target, so that what is left can be told from what noise leaves.
        finite: whether the picture and its derivatives are.
        structured: whether what is left is more than noise.
        causes: what it looks like.
        excess: by how many standard errors chi-square is too large for the noise that was given; 0 if none was.
        uncertainty: how sure the estimate is.
        runner_ups: the other minima.
        max_steps: the steps that the solver had on each level.
        has_moved: whether it has taken any, before it was stopped.
        can_go_on: whether a stage is done and kept, so that the same fit need not begin anew.
        next_move: of the last steps that ended on their own, how long the next one would be in standard errors; 0 where
            the solver had no more steps.
    """
    open_ = ", ".join(uncertainty.undetermined)
    rivals = [minimum for minimum in runner_ups if minimum.explained and minimum.evidence < EVIDENCE]
    if stopped is not None:
        is_known = not np.all(np.isnan(uncertainty.standard_error))
        return interrupted(stopped, is_known, has_moved, can_go_on)
    if not finite:
        return (
            "not_converged",
            "the picture where the solver ended, or a derivative of it, has values that are not finite",
            "start nearer, or free fewer numbers",
        )
    if not explained:
        return (
            "not_converged",
            f"{'the solver came to rest' if settled else 'the solver was still moving'}, but the residual shows "
            f"structure: the picture is far from explained{looks_like(causes)}",
            "look at the residual: start nearer, free what differs, mask what the scene lacks, or check the settings",
        )
    if np.all(np.isnan(uncertainty.standard_error)):
        return (
            "not_converged",
            "the errors of the estimate are unknown: sums of squares of the residual, or of the derivatives, are "
            "beyond the precision's largest number",
            "give the target colours of about 1 (its values may be 0 to 255), or use --precision 64",
        )
    if uncertainty.undetermined:
        return (
            "degenerate",
            f"the picture does not determine {open_}: it hardly changes along {uncertainty.weakest}",
            "fix one of these, free fewer, or add what is known with --prior",
        )
    if not settled and next_move > 0:
        return (
            "not_converged",
            "the last steps, on the picture sampled as the target is, did not come to rest: the next one would be "
            f"{short_count(next_move)} standard errors long",
            "say how the target was sampled with --target-samples, fit a larger picture, or start nearer",
        )
    if not settled:
        return (
            "not_converged",
            f"the solver was still moving after {max_steps} steps on a level",
            "allow more with --max-steps, or start nearer",
        )
    if structured:
        return (
            "model_incomplete",
            f"the residual is more than noise, something in the target is not as the scene says{looks_like(causes)}",
            f"{causes[0].advice}; or state how well it is known with --uncertain"
            if causes
            else "look at the residual: free what differs, or mask what the scene lacks",
        )
    if excess > 0:
        return (
            "model_incomplete",
            "the residual is larger than the noise that was stated: chi-square "
            f"{uncertainty.reduced_chi_square:.3g} is {excess:.0f} standard errors above 1",
            "state the noise with --sigma as it is, or leave it out, and look at the residual",
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
        "the errors hold for noise and for what was stated to be uncertain, if all else is as the scene says",
    )


def interrupted(stopped: str, is_known: bool, has_moved: bool, can_go_on: bool) -> tuple[Status, str, str]:
    """The verdict on a fit that was stopped; `is_known` says that there are error bars, the others as in `verdict`."""
    way = (
        "the same command goes on (in Python the same journal)"
        if can_go_on
        else "start it again with more time: no stage is done that it could go on from"
    )
    if not has_moved:
        return "interrupted", f"{stopped}, before the first step: nothing was fitted", way
    values = "the values are those of the last accepted step" + ("" if is_known else ", without error bars")
    return "interrupted", f"{stopped}; {values}", f"{way}, or take the values as a rough estimate"


def bounds_in_words(at_bound: Sequence[tuple[str, float]]) -> str:
    """What ran to a bound, as the end of a sentence."""
    return "".join(f"; {name} is at its bound, {bound:g}" for name, bound in at_bound)


def profiles_in_words(profiles: Sequence[Profile], names: Sequence[str], standard_error: np.ndarray) -> str:
    """Which profiles contradict the error bar of their parameter, as the end of a sentence."""
    found = ""
    for profile in profiles:
        error = standard_error[list(names).index(profile.name)]
        half = (profile.interval[1] - profile.interval[0]) / 2
        if not (np.isfinite(half) and np.isfinite(error) and error > 0):
            continue
        ratio = half / (np.sqrt(PROFILE_95) * error)
        if not 1 / DISAGREEING < ratio < DISAGREEING:
            found += (
                f"; the 95 % interval of the profile of {profile.name} is {short_count(ratio)} times as wide as its "
                "error bar says"
            )
    return found


def looks_like(causes: tuple[Cause, ...]) -> str:
    """What a residual looks like, as the end of a sentence."""
    return f"; it looks like {listed(cause.words for cause in causes)}" if causes else ""


def rests_on(assumptions: Sequence[Assumption], names: Sequence[str], standard_error: np.ndarray) -> str:
    """The assumption on which an answer rests most, as a sentence: `if ball.radius were 0.1 % off, ...`.

    Args:
        assumptions: the most consequential first.
        names: of the estimates.
        standard_error: of the estimates.
    """
    if not assumptions or not assumptions[0].size:
        return ""
    most = assumptions[0]
    shift = np.abs(most.sensitivity) * most.size * WHAT_IF
    is_known = np.isfinite(standard_error) & (standard_error > 0)
    errors = np.divide(shift, standard_error, out=np.zeros_like(shift), where=is_known)
    worst = int(np.argmax(errors))
    if not errors[worst] > 0:
        return ""
    return (
        f"if {most.name} were {100 * WHAT_IF:g} % off, {names[worst]} would move by {shift[worst]:.2g} "
        f"({short_count(errors[worst])} standard errors)"
    )


def short_count(number: float) -> str:
    """Two digits of a number, as people write it."""
    rounded = float(f"{number:.1e}")
    if rounded >= MOST_WORTH_COUNTING:
        return f"more than {MOST_WORTH_COUNTING:,}"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"


def chi_square_excess(
    residual: np.ndarray, counts: np.ndarray, sigma: float | None, tolerance: float = 0.02, significant: float = 5.0
) -> float:
    """By how many standard errors the squares of a residual exceed those of noise of a standard deviation.

    0 where they do not, or by no more than `tolerance` of the standard deviation would make: nobody knows it better.
    """
    if sigma is None:
        return 0.0
    squares = (residual[:, counts] / sigma) ** 2
    mean, error = float(squares.mean()), float(squares.std() / np.sqrt(max(squares.size, 1)))
    excess = (mean - 1) / error if error > 0 else 0.0
    return excess if excess > significant and mean > (1 + tolerance) ** 2 else 0.0
