"""From a minimum of the small pictures to the answer: the unblurred picture, sampled as the target is."""

import dataclasses
import functools
import time
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from ...util.numerics import MAD_TO_SIGMA, finite_or_last
from ..judge.structure import EVIDENCE, explains
from ..judge.uncertainty import noise_level
from ..observe import sampling
from ..observe.resampled import resampled
from ..options import FitOptions, Stage
from ..problem.linearize import LOSSES
from ..problem.problem import FitState, Problem
from ..problem.unknowns import Values, Vector
from .solvers import GaussNewton, LevenbergMarquardt, levenberg_marquardt, minimise
from .steps import LocalMinimum, Recorder


def select_solution(
    problem: Problem,
    minima: list[LocalMinimum],
    level: int,
    options: FitOptions,
    recorder: Recorder,
    detect: Callable[[Vector], sampling.SamplingKind],
    error_of: Callable[[FitState], Values] | None = None,
) -> tuple[list[LocalMinimum], FitState]:
    """Solve the best minimum to the end, and those that the small pictures do not tell from it.

    Args:
        error_of: about the standard errors that the unknowns will have: what is far below them is not computed.

    Returns:
        All minima, best first, with their values and evidence where they were solved to the end; and the best one.
    """
    if options.known_sampling == "auto":
        recorder.phase("telling how the target was sampled")
        options = dataclasses.replace(options, target_sampling=detect(minima[0].y))
    recorder.phase("solving on the whole picture")
    # Small pictures are a coarse model: a runner-up is out only where twice the usual evidence is against it.
    rivals = [m for m in minima[1:] if m.summary.explained and m.summary.evidence < 2 * EVIDENCE][:2]
    solutions: list[FitState] = []
    for minimum in (minima[0], *rivals):
        recorder.begin(minimum.summary.candidate, level)
        solutions.append(refine(problem, minimum.y, options, recorder, error_of))
        recorder.found(solution=solutions[0])

    # The best is now the one with the least loss. Losses compare at one scale only.
    loss_scale = max(solution.stage.loss_scale for solution in solutions)
    ends: list[tuple[LocalMinimum, FitState]] = []
    for minimum, solution in zip((minima[0], *rivals), solutions, strict=True):
        end = LocalMinimum.of(solution, minimum.summary.candidate, level)
        ends.append((end._replace(residual=solution.under_loss("residual", loss_scale)), solution))
    ends.sort(key=lambda end: finite_or_last(float(np.sum(end[0].residual ** 2))))
    best, winner = ends[0]
    # Starts that came together on the whole picture are one minimum, as far as solves stop apart.
    distinct = [end for end, _ in ends[1:] if problem.distance(end.summary.value, best.summary.value) > 1e-3]
    untouched = [minimum for minimum in minima[1:] if all(minimum is not rival for rival in rivals)]
    return [end.judged_against(best.residual) for end in (best, *distinct)] + untouched, winner


def first_stage(stage: Stage) -> Stage:
    """The first stage on the whole picture, in which the few point samples that an edge has passed are outliers."""
    return dataclasses.replace(stage, loss="cauchy") if stage.edges == "point" else stage


def refine(
    problem: Problem,
    y: Vector,
    options: FitOptions,
    recorder: Recorder,
    error_of: Callable[[FitState], Values] | None = None,
) -> FitState:
    """Solve the whole picture from the unknowns `y`.

    A point-sampled picture is smooth in its parameters but at the pixels that an edge passes; there it jumps, which no
    derivative sees. So least squares on such a picture begin with the Cauchy loss, to which these few are outliers. One
    jump changes that loss by as much as six standard errors do. A solver that asks the loss to fall is held up by every
    pixel on its way, so that the fit ends with steps that do not ask (iteratively reweighted least squares).

    An edge-aware picture is nearly that of a box-filtered target. A picture of samples, which has no derivative of its
    own, tells where it errs: it is what steps with the edge-aware derivative bring to the target (`settle`). A target
    that is edge-aware itself needs no such steps; one that the picture does not explain is solved roughly, since its
    structure moves the answer more.
    """
    stage, steps = options.last_stage, options.max_steps
    if stage.edges == "point":
        problem = sampling.sampled(problem, sampling.Sampling(problem.base.samples))
        # To about an error bar, since the steps that follow do not ask whether the cost falls.
        near = LevenbergMarquardt(steps, relative=1e-6, decrease=1e-6, rejected=1)
        solution = solve_in_stages(problem, y, first_stage(stage), options.sigma, recorder, near)
        solution = minimise(GaussNewton(), solution, lambda y: FitState.at(problem, y, solution.stage), recorder.step)
        if stage.loss != "l2":
            return solution
    else:
        # Corrections, and what is not explained, move the answer by more than a hundredth of an error bar.
        rough = LevenbergMarquardt(steps, relative=1e-6, decrease=1e-4, rejected=1)
        solution = solve_in_stages(problem, y, stage, options.sigma, recorder, rough)
        is_aware, coarse = options.known_sampling == "aware", None
        if not is_aware and sampling.samples_of(problem) is None:
            recorder.phase("telling the target's samples")
            coarse = sampling.point_sampled(problem, solution.y, sampling.COARSE_SAMPLES)
            told = sampling.detect_samples(problem, solution.y, coarse, solution.linearization)
            is_aware = told == "aware"
            problem = problem if told == "aware" else sampling.sampled(problem, sampling.Sampling(told))
        if not is_aware:
            return settle(problem, solution, recorder, coarse, error_of and error_of(solution))
        if not explains(solution):
            return solution
    return solve_in_stages(problem, solution.y, stage, options.sigma, recorder, LevenbergMarquardt(steps))


