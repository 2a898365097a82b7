"""Levenberg-Marquardt in stages: scales that are not known follow the residuals down."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA, noise_level
from raytrace_jax.inverse.problem.comparison import LOSSES, Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.solve.least_squares import Optimum, Tolerance, levenberg_marquardt
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.solution import RefineOptions, Solution

MOST_STAGES = 10
"""At most; a stage takes off 30 % or more, so that ten follow a start whose residual is 35 times that of the answer."""

SETTLED_SHARE = 0.7
"""A stage that leaves more than this of the typical residual is the last one. Anything from 0.35 to 0.85 does the same
on two scenes (experiments/tuning)."""

LEAST_LOSS_SCALE, FEWEST_ROUNDINGS = 1e-12, 10
"""The scale of a loss when the picture fits exactly: in float64 far below any picture's rounding, and at least so many
roundings of the dtype. Anything from 1e-15 to 1e-6 does the same on two scenes (experiments/tuning)."""


def solve_in_stages(
    problem: Problem, y: Float[Array, " parameters"], options: RefineOptions, tolerance: Tolerance, recorder: Recorder
) -> Solution:
    """Solve from `y`, once, or in stages.

    The scale of a robust loss follows the typical residual down, stage by stage: near the answer few residuals are
    large, and the loss lets the others decide. So does the noise beside which priors count, where it is not known.
    """
    y, sigma = problem.array(y), options.sigma
    in_stages = options.loss != "l2" or (problem.has_prior and sigma is None)
    before: Linearization | None = None
    if in_stages:
        before = problem.linearize(y, Comparison(options.edges, loss=options.loss, loss_scale=1.0))
    stage = 0
    while True:
        comparison = Comparison(options.edges, loss=options.loss, noise=sigma or 0.0)
        if before is not None:
            comparison = scaled(problem, before, comparison, sigma)
        solved: list[Optimum] = []

        def solve(start=y, comparison=comparison, solved=solved):
            def linearize(point):
                return problem.linearize(point, comparison)

            first = recorder.steps_at(options.candidate, options.level)
            record = recorder.level(options.candidate, options.level, 0.0, first)
            solved.append(levenberg_marquardt(linearize, start, tolerance, options.max_steps, record, problem))
            return {"y": np.asarray(solved[0].y).tolist(), "settled": solved[0].settled}

        outcome = recorder.stage(f"{options.name}, stage {stage}", solve)
        y = problem.array(outcome["y"])
        after = solved[0].linearization if solved else problem.linearize(y, comparison)
        solution = Solution(problem, y, comparison, after, outcome["settled"])
        if before is None or not solution.settled or stage == MOST_STAGES - 1:
            return solution
        if float(after.typical) > SETTLED_SHARE * float(before.typical):
            return solution
        before, stage = after, stage + 1


def scaled(problem: Problem, before: Linearization, comparison: Comparison, sigma: float | None) -> Comparison:
    """A comparison whose scales are those of the residuals of a linearisation."""
    noise = sigma if sigma is not None else noise_level(problem, before, comparison)
    least = max(LEAST_LOSS_SCALE, FEWEST_ROUNDINGS * float(jnp.finfo(problem.observation.target.dtype).eps))
    scatter = max(MAD_TO_SIGMA * float(before.typical), sigma or 0.0, least)
    return dataclasses.replace(comparison, noise=noise, loss_scale=LOSSES[comparison.loss].tuning * scatter)
