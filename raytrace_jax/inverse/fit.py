"""The fit: from a target picture to the values of a scene's free parameters, coarse to fine."""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Array, Float

from ..errors import ParameterError
from ..parameters import scalar_names
from ..render import render
from ..scene import Scene
from ..settings import MAX_SAMPLES, RenderSettings
from .levels import COARSE_TOLERANCE, FINE_TOLERANCE, Progress, solve_level
from .problem import Measure, Problem, check_target
from .residual import Linearization
from .result import FitResult, FitStep, Status
from .uncertainty import covariance, is_explained

DEFAULT_BLUR = (6.0, 3.0, 1.5, 0.0)
"""Standard deviations of the pyramid's levels, in pixels."""

CAUCHY_SCALE = 2.385 * 1.4826
"""Scale of the Cauchy loss over the median magnitude of Gaussian residuals, for an efficiency of 95 %."""

LARGE_PICTURE = 100_000
"""From this many pixels on, blurred levels are worth a compile of their own at half the size."""

MAX_STAGES = 10
"""How often the scale of the loss is lowered on a point-sampled target, at most."""

Sampling = Literal["auto", "box", "point"]


class Recorder:
    """Keeps the history, tells the caller of each step, and watches the clock."""

    def __init__(self, problem: Problem, on_step: Callable[[FitStep], None] | None, max_seconds: float | None):
        self.problem, self.on_step, self.max_seconds = problem, on_step, max_seconds
        self.started = time.monotonic()
        self.history: list[FitStep] = []

    def level(self, level: int, sigma: float, first_step: int = 0):
        """The callback for one level."""

        def record(step: int, cost: float, accepted: bool, y: Float[Array, " parameters"]) -> None:
            seconds = time.monotonic() - self.started
            values = self.problem.values(y)
            self.history.append(FitStep(level, sigma, first_step + step, cost, accepted, values, seconds))
            if self.on_step is not None:
                self.on_step(self.history[-1])
            if self.max_seconds is not None and seconds > self.max_seconds:
                raise TimeoutError

        return record


def fit(
    scene: Scene,
    target: Array | np.ndarray,
    free: Sequence[str],
    settings: RenderSettings | None = None,
    *,
    edges: Literal["aware", "point"] = "aware",
    target_sampling: Sampling = "auto",
    blur: Sequence[float] = DEFAULT_BLUR,
    max_steps: int = 60,
    max_seconds: float | None = None,
    on_step: Callable[[FitStep], None] | None = None,
) -> FitResult:
    """Find the values of free parameters with which a scene's picture equals a target, by least squares.

    Levenberg-Marquardt on a pyramid of Gaussian blurs, each level starting where the last one ended. The picture is
    edge-aware, so that residual and derivative see silhouettes and refracted edges move. The last level is unblurred
    and compares with the target's own kind of picture. If that is point-sampled, as this program's own pictures are by
    default, the loss is robust: the few pixels at which an edge jumps are outliers to it.
    Ctrl-C ends the fit with what it has.

    Args:
        scene: the scene; its values are the start, its dtype the precision.
        target: scene-linear RGB, top row first, of the size that `settings` render.
        free: parameters to find, `vitreous.ior` or whole vectors, `vitreous.center`.
        settings: how the target was rendered; what it says of edges does not matter.
        edges: `point` fits with point-sampled pictures throughout, whose derivative misses edges.
        target_sampling: how the target's pixels were made: `box` is the mean over the pixel, as of a camera or a
            supersampling renderer, `point` one ray a pixel, `auto` whichever is nearer to it before the last level.
        blur: standard deviations in pixels of the levels, coarse to fine; 0 is appended if it is not the last.
        max_steps: steps of the solver on each level, at most.
        max_seconds: stop (`interrupted`) after this time.
        on_step: called after each step.

    Raises:
        ParameterError: unknown names, none at all, or one twice.
        PictureError: a target of another size, with NaN or infinity, or constant.
    """
    settings = RenderSettings() if settings is None else settings
    names = scalar_names(scene, free)
    if not names:
        raise ParameterError("there is nothing to fit: name at least one free parameter, such as sphere.center")
    sigmas = pyramid_levels(blur)
    problem = Problem(scene, check_target(target, scene, settings), names, settings)
    recorder = Recorder(problem, on_step, max_seconds)
    progress = Progress(problem.unknowns())
    measure, settled, reason = Measure(edges), None, None
    try:
        for level, sigma in enumerate(sigmas[:-1]):
            measure = Measure(edges, sigma, binning=coarse_binning(problem, edges, sigma))
            solve = functools.partial(problem.linearize, measure=measure)
            settled = solve_level(solve, progress, COARSE_TOLERANCE, max_steps, recorder.level(level, sigma))
        last, measure, settled = len(sigmas) - 1, Measure(edges), None
        if target_sampling == "auto":
            target_sampling = likelier_sampling(problem, progress.y)
        if target_sampling == "point":
            measure, settled = solve_point_sampled(problem, progress, recorder, last, max_steps)
        else:
            solve = functools.partial(problem.linearize, measure=measure)
            settled = solve_level(solve, progress, FINE_TOLERANCE, max_steps, recorder.level(last, 0.0))
    except KeyboardInterrupt:
        reason = "interrupted by the user"
    except TimeoutError:
        reason = f"stopped after {max_seconds:g} seconds"
    return conclude(problem, progress.y, measure, reason, settled is not None, tuple(recorder.history), max_steps)