def settle(
    problem: Problem,
    solution: FitState,
    recorder: Recorder,
    coarse: sampling.Moments | None = None,
    error: Values | None = None,
) -> FitState:
    """Take steps on the picture as it was observed; the edge-aware derivative leads.

    That picture has no derivative of use: it changes only where an edge crosses a sample, and then in a jump. But on
    average it changes as the area on one side of the edge does, whose derivative is the edge-aware one. So each step
    leads to where few samples are on the wrong side, and the next one ends nearer: a step with the derivative `A'` of a
    picture that changes by `S'` leaves `1 - A'^+ S'` of the error. A step samples the pixels at edges anew, which is
    cheap beside a derivative.

    The samples are the target's. Where these are not known pixels are taken for means over their area, and ours have as
    many samples as it takes for their error to be a small part of the residual.

    Args:
        coarse: `COARSE_SAMPLES` samples a pixel and side at the solution, if they are known.
        error: about the standard errors that the unknowns will have: samples that would move them by far less are not
            traced, and so short steps are not taken.
    """
    # The typical residual's: pixels at edges are off by what is to be found here.
    noise = 0.0 if error is None else MAD_TO_SIGMA * float(solution.linearization.typical)
    stage, y, size, left = solution.stage, solution.y, sampling.lattice_size(), 4
    samples = sampling.samples_of(problem)
    whose = "a supersampled picture" if samples is None else "a picture of the target's own samples"
    # Again with more samples, or with another derivative and list of pixels, which hold up to a tenth of a pixel of a
    # large ball. What is not explained will not be explained by them.
    while True:
        recorder.phase(f"comparing with {whose}")
        begun = time.monotonic()
        picture = resampled(problem, y, stage, size, coarse, noise)
        # Each step samples as much again; most targets take two or three.
        if (seconds := 3 * (time.monotonic() - begun)) > 10:
            recorder.phase(f"comparing with {whose}: about {seconds:.0f} s")
        near = functools.partial(picture.state, stage=stage)
        lowest = minimise(GaussNewton(error=error), near(y), near, recorder.step)
        wanted, coarse, left = max(size, picture.needed_size(lowest, error)), None, left - 1
        moved = problem.distance(problem.values(lowest.y), problem.values(y))
        if (moved < 1e-3 and wanted == size) or left == 0 or not explains(lowest):
            break
        y, size = lowest.y, wanted
    # The solution there has the edge-aware picture and its bias.
    aware = problem.picture(lowest.y, stage.edges)
    bias = np.asarray(lowest.linearization.image) - np.asarray(aware.image)
    observed = dataclasses.replace(problem, observation=problem.observation.with_bias(bias))
    within = picture.weighted_variance if samples is None else None
    observed = sampling.sampled(observed, sampling.Sampling(samples, picture.confusion(), within))
    linearization = observed.linearize(lowest.y, stage)
    settled = lowest.settled and linearization.is_finite
    return dataclasses.replace(lowest, problem=observed, linearization=linearization, settled=settled)


def solve_in_stages(
    problem: Problem, y: Vector, stage: Stage, sigma: float | None, recorder: Recorder, method: LevenbergMarquardt
) -> FitState:
    """Solve from `y`, once, or in stages.

    The scale of a robust loss follows the typical residual down, stage by stage: near the answer few residuals are
    large, and the loss lets the others decide. If the noise is not known, but there are priors, it is estimated stage
    by stage too: priors count beside it.
    """
    has_prior = np.any(np.asarray(problem.prior.precision) > 0)
    if stage.loss == "l2" and (sigma is not None or not has_prior):
        return levenberg_marquardt(problem, y, dataclasses.replace(stage, noise=sigma or 0.0), recorder.step, method)
    # Each stage needs the residual of the one before, and the first one that of the start.
    solution = FitState.at(problem, problem.array(y), dataclasses.replace(stage, loss_scale=1.0))
    # Where the picture fits exactly the scale is 1e-12 or ten roundings: 1e-15 to 1e-6 do the same.
    least = max(1e-12, 10 * float(jnp.finfo(problem.observation.target.dtype).eps))
    # Go on while the typical residual falls by three tenths or more: ten stages take off a factor of 35.
    for _ in range(10):
        before = float(solution.linearization.typical)
        noise = sigma if sigma is not None else noise_level(solution)
        scale = LOSSES[stage.loss].tuning * max(MAD_TO_SIGMA * before, sigma or 0.0, least)
        stage = dataclasses.replace(stage, noise=noise, loss_scale=scale)
        solution = levenberg_marquardt(problem, solution.y, stage, recorder.step, method)
        if not solution.settled or float(solution.linearization.typical) > 0.7 * before:
            break
    return solution
