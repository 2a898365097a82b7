"""The last level: the unblurred picture, sampled as the target is, under the loss that was asked for."""

import dataclasses
from collections.abc import Callable
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.uncertainty import MAD_TO_SIGMA, noise_level
from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.losses import LOSSES
from raytrace_jax.inverse.problem.problem import Measure, Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.solve.correction import correct, supersampled
from raytrace_jax.inverse.solve.least_squares import FINE, Progress, Tolerance, solve_level
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.tracer.settings import MAX_SAMPLES

Sampling = Literal["auto", "box", "point"]

MAX_STAGES = 10
"""How often the scale of a loss, and of the noise, follows the residuals down, at most."""

SETTLED_SHARE = 0.7
"""A stage that leaves more than this of the typical residual is the last one."""

LEAST_SCALE = 1e-12
"""The scale of a loss when the picture fits exactly; in float32 ten roundings."""


@dataclasses.dataclass(frozen=True)
class Rest:
    """When Gauss-Newton steps end.

    Args:
        rounds: steps at most.
        move: a step shorter than so many standard errors is not taken.
        reach: nor one shorter than this in natural scales of the parameters, for targets without noise.
    """

    rounds: int
    move: float
    reach: float


CORRECTIONS = Rest(5, 0.1, 3e-6)
"""Of steps on a supersampled picture, whose samples limit what they can tell."""

REWEIGHTINGS = Rest(20, 0.01, 1e-13)
"""Of steps on a point-sampled picture."""

FARTHEST = 0.1
"""A step longer than this in natural scales leaves the neighbourhood of the minimum and is not taken either."""

UNCORRECTED = Tolerance(1e-6, 1e-4, 1)
"""Of a solve that corrections follow."""


@dataclasses.dataclass(frozen=True)
class Finished:
    """Where the last level ended.

    Args:
        problem: what was solved: the problem given, its target corrected for the error of the edge-aware picture.
        y: the unknowns.
        measure: how picture and target were compared.
        found: the problem there.
        settled: whether the solver came to rest.
    """

    problem: Problem
    y: Float[Array, " parameters"]
    measure: Measure
    found: Linearization
    settled: bool


@dataclasses.dataclass(frozen=True)
class LastLevel:
    """How the last level is to be solved.

    Args:
        edges: how the picture is sampled, `point` or `aware`.
        loss: name of the loss.
        sigma: standard deviation of the noise, if it is known.
        max_steps: steps of each solve at most.
        level: its number in the history.
    """

    edges: str
    loss: LossName
    sigma: float | None
    max_steps: int
    level: int


