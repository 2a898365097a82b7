"""The word for how a fit ended, why, and what to do."""

import numpy as np

from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.judge.vuong import EVIDENCE
from raytrace_jax.inverse.result import Minimum, Status


def verdict(
    *,
    stopped: str | None,
    settled: bool,
    explained: bool,
    uncertainty: Uncertainty,
    runner_ups: tuple[Minimum, ...],
    max_steps: int,
) -> tuple[Status, str, str]:
    """The status of a fit, why, and what to do.

    Args:
        stopped: why the fit was stopped before its end, if it was.
        settled: whether the solver came to rest on the last level.
        explained: whether the residual is free of structure.
        uncertainty: how sure the estimate is.
        runner_ups: the other minima.
        max_steps: the steps that the solver had on each level.
    """
    open_ = ", ".join(uncertainty.undetermined)
    rivals = [minimum for minimum in runner_ups if minimum.explained and minimum.evidence < EVIDENCE]
    if stopped is not None:
        is_known = not np.all(np.isnan(uncertainty.standard_error))
        return (
            "interrupted",
            f"{stopped}; the values are those of the last accepted step" + ("" if is_known else ", without error bars"),
            "go on with --resume (journal= in Python), or take the values as a rough estimate",
        )
    singular = not np.all(np.isfinite(uncertainty.standard_error))
    if uncertainty.undetermined and (explained or singular):
        return (
            "degenerate",
            f"the picture does not determine {open_}: it hardly changes along {uncertainty.weakest}",
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
