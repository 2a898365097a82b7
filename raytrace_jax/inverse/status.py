"""The status of a fit in words, and its result."""

import dataclasses
import datetime
import hashlib
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from ..scene.parameters import resolve
from ..scene.setting_words import EdgeMode
from ..util.numerics import MAD_TO_SIGMA, on_host
from ..util.text import listed
from .build_problem import FitSetup
from .judge.model_check import Contradiction, ModelCheck, contradicted, short_count
from .judge.structure import EVIDENCE, is_near
from .judge.uncertainty import Uncertainty, quantify_uncertainty
from .judge.views import contradicting_view
from .options import FitOptions
from .problem.problem import FitState, Problem
from .problem.unknowns import Image
from .progress import Findings
from .result import PROFILE_95, FitResult, Profile, Status, ViewPictures
from .solve.solvers import bounds_reached

Verdict = tuple[Status, str, str]
"""The word for how a fit ended, why, and what to do."""


def fit_status(findings: Findings, explained: bool, excess: float, max_steps: int) -> Verdict:
    """The first thing that is wrong with a fit that came to its end, most serious first; `converged` if nothing is.

    Args:
        explained: whether the picture is near the target, so that what is left can be told from what noise leaves.
        excess: by how many standard errors chi-square is too large for the noise that was given; 0 if none was.
    """
    solution, sure, check = findings.solution, findings.uncertainty, findings.check
    assert solution is not None and sure is not None and check is not None
    rivals = [rival for rival, _, _ in findings.minima[1:] if rival.explained and rival.evidence < EVIDENCE]
    rows = [
        *solve_verdicts(solution, sure, tuple(findings.unseen), explained, check.looks, max_steps),
        *model_verdicts(sure, check, excess, [rival.evidence for rival in rivals]),
    ]
    return next(row[1:] for row in rows if row[0])


def solve_verdicts(
    solution: FitState, sure: Uncertainty, unseen: Sequence[str], explained: bool, looks: str, max_steps: int
) -> list[tuple[bool, Status, str, str]]:
    """What may be wrong with a solve: whether it is, and the verdict if so."""
    is_known = all(view.problem.samples for view in solution.views)
    known = "" if is_known else "say how the target was sampled with --target-samples, "
    return [
        # No answer: the picture is broken, or far from the target.
        (
            not solution.joint.is_finite,
            "not_converged",
            "at the parameters where the solver ended, the picture or one of its derivatives is not finite",
            "start nearer, or free fewer numbers",
        ),
        (
            not explained,
            "not_converged",
            f"{rest_in_words(solution)}, but the residual shows structure: the picture is far from explained{looks}",
            "look at the residual: start nearer, free what differs, mask what the scene lacks, or check the settings",
        ),
        # An answer whose error is unknown or without end.
        (
            not sure.is_known,
            "not_converged",
            "the errors of the estimate are unknown: sums of squares of the residual, or of the derivatives, are "
            "beyond the precision's largest number",
            "scale the target to colours of about 1 (its values may now be 0 to 255), or use --precision 64",
        ),
        (
            bool(unseen),
            "degenerate",
            f"the target does not show {listed(unseen)}: without it the picture explains the target as well, "
            "and its index and position may be anything",
            "check that it is there, and start nearer, or leave it out of the scene",
        ),
        (
            bool(sure.undetermined),
            "degenerate",
            f"the picture does not determine {', '.join(sure.undetermined)}: the change {sure.weakest} leaves it "
            "almost as it is",
            "fix one of these, free fewer, or add what is known with --prior",
        ),
        # An answer that still moves.
        (
            not solution.settled and solution.next_move > 0,
            "not_converged",
            "the last steps, on the picture sampled as the target is, did not come to rest: the next one would be "
            f"{short_count(solution.next_move)} standard errors long",
            f"{known}fit a larger picture, or start nearer",
        ),
        (
            not solution.settled,
            "not_converged",
            f"the solver was still moving after {max_steps} steps on a level",
            "allow more with --max-steps, or start nearer",
        ),
    ]


def model_verdicts(
    sure: Uncertainty, check: ModelCheck, excess: float, rivals: Sequence[float]
) -> list[tuple[bool, Status, str, str]]:
    """What may be wrong with the model at the end of a solve, the last row if nothing is.

    Args:
        rivals: the evidence against each other minimum that explains the picture as well.
    """
    cause = f"{check.causes[0].advice}; or state how well it is known with --uncertain" if check.causes else ""
    return [
        # A model that leaves more than noise.
        (
            check.is_structured,
            "model_incomplete",
            f"the residual is more than noise: something in the target differs from the scene{check.looks}",
            cause or "look at the residual: free what differs, or mask what the scene lacks",
        ),
        (
            excess > 0,
            "model_incomplete",
            "the residual is larger than the noise that was stated: chi-square "
            f"{sure.reduced_chi_square:.3g} is {excess:.0f} standard errors above 1",
            "correct --sigma or leave it out, and look at the residual",
        ),
        # An answer beside others, or the only one.
        (
            bool(rivals),
            "ambiguous",
            f"{len(rivals)} other minim{'um explains' if len(rivals) == 1 else 'a explain'} the picture as well "
            f"(evidence {min(rivals, default=0.0):.1f} standard errors, wanted {EVIDENCE:g})",
            "compare the runner-ups in the report; a prior, a larger picture or less noise can decide",
        ),
        (
            True,
            "converged",
            "the solver came to rest, the picture is explained, and it determines every parameter",
            "these errors cover the picture's noise and what was stated with --uncertain; every other number of the "
            "scene counts as exact",
        ),
    ]


