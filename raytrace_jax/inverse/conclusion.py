"""What a fit found, judged and gathered as its result."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.goodness_of_fit import explains
from raytrace_jax.inverse.judge.uncertainty import Uncertainty, quantify_uncertainty
from raytrace_jax.inverse.judge.verdict import verdict
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.pose import Posed
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.result import FitResult, Profile
from raytrace_jax.inverse.solve.local_minimum import LocalMinimum
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.solution import Solution
from raytrace_jax.tracer.settings import EdgeMode


@dataclasses.dataclass
class Findings:
    """What a fit has found so far.

    Args:
        minima: all of them, best first.
        solution: where the whole picture was solved to.
        profiles: those that are done.
        by_stored_numbers: the estimate from the target's stored numbers, if they decide.
        stopped: why the fit was stopped before its end, if it was.
    """

    minima: list[LocalMinimum] = dataclasses.field(default_factory=list)
    solution: Solution | None = None
    profiles: tuple[Profile, ...] = ()
    by_stored_numbers: tuple[Solution, Uncertainty] | None = None
    stopped: str | None = None


class _End(NamedTuple):
    """Where a fit ended; arguments of the same name as those of `FitResult` are these."""

    y: Float[Array, " parameters"]
    edges: EdgeMode
    loss: str
    uncertainty: Uncertainty
    settled: bool
    explained: bool
    rms_residual: float
    start_image: np.ndarray | None
    image: np.ndarray | None


def _unsolved(problem: Problem, options: FitOptions, recorder: Recorder) -> _End:
    """The end of a fit that was stopped before the whole picture was solved."""
    y = problem.start() if recorder.answer is None else problem.array(recorder.answer)
    unknown = Uncertainty.unknown(len(problem.unknowns.names), options.sigma)
    return _End(y, options.edges, options.loss, unknown, False, False, np.nan, None, None)


def _solved(problem: Problem, options: FitOptions, findings: Findings, solution: Solution) -> _End:
    comparison = solution.comparison
    start_image = None
    if findings.stopped is None:
        start_image = np.asarray(problem.linearize(problem.start(), comparison).image)
    if findings.by_stored_numbers is not None:
        loss, (solution, uncertainty) = "quantization", findings.by_stored_numbers
    else:
        loss, uncertainty = comparison.loss, uncertainty_of(solution, options.sigma)
    linearization = solution.linearization
    return _End(
        y=solution.y,
        edges=comparison.edges,
        loss=loss,
        uncertainty=uncertainty,
        settled=solution.settled,
        explained=explains(solution.problem, linearization),
        rms_residual=solution.problem.rms_residual(linearization),
        start_image=start_image,
        image=np.asarray(linearization.image + solution.problem.observation.bias),
    )


def uncertainty_of(solution: Solution, sigma: float | None) -> Uncertainty:
    """How sure a solution is."""
    return quantify_uncertainty(solution.problem, solution.linearization, solution.y, solution.comparison, sigma)


def conclude(posed: Posed, options: FitOptions, findings: Findings, recorder: Recorder) -> FitResult:
    """Judge what was found and gather the result.

    Of a fit that was stopped nothing is traced any more: what was not computed is unknown.
    """
    problem, solution = posed.problem, findings.solution or recorder.solution
    end = _solved(problem, options, findings, solution) if solution else _unsolved(problem, options, recorder)
    uncertainty = end.uncertainty
    runner_ups = tuple(minimum.summary for minimum in findings.minima[1:])
    status, message, advice = verdict(
        stopped=findings.stopped,
        settled=end.settled,
        explained=end.explained,
        uncertainty=uncertainty,
        runner_ups=runner_ups,
        max_steps=options.max_steps,
    )
    return FitResult(
        status=status,
        message=message,
        advice=advice,
        names=problem.unknowns.names,
        units=posed.units,
        value=problem.values(end.y),
        initial=problem.unknowns.initial(problem.scene),
        standard_error=uncertainty.standard_error,
        correlation=uncertainty.correlation,
        cramer_rao=uncertainty.cramer_rao,
        sigma=uncertainty.sigma,
        sigma_given=options.sigma is not None,
        reduced_chi_square=uncertainty.reduced_chi_square,
        condition_number=uncertainty.condition_number,
        weakest=uncertainty.weakest,
        rms_residual=end.rms_residual,
        loss=end.loss,
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
        weights=np.asarray(problem.observation.root_weight) ** 2,
        history=tuple(recorder.history),
    )