def likelier_sampling(problem: Problem, y: Float[Array, " parameters"]) -> Literal["box", "point"]:
    """How a target was sampled, judged near the answer: as the kind of picture that is nearer to it on average.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples = problem.base.samples

    def distance(samples: int) -> float:
        residual = (supersampled(problem, y, samples) - problem.observation.target) * problem.observation.root_weight
        return float(np.mean(np.abs(np.asarray(residual))))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"


def finish(
    problem: Problem, y: Float[Array, " parameters"], how: LastLevel, candidate: int, recorder: Recorder
) -> Finished:
    """Solve the last level from the unknowns `y`.

    A point-sampled picture is smooth in its parameters but at the pixels that an edge passes; there it jumps, which no
    derivative sees. So least squares on such a picture begin with the Cauchy loss, to which these few are outliers. One
    jump changes that loss by as much as six standard errors do, and a solver that asks it to fall is held up by every
    pixel on its way: so it ends with steps that do not ask (iteratively reweighted least squares).

    An edge-aware picture is nearly that of a box-filtered target, and its derivative nearly that picture's. Where it
    errs is looked up in a supersampled picture at the estimate and added to the target, until that moves nothing: the
    answer is then that of the supersampled picture, which has no derivative of its own.

    Args:
        problem: what is fitted.
        y: where to start.
        how: how to solve it.
        candidate: number of the start, for the history.
        recorder: is told of everything.
    """
    name = f"last level of candidate {candidate}"

    def follow(end: Finished, renew: Callable[[Finished], Problem], until: Rest) -> Finished:
        return follow_steps(end, renew, until, candidate, how.level, recorder)

    def look_up(end: Finished) -> Problem:
        recorder.phase("comparing with a supersampled picture")
        return correct(problem, end.y, end.measure)

    if how.edges == "aware":
        end = solve_stages(problem, y, how, candidate, recorder, f"{name}, {how.loss}", UNCORRECTED)
        return follow(end, look_up, CORRECTIONS)
    robust: LossName = "cauchy" if how.loss == "l2" else how.loss
    end = solve_stages(
        problem, y, dataclasses.replace(how, loss=robust), candidate, recorder, f"{name}, {robust}", FINE
    )
    end = follow(end, lambda end: problem, REWEIGHTINGS)
    return end if robust == how.loss else solve_stages(problem, end.y, how, candidate, recorder, f"{name}, l2", FINE)


def follow_steps(
    end: Finished,
    renew: Callable[[Finished], Problem],
    until: Rest,
    candidate: int,
    level: int,
    recorder: Recorder,
) -> Finished:
    """Gauss-Newton steps that do not ask whether the cost falls, until they move nothing.

    Args:
        end: where to start.
        renew: the problem to solve at an end.
        until: when to stop.
        candidate, level: numbers for the history.
        recorder: is told of everything.
    """
    scale, last_move = end.problem.scale(), np.inf
    record = recorder.level(candidate, level, 0.0, recorder.steps_at(candidate, level))
    for round_ in range(until.rounds):
        problem = renew(end)
        found = problem.linearize(end.y, end.measure)
        record(round_, 0.5 * float((found.residual**2).sum()), True, end.y)
        move = move_in_errors(found)
        y = problem.array(end.y + gauss_newton_step(found))
        reach = np.max(np.abs(problem.values(y) - problem.values(end.y)) / scale)
        end = dataclasses.replace(end, problem=problem, found=found)
        # Steps that do not get shorter follow the samples of a picture and not the scene.
        aimless = move > last_move and round_ >= until.rounds // 2
        if move < until.move or reach < until.reach or reach > FARTHEST or aimless:
            break
        last_move = move
        if round_ < until.rounds - 1:
            end = dataclasses.replace(end, y=y)
    return end


def gauss_newton_step(found: Linearization) -> Float[np.ndarray, " parameters"]:
    """The step to the minimum of the linear model; none along what the picture does not determine."""
    triangle, residual = np.asarray(found.jacobian, np.float64), np.asarray(found.residual, np.float64)
    return -np.linalg.lstsq(triangle, residual, rcond=1e-9)[0]


def move_in_errors(found: Linearization) -> float:
    """How far the next step would go, in standard errors: the largest of any direction."""
    residual = np.asarray(found.residual, np.float64)
    freedom = max(3 * int(np.sum(found.matters)) - len(residual) + 1, 1)
    return float(np.max(np.abs(residual[:-1])) / max(np.sqrt(np.sum(residual**2) / freedom), 1e-300))


def solve_stages(
    problem: Problem,
    y: Float[Array, " parameters"],
    how: LastLevel,
    candidate: int,
    recorder: Recorder,
    name: str,
    tolerance: Tolerance,
) -> Finished:
    """Solve from `y`, once, or in stages.

    The scale of a robust loss follows the typical residual down, stage by stage: near the answer few residuals are
    large, and the loss lets the others decide. So does the noise beside which priors count, where it is not known.
    """
    progress, rule, sigma = Progress(problem.array(y)), LOSSES[how.loss], how.sigma
    has_prior = bool(np.any(np.asarray(problem.prior.precision) > 0))
    in_stages = how.loss != "l2" or (has_prior and sigma is None)
    found = problem.linearize(progress.y, Measure(how.edges, loss=how.loss, loss_scale=1.0)) if in_stages else None
    end = None
    for stage in range(MAX_STAGES):
        measure = Measure(how.edges, loss=how.loss, noise=sigma or 0.0)
        if found is not None:
            noise = sigma if sigma is not None else noise_level(problem, found, measure)
            least = max(LEAST_SCALE, 10 * float(jnp.finfo(progress.y.dtype).eps))
            scatter = max(MAD_TO_SIGMA * float(found.typical), sigma or 0.0, least)
            measure = dataclasses.replace(measure, noise=noise, loss_scale=rule.tuning * scatter)
        solved = None

        def solve(measure=measure, stage=stage):
            nonlocal solved
            steps = recorder.steps_at(candidate, how.level)
            record = recorder.level(candidate, how.level, 0.0, steps)
            solved = solve_level(lambda y: problem.linearize(y, measure), progress, tolerance, how.max_steps, record)
            return {"y": np.asarray(progress.y).tolist(), "settled": solved is not None}

        outcome = recorder.stage(f"{name}, stage {stage}", solve)
        progress.y = problem.array(outcome["y"])
        after = solved if solved is not None else problem.linearize(progress.y, measure)
        end = Finished(problem, progress.y, measure, after, outcome["settled"])
        if found is None or not end.settled or float(after.typical) > SETTLED_SHARE * float(found.typical):
            break
        found = after
    assert end is not None
    return end