def rest_in_words(solution: FitState) -> str:
    """Whether the solver came to rest."""
    return "the solver came to rest" if solution.settled else "the solver was still moving"


def contradicted_status(contradictions: Sequence[Contradiction], verdict: Verdict) -> Verdict:
    """The status of a fit at rest whose picture contradicts what was stated: that comes first of all."""
    if not contradictions:
        return verdict
    status, message, advice = verdict
    words = "the picture contradicts what was stated of " + "; of ".join(each.words for each in contradictions)
    names = listed(each.name for each in contradictions)
    again = f"measure {names} again, leave the prior out, or free what else may be wrong"
    if status == "converged":
        return "model_incomplete", words, again
    return "model_incomplete" if status == "ambiguous" else status, f"{words}; {message}", f"{again}; {advice}"


def interrupted_status(stopped: str, findings: Findings, sure: Uncertainty) -> Verdict:
    """The status of a fit that was stopped."""
    way = "run it again with more time (--max-seconds)"
    if sure.is_known and findings.uncertainty is not None and findings.solution is not None:
        # Only profiles and the check of the model are missing.
        unchecked = "the model was not checked: the errors are those of the noise, as if nothing in the target differed"
        words = f"{stopped}; {rest_in_words(findings.solution)}, but {unchecked} from the scene"
        return "interrupted", words, f"{way}, or look at the residual"
    if not any(step.step > 0 and step.accepted for step in findings.steps):
        return "interrupted", f"{stopped}, before the first step: nothing was fitted", way
    values = "the values are those of the last accepted step" + ("" if sure.is_known else ", without error bars")
    return "interrupted", f"{stopped}; {values}", f"{way}, or take the values as a rough estimate"


def bounds_in_words(at_bound: Sequence[tuple[str, float]]) -> str:
    """The estimates that ran to a bound, as the end of a sentence."""
    return "".join(f"; {name} is at its bound, {bound:g}" for name, bound in at_bound)


def profiles_in_words(profiles: Sequence[Profile], names: Sequence[str], standard_error: np.ndarray) -> str:
    """The profiles that contradict the error bar of their parameter, as the end of a sentence."""
    words = ""
    for profile in profiles:
        error = standard_error[list(names).index(profile.name)]
        half = (profile.interval[1] - profile.interval[0]) / 2
        if not (np.isfinite(half) and np.isfinite(error) and error > 0):
            continue
        ratio = half / (np.sqrt(PROFILE_95) * error)
        # A profile contradicts the error bar if its 95 % interval is 1.3 times as wide, or as narrow.
        if not 1 / 1.3 < ratio < 1.3:
            words += (
                f"; the 95 % interval of the profile of {profile.name} is {short_count(ratio)} times as wide as its "
                "error bar says"
            )
    return words


def chi_square_excess(residual: np.ndarray, sigma: float | None) -> float:
    """Standard errors by which the mean square of residuals is above that of noise of standard deviation `sigma`.

    It is 0 below five, or where a standard deviation larger by 2 % would explain it: nobody knows it better.
    """
    if sigma is None or not residual.size:
        return 0.0
    squares = (residual / sigma) ** 2
    mean, error = float(squares.mean()), float(squares.std() / np.sqrt(max(squares.size, 1)))
    excess = (mean - 1) / error if error > 0 else 0.0
    return excess if excess > 5 and mean > 1.02**2 else 0.0


def shows_noise(solution: FitState, sigma: float) -> Bool[np.ndarray, "3 height width"]:
    """The numbers of the target that count, but for those in which a few samples may err by a tenth of such noise."""
    seen, within = solution.problem.observation.seen, solution.within
    # Four samples: a hundredth more of the squares, of which nobody knows the noise to 2 %.
    return seen if within is None else seen & (within <= 4 * (0.1 * sigma) ** 2)


