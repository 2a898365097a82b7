"""The status of a fit in words, and its result."""

import dataclasses
import datetime
import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from raytrace_jax.inverse.build_problem import FitSetup
from raytrace_jax.inverse.judge.assumptions import Contradiction, ModelCheck, contradicted, looks_like, short_count
from raytrace_jax.inverse.judge.structure import EVIDENCE, is_near
from raytrace_jax.inverse.judge.uncertainty import Uncertainty, quantify_uncertainty
from raytrace_jax.inverse.observe.sampling import samples_of
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.result import (
    PROFILE_95,
    Ending,
    FitHistory,
    FitPictures,
    FitResult,
    Given,
    Minimum,
    Profile,
    Status,
)
from raytrace_jax.inverse.solve.steps import Recorder, bounds_reached
from raytrace_jax.scene.parameters import resolve
from raytrace_jax.util.numerics import MAD_TO_SIGMA
from raytrace_jax.util.text import listed


def fit_status(
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
    unknown: Sequence[str] = (),
    unseen: tuple[str, ...] = (),
) -> tuple[Status, str, str]:
    """The status of a fit that came to its end, why, and what to do.

    Args:
        settled: whether the solver came to rest on the last level.
        explained: whether the picture is near the target, so that what is left can be told from what noise leaves.
        excess: by how many standard errors chi-square is too large for the noise that was given; 0 if none was.
        next_move: length in standard errors of the step that would come next, if the last steps ended on their own; 0
            if the solver had used up its steps.
        unknown: what a user can say of the observation that was not known.
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
            ", ".join([*unknown, "fit a larger picture, or start nearer"]),
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


def contradicted_status(
    found: Sequence[Contradiction], status: Status, message: str, advice: str
) -> tuple[Status, str, str]:
    """The status of a fit at rest whose picture contradicts what was stated: that comes first of all."""
    words = "the picture contradicts what was stated of " + "; of ".join(one.words for one in found)
    again = f"measure {listed(one.name for one in found)} again, leave the prior out, or free what else may be wrong"
    if status == "converged":
        return "model_incomplete", words, again
    return "model_incomplete" if status == "ambiguous" else status, f"{words}; {message}", f"{again}; {advice}"


def interrupted_status(
    stopped: str, is_known: bool, has_moved: bool, is_solved: bool = False, settled: bool = False
) -> tuple[Status, str, str]:
    """The status of a fit that was stopped, why, and what to do.

    Args:
        is_solved: whether all was solved to the end: only profiles and the check of the model are missing.
    """
    way = "run it again with more time (--max-seconds)"
    if is_solved:
        return (
            "interrupted",
            f"{stopped}; {'the solver came to rest' if settled else 'the solver was still moving'}, but the model was "
            "not checked: the errors are those of the noise, as if nothing in the target differed from the scene",
            f"{way}, or look at the residual",
        )
    if not has_moved:
        return "interrupted", f"{stopped}, before the first step: nothing was fitted", way
    values = "the values are those of the last accepted step" + ("" if is_known else ", without error bars")
    return "interrupted", f"{stopped}; {values}", f"{way}, or take the values as a rough estimate"


def bounds_in_words(at_bound: Sequence[tuple[str, float]]) -> str:
    """The estimates that ran to a bound, as the end of a sentence."""
    return "".join(f"; {name} is at its bound, {bound:g}" for name, bound in at_bound)


def profiles_in_words(profiles: Sequence[Profile], names: Sequence[str], standard_error: np.ndarray) -> str:
    """The profiles that contradict the error bar of their parameter, as the end of a sentence."""
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
    """Standard errors by which the mean square of a residual is above that of noise of standard deviation `sigma`.

    It is 0 where they do not, or where a standard deviation larger by the fraction `tolerance` would explain it: nobody
    knows it better.
    """
    if sigma is None:
        return 0.0
    squares = (residual[:, counts] / sigma) ** 2
    mean, error = float(squares.mean()), float(squares.std() / np.sqrt(max(squares.size, 1)))
    excess = (mean - 1) / error if error > 0 else 0.0
    return excess if excess > significant and mean > (1 + tolerance) ** 2 else 0.0


def make_result(setup: FitSetup, options: FitOptions, recorder: Recorder, stopped: str | None) -> FitResult:
    """Judge what was found and gather the result.

    Nothing is traced any more: what a fit that was stopped has not computed stays unknown.
    """
    problem, findings = setup.problem, recorder.findings
    solution = findings.solution
    names = problem.unknowns.names
    check = findings.check or ModelCheck.nothing(len(names))
    # How the fit went.
    history = FitHistory(
        steps=tuple(recorder.history),
        candidate=findings.minima[0].summary.candidate if findings.minima else 0,
        runner_ups=tuple(minimum.summary for minimum in findings.minima[1:]),
    )

    # Where the fit ended, and how sure that is.
    if solution is None:
        y = problem.start() if findings.answer is None else problem.array(findings.answer)
        edges, loss, target_samples = options.edges, options.loss, options.target_samples
        uncertainty = Uncertainty.unknown(len(names), options.sigma)
        observed = problem.observation
        pictures = FitPictures(np.asarray(observed.target), weights_of(problem))
    else:
        uncertainty = findings.uncertainty or quantify_uncertainty(solution, options.sigma)
        loss = solution.stage.loss
        y, edges, target_samples = solution.y, solution.stage.edges, samples_of(solution.problem)
        pictures = _pictures(problem, solution, findings.start_image)

    # The word for it.
    at_bound = bounds_reached(y, problem.unknowns)
    settled = solution is not None and solution.settled
    if stopped is not None:
        has_moved = any(step.step > 0 and step.accepted for step in recorder.history)
        is_known = not np.all(np.isnan(uncertainty.standard_error))
        is_solved = is_known and findings.uncertainty is not None
        status, message, advice = interrupted_status(stopped, is_known, has_moved, is_solved, settled)
    else:
        assert solution is not None
        residual, counts = solution.residual, solution.observation.counts
        explained = is_near(residual, solution.weighted_target, counts)
        status, message, advice = fit_status(
            settled=settled,
            explained=explained,
            finite=solution.linearization.is_finite,
            check=check,
            excess=chi_square_excess(residual, counts, options.sigma if solution.stage.loss == "l2" else None),
            uncertainty=uncertainty,
            unseen=tuple(findings.unseen),
            runner_ups=history.runner_ups,
            max_steps=options.max_steps,
            next_move=solution.next_move,
            unknown=[stage.advice for stage in solution.problem.stages if stage.advice],
        )
        otherwise = prior_contradictions(setup, solution, uncertainty, check) if settled else ()
        if otherwise:
            status, message, advice = contradicted_status(otherwise, status, message, advice)
        if status in ("not_converged", "model_incomplete"):
            advice += above_one_in_words(problem, explained, dict(at_bound))
    message += bounds_in_words(at_bound) + profiles_in_words(findings.profiles, names, uncertainty.standard_error)

    # The result.
    return FitResult(
        ending=Ending(status, message, advice, at_bound),
        names=names,
        value=problem.values(y),
        uncertainty=dataclasses.replace(uncertainty, sigma=uncertainty.sigma * problem.unit),
        check=check,
        profiles=findings.profiles,
        given=Given(
            initial=problem.unknowns.initial(problem.scene),
            units=tuple(resolve(problem.scene, name).attribute.unit for name in names),
            priors=tuple((name, *prior) for name, prior in setup.priors.items()),
            ties=problem.unknowns.ties,
            loss=loss,
            target_samples=target_samples,
        ),
        scene=problem.scene_at(y),
        settings=dataclasses.replace(problem.base, edges=edges),
        pictures=pictures,
        history=history,
        provenance={
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "target_sha256": hashlib.sha256(np.ascontiguousarray(pictures.target).tobytes()).hexdigest(),
            "seconds": f"{recorder.history[-1].seconds:.3g}" if recorder.history else "0",
        },
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
        found = float(values[place]), math.sqrt(variance)
        compared.append(Contradiction.of(name, found, stated, excess))
    return contradicted(compared)


def above_one_in_words(problem: Problem, explained: bool, at_bound: Mapping[str, float]) -> str:
    """A note on free indices that start above 1, below which no fit then looks, as the end of a sentence.

    Below 1 lies what ran to that bound, or what explains a picture that nothing above does.
    """
    names = problem.unknowns.names
    stuck = [
        name
        for name, transform in zip(names, problem.unknowns.transforms, strict=True)
        if resolve(problem.scene, name).attribute.quantity.role == "index" and transform.lower == 1
        if not explained or name in at_bound
    ]
    if not stuck:
        return ""
    return (
        f"; {listed(stuck)} began above 1 and stayed there: for a ball thinner than its surroundings, -D {stuck[0]}=0.9"
    )


def weights_of(problem: Problem) -> np.ndarray:
    """The weights of a target's pixels, "height width", in the unit in which they were given."""
    return (np.asarray(problem.observation.root_weight, np.float64) * problem.unit) ** 2


def _pictures(problem: Problem, solution: FitState, start: np.ndarray | None) -> FitPictures:
    """The pictures of a problem's solution, and how they differ; pixels that are not finite do not count."""
    linearization, observed = solution.linearization, solution.problem.observation
    weight = solution.under_loss("weight")
    return FitPictures(
        target=np.asarray(problem.observation.target),
        weights=np.where(np.asarray(linearization.bad), 0, weights_of(problem)),
        start=start,
        estimate=np.asarray(linearization.image + observed.bias),
        rms_residual=solution.rms_residual * problem.unit,
        typical_residual=MAD_TO_SIGMA * float(linearization.typical) * problem.unit,
        # A robust loss leaves out what it counts for less than a hundredth of the others.
        left_out=int(np.sum(solution.observation.counts & (weight.min(axis=0) < 0.01))),
    )