def pyramid_levels(blur: Sequence[float]) -> list[float]:
    """The standard deviations of all levels; the last one is always unblurred."""
    sigmas = [float(sigma) for sigma in blur]
    return sigmas if sigmas and sigmas[-1] == 0 else [*sigmas, 0.0]


def coarse_binning(problem: Problem, edges: str, sigma: float) -> int:
    """How many pixels a blurred level may average to one: those of a large picture, where that is less than the blur.

    Edge-aware pixels stand for their whole area, however large. Of small pictures a step costs less than a compile.
    """
    large = problem.target[0].size >= LARGE_PICTURE
    return 2 if large and edges == "aware" and sigma >= 1 else 1


def likelier_sampling(problem: Problem, y: Float[Array, " parameters"]) -> Literal["box", "point"]:
    """How a target was sampled, judged near the answer: as the kind of picture that is nearer to it on average.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    scene, one = problem.scene_at(y), problem.settings(Measure("point"))
    four = dataclasses.replace(one, samples=min(2 * one.samples, MAX_SAMPLES))
    point, box = (np.mean(np.abs(np.asarray(render(scene, s).image) - np.asarray(problem.target))) for s in (one, four))
    return "box" if box < point else "point"


def solve_point_sampled(
    problem: Problem, progress: Progress, recorder: Recorder, level: int, max_steps: int
) -> tuple[Measure, Linearization | None]:
    """Finish on point-sampled pictures, with a Cauchy loss whose scale follows the typical residual down.

    A point-sampled picture is smooth in its parameters but at the pixels that an edge passes; there it jumps, which no
    derivative sees. Near the answer these are few and far off, and the loss lets the others decide.
    """
    measure = Measure("point")
    typical = float(problem.linearize(progress.y, measure).typical)
    settled, steps = None, 0
    for _ in range(MAX_STAGES):
        measure = Measure("point", 0.0, CAUCHY_SCALE * max(typical, 1e-12))
        solve = functools.partial(problem.linearize, measure=measure)
        record = recorder.level(level, 0.0, steps)
        settled = solve_level(solve, progress, FINE_TOLERANCE, max_steps, record)
        steps = recorder.history[-1].step + 1
        if settled is None or float(settled.typical) > 0.7 * typical:
            break
        typical = float(settled.typical)
    return measure, settled


def conclude(
    problem: Problem, y, measure: Measure, reason: str | None, settled: bool, history, max_steps: int
) -> FitResult:
    """Judge the end point and gather the result."""
    final = dataclasses.replace(measure, sigma=0.0, binning=1)
    error, correlation = covariance(problem.linearize(y, final), problem.transforms, y, problem.target.size)
    settings = problem.settings(final)
    image = np.asarray(render(problem.scene_at(y), settings).image)
    target = np.asarray(problem.target)
    residual = image - target

    status: Status = "not_converged"
    undetermined = [name for name, e in zip(problem.names, error, strict=True) if not np.isfinite(e)]
    if reason is not None:
        status, message = "interrupted", f"{reason}; the values are those of the last accepted step"
    elif undetermined:
        message = f"the picture does not determine {', '.join(undetermined)}; fix it or free fewer parameters"
    elif not settled:
        message = f"the solver was still moving after {max_steps} steps on a level; allow more steps"
    elif not is_explained(residual):
        message = "the solver came to rest, but the residual shows structure; start nearer, or free what differs"
    else:
        status, message = "converged", "the solver came to rest and the picture is explained"
    return FitResult(
        status=status,
        message=message,
        names=problem.names,
        value=problem.values(y),
        initial=problem.initial,
        standard_error=error,
        correlation=correlation,
        rms_residual=float(np.sqrt(np.mean(residual**2))),
        scene=problem.scene_at(y),
        settings=settings,
        target=target,
        start_image=np.asarray(render(problem.scene, settings).image),
        image=image,
        history=history,
    )
