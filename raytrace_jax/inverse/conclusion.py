"""What a fit found, judged and gathered as its result."""

import dataclasses
import datetime
import hashlib

import numpy as np

from raytrace_jax.inverse.judge.assumptions import ModelCheck
from raytrace_jax.inverse.judge.verdict import (
    above_one_in_words,
    bounds_in_words,
    chi_square_excess,
    interrupted,
    profiles_in_words,
    verdict,
)
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.pose import Posed
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.result import FitHistory, FitPictures, FitResult
from raytrace_jax.inverse.solve.bounds import bounds_reached, held, within
from raytrace_jax.inverse.solve.gauss_newton import gauss_newton_step
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.statistics.goodness_of_fit import is_near
from raytrace_jax.inverse.statistics.uncertainty import MAD_TO_SIGMA, Uncertainty, quantify_uncertainty
from raytrace_jax.scene.parameters import resolve


def conclude(posed: Posed, options: FitOptions, recorder: Recorder, stopped: str | None) -> FitResult:
    """Judge what was found and gather the result.

    Nothing is traced any more: what a fit that was stopped has not computed stays unknown.

    Args:
        posed: the problem.
        options: what the user asked for.
        recorder: what was found, and how.
        stopped: why the fit was stopped before its end, if it was.
    """
    problem, findings = posed.problem, recorder.findings
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
        pictures = FitPictures(np.asarray(observed.target), np.asarray(observed.root_weight) ** 2)
    else:
        uncertainty = findings.uncertainty or quantify_uncertainty(solution, options.sigma)
        loss = solution.comparison.loss
        y, edges, target_samples = solution.y, solution.comparison.edges, solution.target_samples
        if edges == "point":
            target_samples = solution.problem.base.samples
        pictures = _pictures(problem, solution, findings.start_image)

    # The word for it.
    at_bound = bounds_reached(y, problem.unknowns)
    if stopped is not None:
        has_moved = any(step.step > 0 and step.accepted for step in recorder.history)
        is_known = not np.all(np.isnan(uncertainty.standard_error))
        status, message, advice = interrupted(stopped, is_known, has_moved)
    else:
        assert solution is not None
        residual, counts = solution.residual, solution.counts
        explained = is_near(residual, pictures.target, counts)
        status, message, advice = verdict(
            settled=solution.settled or is_within_errors(solution, uncertainty, check),
            explained=explained,
            finite=solution.linearization.is_finite,
            check=check,
            excess=chi_square_excess(residual, counts, options.sigma if solution.comparison.loss == "l2" else None),
            uncertainty=uncertainty,
            unseen=tuple(findings.unseen),
            runner_ups=history.runner_ups,
            max_steps=options.max_steps,
            next_move=solution.next_move,
            knows_samples=(target_samples or options.target_samples) is not None,
        )
        # Below 1 lies what ran to that bound, or what explains a picture that nothing above does.
        stuck = [name for name in kept_above_one(problem) if not explained or name in dict(at_bound)]
        if status in ("not_converged", "model_incomplete"):
            advice += above_one_in_words(stuck)
    message += bounds_in_words(at_bound) + profiles_in_words(findings.profiles, names, uncertainty.standard_error)

    # The result.
    return FitResult(
        status=status,
        message=message,
        advice=advice,
        names=names,
        units=posed.units,
        value=problem.values(y),
        initial=problem.unknowns.initial(problem.scene),
        at_bound=at_bound,
        uncertainty=uncertainty,
        check=check,
        profiles=findings.profiles,
        priors=tuple((name, *prior) for name, prior in posed.priors.items()),
        ties=problem.unknowns.ties,
        loss=loss,
        target_samples=target_samples,
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


def is_within_errors(solution: FitState, uncertainty: Uncertainty, check: ModelCheck) -> bool:
    """Whether the step that would come next stays within the total error of every estimate.

    It asks so of steps that ended on their own. What makes errors, such as storage and samples, also moves the place of
    rest with each step, and the solver goes to and fro.
    """
    problem = solution.problem
    variance = np.diagonal(uncertainty.covariance + check.covariance)
    if not solution.next_move > 0 or not np.isfinite(variance).all():
        return False
    step = gauss_newton_step(held(solution.linearization, solution.y, problem.unknowns))
    there = problem.values(problem.array(within(problem.array(solution.y + step), problem.unknowns)))
    return bool(np.all((there - problem.values(solution.y)) ** 2 <= variance))


def kept_above_one(problem: Problem) -> tuple[str, ...]:
    """The free indices that start above 1, below which no fit then looks."""
    scene, names = problem.scene, problem.unknowns.names
    indices = {name for name in names if resolve(scene, name).attribute.quantity.role == "index"}
    rows = zip(names, problem.unknowns.transforms, strict=True)
    return tuple(name for name, transform in rows if name in indices and transform.limits[0] == 1)


def _pictures(problem: Problem, solution: FitState, start: np.ndarray | None) -> FitPictures:
    """The pictures of a problem's solution, and how they differ; pixels that are not finite do not count."""
    linearization, observed = solution.linearization, solution.problem.observation
    weight = solution.under_loss("weight")
    return FitPictures(
        target=np.asarray(problem.observation.target),
        weights=np.where(np.asarray(linearization.bad), 0, np.asarray(problem.observation.root_weight) ** 2),
        start=start,
        estimate=np.asarray(linearization.image + observed.bias),
        rms_residual=solution.rms_residual,
        typical_residual=MAD_TO_SIGMA * float(linearization.typical),
        # A robust loss leaves out what it counts for less than a hundredth of the others.
        left_out=int(np.sum(solution.counts & (weight.min(axis=0) < 0.01))),
    )