def make_result(setup: FitSetup, options: FitOptions, findings: Findings, stopped: str | None) -> FitResult:
    """Judge what was found and gather the result.

    Nothing is traced any more: what a fit that was stopped has not computed stays unknown.

    Args:
        findings: what they are now; work that was left behind may add to its own.
    """
    problem, solution, names = setup.problem, findings.solution, setup.problem.unknowns.names
    check = findings.check or ModelCheck.nothing(len(names))
    # Where the fit ended, and how sure that is.
    if solution is None:
        y, loss = problem.start() if findings.answer is None else problem.array(findings.answer), options.loss
        uncertainty = Uncertainty.unknown(len(names), options.sigma)
        pictures = [pictures_of(view, options.edges) for view in problem.views]
    else:
        y, loss = solution.y, solution.stage.loss
        uncertainty = findings.uncertainty or quantify_uncertainty(solution, options.sigma)
        starts = findings.start_images or [None] * len(solution.views)
        pictures = [solved_pictures(view, start) for view, start in zip(solution.views, starts, strict=True)]

    # The word for it. What is far from explained has no errors.
    explained = True
    if stopped is not None or solution is None:
        status, message, advice = interrupted_status(stopped or "", findings, uncertainty)
    else:
        sigma = options.sigma if loss == "l2" else None
        shown = [view.residual[shows_noise(view, sigma or 0.0)] for view in solution.views]
        excess = chi_square_excess(np.concatenate(shown), sigma)
        judged = dataclasses.replace(findings, uncertainty=uncertainty, check=check)
        explained = all(is_near(v.residual, v.weighted_target, v.observation.counts) for v in solution.views)
        verdict = fit_status(judged, explained, excess, options.max_steps)
        otherwise = prior_contradictions(setup, solution, uncertainty, check) if solution.settled else ()
        verdict = contradicted_status(otherwise, verdict)
        covariances = uncertainty.covariance, check.covariance
        status, message, advice = opposed_status(
            contradicting_view(findings.alone, names, problem.values(y), *covariances), verdict
        )
    at_bound = bounds_reached(y, problem.unknowns)
    message += bounds_in_words(at_bound) + profiles_in_words(findings.profiles, names, uncertainty.standard_error)
    uncertainty = uncertainty if explained else uncertainty.withheld()

    return FitResult(
        status=status,
        message=message,
        advice=advice,
        at_bound=at_bound,
        names=names,
        value=problem.values(y),
        initial=problem.initial,
        units=tuple(resolve(problem.whole, name).attribute.unit for name in names),
        priors=tuple((name, *prior) for name, prior in setup.priors.items()),
        ties=problem.unknowns.ties,
        loss=loss,
        uncertainty=dataclasses.replace(uncertainty, sigma=uncertainty.sigma * problem.unit),
        check=check,
        profiles=findings.profiles,
        scene=problem.whole_at(y),
        alone=findings.alone,
        further_views=tuple(pictures[1:]),
        steps=findings.steps,
        candidate=findings.minima[0].summary.candidate if findings.minima else 0,
        runner_ups=tuple(minimum.summary for minimum in findings.minima[1:]),
        provenance={
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "target_sha256": hashlib.sha256(b"".join(each.target.tobytes() for each in pictures)).hexdigest(),
            "seconds": f"{findings.steps[-1].seconds:.3g}" if findings.steps else "0",
        },
        **vars(pictures[0]),
    )


def opposed_status(opposed: str, verdict: Verdict) -> Verdict:
    """The status of a fit of several views of which one contradicts the others."""
    if not opposed:
        return verdict
    status, message, advice = verdict
    again = "look at each view's residual; free what differs between the views, such as a camera's place"
    if status == "converged":
        return "model_incomplete", opposed, again
    return "model_incomplete" if status == "ambiguous" else status, f"{message}; {opposed}", f"{advice}; {again}"


def pictures_of(view: Problem, edges: EdgeMode) -> ViewPictures:
    """What there is of a view before it is solved."""
    weights = (on_host(view.observation.root_weight) * view.unit) ** 2
    target = np.ascontiguousarray(view.observation.target)
    return ViewPictures(dataclasses.replace(view.base, edges=edges), target, weights, view.samples)


def solved_pictures(solution: FitState, start_image: Image | None) -> ViewPictures:
    """How a view at a solution differs from its target, in the target's unit."""
    linearization, problem = solution.linearization, solution.problem
    before = pictures_of(problem, solution.stage.edges)
    # A robust loss leaves out what it counts for less than a hundredth of the others.
    left_out = solution.observation.counts & (solution.under_loss("weight").min(axis=0) < 0.01)
    return dataclasses.replace(
        before,
        weights=np.where(np.asarray(linearization.bad), 0, before.weights),
        start_image=start_image,
        image=np.asarray(linearization.image) + np.asarray(problem.observation.bias),
        rms_residual=solution.rms_residual * problem.unit,
        typical_residual=MAD_TO_SIGMA * float(linearization.typical) * problem.unit,
        left_out=int(np.sum(left_out)),
    )


def prior_contradictions(
    setup: FitSetup, solution: FitState, uncertainty: Uncertainty, check: ModelCheck
) -> tuple[Contradiction, ...]:
    """The numbers that come out otherwise than their priors say."""
    names, values = setup.problem.unknowns.names, setup.problem.values(solution.y)
    total, compared = np.diagonal(uncertainty.covariance + check.covariance), []
    for name, stated in setup.priors.items():
        place = names.index(name)
        variance, least = max(float(total[place]), 0.0), min(float(uncertainty.cramer_rao[place]), stated[1]) ** 2
        # The picture pulls by as much as the least error says; that the total error is larger adds to the difference.
        excess = 2 * (variance - least)
        estimate = float(values[place]), math.sqrt(variance)
        compared.append(Contradiction.of(name, estimate, stated, excess))
    return contradicted(compared)
