"""What a fit found, judged and gathered as its result."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.goodness_of_fit import is_near
from raytrace_jax.inverse.judge.model_check import ModelCheck
from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA, Uncertainty, correlation_of, quantify_uncertainty
from raytrace_jax.inverse.judge.verdict import bounds_in_words, chi_square_excess, profiles_in_words, rests_on, verdict
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.losses import evaluate
from raytrace_jax.inverse.problem.pose import Posed
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.result import FitResult, Profile
from raytrace_jax.inverse.solve.bounds import bounds_reached
from raytrace_jax.inverse.solve.local_minimum import LocalMinimum
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.solution import Solution
from raytrace_jax.scene.setting_words import EdgeMode

LEFT_OUT = 0.01
"""A pixel that a robust loss counts for less than this share of the others is left out."""


@dataclasses.dataclass
class Findings:
    """What a fit has found so far.

    Args:
        minima: all of them, best first.
        solution: where the whole picture was solved to.
        profiles: those that are done.
        by_stored_numbers: the estimate from the target's stored numbers, if they decide.
        uncertainty: how sure that solution is.
        check: whether the model is right, if that was looked at.
        start_image: the picture at the start, compared as the solution's is.
        stopped: why the fit was stopped before its end, if it was.
    """

    minima: list[LocalMinimum] = dataclasses.field(default_factory=list)
    solution: Solution | None = None
    uncertainty: Uncertainty | None = None
    profiles: tuple[Profile, ...] = ()
    by_stored_numbers: tuple[Solution, Uncertainty] | None = None
    check: ModelCheck | None = None
    start_image: np.ndarray | None = None
    stopped: str | None = None


class _End(NamedTuple):
    """Where a fit ended; arguments of the same name as those of `FitResult` are these."""

    y: Float[Array, " parameters"]
    edges: EdgeMode
    loss: str
    target_samples: int | None
    uncertainty: Uncertainty
    settled: bool
    next_move: float
    explained: bool
    finite: bool
    excess: float
    rms_residual: float
    typical_residual: float
    left_out: int
    start_image: np.ndarray | None
    image: np.ndarray | None
    bad: np.ndarray | bool = False


def _unsolved(problem: Problem, options: FitOptions, recorder: Recorder) -> _End:
    """The end of a fit that was stopped before the whole picture was solved."""
    y = problem.start() if recorder.answer is None else problem.array(recorder.answer)
    unknown = Uncertainty.unknown(len(problem.unknowns.names), options.sigma)
    return _End(
        y=y,
        edges=options.edges,
        loss=options.loss,
        target_samples=options.target_samples,
        uncertainty=unknown,
        settled=False,
        next_move=0.0,
        explained=False,
        finite=True,
        excess=0.0,
        rms_residual=np.nan,
        typical_residual=np.nan,
        left_out=0,
        start_image=None,
        image=None,
    )


def _solved(options: FitOptions, findings: Findings, solution: Solution) -> _End:
    comparison = solution.comparison
    if findings.by_stored_numbers is not None:
        loss, (solution, uncertainty) = "quantization", findings.by_stored_numbers
    else:
        loss, uncertainty = comparison.loss, findings.uncertainty or uncertainty_of(solution, options.sigma)
    linearization, solved = solution.linearization, solution.problem
    residual, counts = solved.residual_of(linearization), np.asarray(solved.observation.root_weight) > 0
    weight = evaluate(comparison.loss, "weight", residual, comparison.loss_scale)
    return _End(
        y=solution.y,
        edges=comparison.edges,
        loss=loss,
        target_samples=solved.base.samples if comparison.edges == "point" else solution.target_samples,
        uncertainty=uncertainty,
        settled=solution.settled,
        next_move=solution.next_move,
        explained=is_near(residual, np.asarray(solved.observation.target), counts),
        finite=linearization.is_finite,
        excess=chi_square_excess(residual, counts, options.sigma if comparison.loss == "l2" else None),
        rms_residual=solved.rms_residual(linearization),
        typical_residual=MAD_TO_SIGMA * float(linearization.typical),
        left_out=int(np.sum(counts & (weight.min(axis=0) < LEFT_OUT))),
        start_image=findings.start_image,
        image=np.asarray(linearization.image + solution.problem.observation.bias),
        bad=np.asarray(linearization.bad),
    )


def uncertainty_of(solution: Solution, sigma: float | None) -> Uncertainty:
    """How sure a solution is."""
    return quantify_uncertainty(
        solution.problem, solution.linearization, solution.y, solution.comparison, sigma, solution.resolution
    )


def conclude(posed: Posed, options: FitOptions, findings: Findings, recorder: Recorder) -> FitResult:
    """Judge what was found and gather the result.

    Of a fit that was stopped nothing is traced any more: what was not computed is unknown.
    """
    problem, solution = posed.problem, findings.solution or recorder.solution
    end = _solved(options, findings, solution) if solution else _unsolved(problem, options, recorder)
    uncertainty, at_bound = end.uncertainty, bounds_reached(end.y, problem.unknowns)
    check = findings.check or ModelCheck.nothing(len(problem.unknowns.names))
    runner_ups = tuple(minimum.summary for minimum in findings.minima[1:])
    status, message, advice = verdict(
        stopped=findings.stopped,
        has_moved=bool(recorder.history),
        can_go_on=recorder.can_go_on,
        settled=end.settled,
        explained=end.explained,
        finite=end.finite,
        structured=check.is_structured,
        causes=check.causes,
        excess=end.excess,
        uncertainty=uncertainty,
        runner_ups=runner_ups,
        max_steps=options.max_steps,
        next_move=end.next_move,
    )
    systematic = check.stated + check.structure
    total = uncertainty.covariance + systematic
    return FitResult(
        status=status,
        message=message
        + bounds_in_words(at_bound)
        + profiles_in_words(findings.profiles, problem.unknowns.names, uncertainty.standard_error),
        advice=advice,
        names=problem.unknowns.names,
        units=posed.units,
        value=problem.values(end.y),
        initial=problem.unknowns.initial(problem.scene),
        at_bound=at_bound,
        standard_error=uncertainty.standard_error,
        systematic_error=np.sqrt(np.diagonal(systematic)),
        total_correlation=correlation_of(total),
        assumptions=check.assumptions,
        causes=check.causes,
        rests_on=rests_on(check.assumptions, problem.unknowns.names, uncertainty.standard_error),
        correlation=uncertainty.correlation,
        cramer_rao=uncertainty.cramer_rao,
        sigma=uncertainty.sigma,
        sigma_given=options.sigma is not None,
        reduced_chi_square=uncertainty.reduced_chi_square,
        condition_number=uncertainty.condition_number,
        weakest=uncertainty.weakest,
        rms_residual=end.rms_residual,
        typical_residual=end.typical_residual,
        left_out=end.left_out,
        loss=end.loss,
        target_samples=end.target_samples,
        candidate=findings.minima[0].summary.candidate if findings.minima else 0,
        runner_ups=runner_ups,
        profiles=findings.profiles,
        priors=tuple((name, *prior) for name, prior in posed.priors.items()),
        ties=problem.unknowns.ties,
        scene=problem.scene_at(end.y),
        settings=problem.settings(end.edges),
        target=np.asarray(problem.observation.target),
        start_image=end.start_image,
        image=end.image,
        weights=np.where(end.bad, 0, np.asarray(problem.observation.root_weight) ** 2),
        history=tuple(recorder.history),
    )
