"""From a minimum of the small pictures to the answer: the unblurred picture, sampled as the target is."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA, noise_level
from raytrace_jax.inverse.observe.noise import EVIDENCE, explains
from raytrace_jax.inverse.observe.resampled import settle
from raytrace_jax.inverse.observe.sampling import COARSE_SAMPLES, Sampling, detect_grid, point_sampled
from raytrace_jax.inverse.options import FitOptions, Stage
from raytrace_jax.inverse.problem.linearize import LOSSES
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.problem.unknowns import Image, Vector
from raytrace_jax.inverse.solve.solvers import gauss_newton, levenberg_marquardt
from raytrace_jax.inverse.solve.steps import LocalMinimum, Recorder
from raytrace_jax.util.numerics import finite_or_last


def select_solution(
    problem: Problem,
    minima: list[LocalMinimum],
    level: int,
    options: FitOptions,
    recorder: Recorder,
    detect: Callable[[Vector], Sampling],
) -> tuple[list[LocalMinimum], FitState]:
    """Solve the best minimum to the end, and those that the small pictures do not tell from it.

    Returns:
        All minima, best first, with their values and evidence where they were solved to the end; and the best one.
    """
    if options.known_sampling == "auto":
        recorder.phase("telling how the target was sampled")
        options = dataclasses.replace(options, target_sampling=detect(minima[0].y))
    recorder.phase("solving on the whole picture")

    # Solve the best minimum and its rivals to the end.
    # Small pictures are a coarse model: a runner-up is out only where twice the usual evidence is against it.
    rivals = [m for m in minima[1:] if m.summary.explained and m.summary.evidence < 2 * EVIDENCE][:2]
    solutions: list[FitState] = []
    for minimum in (minima[0], *rivals):
        recorder.begin(minimum.summary.candidate, level)
        solutions.append(refine(problem, minimum.y, options, recorder))
        recorder.found(solution=solutions[0])

    # The best is now the one with the least loss. Losses compare at one scale only.
    loss_scale = max(solution.stage.loss_scale for solution in solutions)
    ends = [
        (minimum.summary.candidate, solution, solution.under_loss("residual", loss_scale))
        for minimum, solution in zip((minima[0], *rivals), solutions, strict=True)
    ]
    ends.sort(key=lambda end: finite_or_last(float(np.sum(end[2] ** 2))))
    _, winner, least = ends[0]

    def at_end(candidate: int, solution: FitState, residual: Image) -> LocalMinimum:
        minimum = LocalMinimum.of(solution, candidate, level)
        return dataclasses.replace(minimum, residual=residual).judged_against(least)

    best, *others = (at_end(*end) for end in ends)
    # Starts that came together on the whole picture are one minimum, as far as solves stop apart.
    distinct = [m for m in others if problem.scaled_distance(m.summary.value, best.summary.value) > 1e-3]
    untouched = [minimum for minimum in minima[1:] if all(minimum is not rival for rival in rivals)]
    return [best, *distinct, *untouched], winner


def refine(problem: Problem, y: Vector, options: FitOptions, recorder: Recorder) -> FitState:
    """Solve the whole picture from the unknowns `y`.

    A point-sampled picture is smooth in its parameters but at the pixels that an edge passes; there it jumps, which no
    derivative sees. So least squares on such a picture begin with the Cauchy loss, to which these few are outliers. One
    jump changes that loss by as much as six standard errors do. A solver that asks the loss to fall is held up by every
    pixel on its way, so that the fit ends with steps that do not ask (iteratively reweighted least squares).

    An edge-aware picture is nearly that of a box-filtered target. A picture of samples, which has no derivative of its
    own, tells where it errs: it is what steps with the edge-aware derivative bring to the target (`resampled.settle`).
    """
    stage = options.last_stage
    if stage.edges == "aware":
        return refine_aware(problem, y, options, recorder)

    # To about an error bar, since the steps that follow do not ask whether the cost falls.
    near = dataclasses.replace(first_stage(stage), relative=1e-6, decrease=1e-6, rejected=1)
    solution = solve_in_stages(problem, y, near, options.sigma, recorder)
    solution = gauss_newton(solution, lambda y: FitState.at(problem, y, solution.stage), recorder.step)
    return solution if stage.loss != "l2" else solve_in_stages(problem, solution.y, stage, options.sigma, recorder)


def first_stage(stage: Stage) -> Stage:
    """The first stage on the whole picture, in which the few point samples that an edge has passed are outliers."""
    return dataclasses.replace(stage, loss="cauchy") if stage.edges == "point" else stage


def refine_aware(problem: Problem, y: Vector, options: FitOptions, recorder: Recorder) -> FitState:
    """Solve an edge-aware picture; then correct it by samples like the target's, unless that is edge-aware itself.

    A target that is, and that the picture does not explain, is solved roughly: its structure moves the answer more.
    """
    stage = options.last_stage
    # Corrections, and what is not explained, move the answer by more than a hundredth of an error bar.
    rough = dataclasses.replace(stage, relative=1e-6, decrease=1e-4, rejected=1)
    solution = solve_in_stages(problem, y, rough, options.sigma, recorder)
    if options.known_sampling == "aware":
        return solve_in_stages(problem, solution.y, stage, options.sigma, recorder) if explains(solution) else solution
    samples, coarse = options.target_samples, None
    # Tell the target's grid of samples, of which a lossy file leaves nothing.
    if samples is None and problem.storage is None:
        recorder.phase("telling the target's samples")
        coarse = point_sampled(problem, solution.y, COARSE_SAMPLES)
        samples = detect_grid(problem, solution.y, coarse, solution.linearization.pixel_jacobian)
    return settle(problem, solution, samples, recorder, coarse)


def solve_in_stages(problem: Problem, y: Vector, stage: Stage, sigma: float | None, recorder: Recorder) -> FitState:
    """Solve from `y`, once, or in stages.

    The scale of a robust loss follows the typical residual down, stage by stage: near the answer few residuals are
    large, and the loss lets the others decide. If the noise is not known, but there are priors, it is estimated stage
    by stage too: priors count beside it.
    """
    # Stages need the residual of the stage before, and the first one that of the start.
    y = problem.array(y)
    has_prior = np.any(np.asarray(problem.prior.precision) > 0)
    in_stages = stage.loss != "l2" or (has_prior and sigma is None)
    before: FitState | None = None
    if in_stages:
        before = FitState.at(problem, y, dataclasses.replace(stage, loss_scale=1.0))
    # Where the picture fits exactly the scale is 1e-12 or ten roundings: 1e-15 to 1e-6 do the same.
    least = max(1e-12, 10 * float(jnp.finfo(problem.observation.target.dtype).eps))
    stage = dataclasses.replace(stage, noise=sigma or 0.0)
    number = 0
    while True:
        if before is not None:
            noise = sigma if sigma is not None else noise_level(before)
            scatter = max(MAD_TO_SIGMA * float(before.linearization.typical), sigma or 0.0, least)
            loss_scale = LOSSES[stage.loss].tuning * scatter
            stage = dataclasses.replace(stage, noise=noise, loss_scale=loss_scale)
        solution = levenberg_marquardt(problem, y, stage, recorder.step)
        # Go on while the typical residual falls by three tenths or more: ten stages take off a factor of 35.
        if before is None or not solution.settled or number == 9:
            return solution
        if float(solution.linearization.typical) > 0.7 * float(before.linearization.typical):
            return solution
        y, before, number = solution.y, solution, number + 1
