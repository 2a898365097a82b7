"""The fit: from a target picture to the values of a scene's free parameters, and how far they can be trusted."""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from raytrace_jax.errors import ParameterError
from raytrace_jax.images.quantization import stored_intervals
from raytrace_jax.inverse.judge.uncertainty import Certainty, certainty
from raytrace_jax.inverse.judge.verdict import explains, verdict
from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.losses import LOSSES
from raytrace_jax.inverse.problem.observation import Priors, make_prior, observe
from raytrace_jax.inverse.problem.problem import Measure, Problem, rms_residual
from raytrace_jax.inverse.problem.unknowns import make_unknowns, spelled
from raytrace_jax.inverse.result import FitResult, FitStep, Profile
from raytrace_jax.inverse.solve.last_level import Finished, Sampling
from raytrace_jax.inverse.solve.profile import profile
from raytrace_jax.inverse.solve.recorder import Journal, Recorder
from raytrace_jax.inverse.solve.refine import refine
from raytrace_jax.inverse.solve.search import Solved, choose_levels, find_minima
from raytrace_jax.inverse.solve.set_membership import feasible
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.settings import RenderSettings


def fit(
    scene: Scene,
    target: ArrayLike,
    free: Sequence[str],
    settings: RenderSettings | None = None,
    *,
    search: bool = True,
    ties: Mapping[str, str] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    fit_exposure: bool = False,
    weights: ArrayLike | None = None,
    sigma: float | None = None,
    loss: LossName | Literal["auto"] = "auto",
    edges: Literal["aware", "point"] = "aware",
    target_sampling: Sampling = "auto",
    blur: Sequence[float] | None = None,
    profiles: Sequence[str] = (),
    max_steps: int = 60,
    max_seconds: float | None = None,
    on_step: Callable[[FitStep], None] | None = None,
    on_phase: Callable[[str], None] | None = None,
    journal: Journal | None = None,
) -> FitResult:
    """Find the values of free parameters with which a scene's picture equals a target, and how sure they are.

    A scan of small pictures over the indices and positions that are free finds places to start from. The best are
    solved by Levenberg-Marquardt on a pyramid of blurred, small, edge-aware pictures, so that residual and derivative
    see silhouettes and refracted edges move; the best of these is refined on the unblurred picture, sampled as the
    target is. What the others led to is kept. Ctrl-C ends the fit with what it has.

    Args:
        scene: the scene; its values are the first start, its dtype the precision.
        target: scene-linear RGB, top row first, of the size that `settings` render; NaN where the weight is 0.
        free: parameters to find, `vitreous.ior` or whole vectors, `vitreous.center`.
        settings: how the target was rendered; what it says of edges does not matter.
        search: whether to look for starts; if not, the scene's values are trusted to be near.
        ties: leader by follower: the follower always has the leader's value.
        priors: mean and standard deviation of Gaussian priors, by name of a free number.
        fit_exposure: whether the target is `exposure` times the picture plus `offset`, both free.
        weights: weight of each pixel in the sum of squares, 0 to leave it out; "height width".
        sigma: standard deviation of the noise in a channel of a pixel of weight 1; estimated if it is not given.
        loss: `l2`, `huber`, `cauchy`; `auto` is `cauchy` on point-sampled targets, else `l2`; and where such a target
            was stored in 8 or 16 bits without other noise, and there are no priors, the estimate is the mean of all
            values that give the stored numbers.
        edges: `point` fits with point-sampled pictures throughout, whose derivative misses edges.
        target_sampling: how the target's pixels were made: `box` is the mean over the pixel, as of a camera or a
            supersampling renderer, `point` one ray a pixel, `auto` whichever is nearer to it before the last level.
        blur: standard deviations of the blurred levels in the target's pixels, coarse to fine; chosen if not given.
        profiles: free numbers whose profile likelihood is drawn.
        max_steps: steps of the solver on the last level, at most.
        max_seconds: stop (`interrupted`) after this time.
        on_step: called after each step of the solver.
        on_phase: called with a few words on what happens now.
        journal: finished stages; with that of an interrupted fit of the same arguments the fit goes on where it was.

    Raises:
        ParameterError: unknown names, none at all, or one twice; a tie, prior or profile of what is not free.
        PictureError: a target of another size, with NaN or infinity, or constant; weights that make no sense.
    """
    settings = RenderSettings() if settings is None else settings
    unknowns = make_unknowns(scene, free, ties, exposure=fit_exposure, model=settings.model)
    observation = observe(target, weights, scene, settings)
    known = {spelled(scene, unknowns.names, name, "prior"): prior for name, prior in (priors or {}).items()}
    profiled = [spelled(scene, unknowns.names, name, "profile") for name in profiles]
    problem = Problem(scene, observation, unknowns, make_prior(known, unknowns, scene.camera.viewpoint.dtype), settings)
    check_options(sigma, loss)
    levels = choose_levels(problem, None if blur is None else tuple(blur))
    recorder = Recorder(problem, {} if journal is None else journal, on_step, on_phase, max_seconds)

    stopped, solved, finished, drawn, exact = None, [], None, (), None
    try:
        solved = find_minima(problem, levels, edges, search, recorder)
        solved, finished = refine(problem, solved, levels, edges, target_sampling, loss, sigma, max_steps, recorder)
        drawn = tuple(draw_profile(finished, name, sigma, max_steps, recorder) for name in profiled)
        if loss == "auto" and sigma is None and not known:
            exact = by_quantization(finished, recorder)
    except KeyboardInterrupt:
        stopped = "interrupted by the user"
    except TimeoutError:
        stopped = f"stopped after {max_seconds:g} seconds"
    if finished is None:
        y = recorder.answer if recorder.answer is not None else problem.start()
        finished = unfinished(problem, y, Measure(edges))
    return conclude(problem, finished, exact, solved, drawn, stopped, sigma, known, max_steps, recorder)


def check_options(sigma: float | None, loss: str) -> None:
    """Refuse a noise that makes no sense, and a loss that there is not."""
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0):
        raise ParameterError(f"sigma is {sigma:g}; wanted a finite standard deviation above 0.")
    if loss not in (*LOSSES, "auto"):
        raise ParameterError(f"there is no loss {loss!r}; there are {', '.join(LOSSES)} and auto.")


def unfinished(problem: Problem, y: Float[Array, " parameters"], measure: Measure) -> Finished:
    """The problem where a fit was stopped."""
    y = problem.array(y)
    return Finished(problem, y, measure, problem.linearize(y, measure), False)


def draw_profile(finished: Finished, name: str, sigma: float | None, max_steps: int, recorder: Recorder) -> Profile:
    """The profile likelihood of one parameter at the estimate."""
    recorder.phase(f"profile of {name}")
    sure = certainty(finished.problem, finished.found, finished.y, finished.measure, sigma)
    return profile(finished, name, sure, max_steps, recorder)


def by_quantization(finished: Finished, recorder: Recorder) -> tuple[Finished, Certainty] | None:
    """The estimate from what the target's stored numbers say for certain, if only storing has changed the picture."""
    if not finished.settled or finished.measure.edges != "point" or not explains(finished.problem, finished.found):
        return None
    intervals = stored_intervals(np.asarray(finished.problem.observation.target))
    if intervals is None:
        return None
    recorder.phase("looking for all values that give the stored numbers")
    sure = certainty(finished.problem, finished.found, finished.y, finished.measure, None)
    return feasible(finished, sure, intervals)


def conclude(
    problem: Problem,
    finished: Finished,
    exact: tuple[Finished, Certainty] | None,
    solved: list[Solved],
    profiles: tuple[Profile, ...],
    stopped: str | None,
    sigma: float | None,
    priors: Priors,
    max_steps: int,
    recorder: Recorder,
) -> FitResult:
    """Judge the end point and gather the result."""
    measure = finished.measure
    finished, sure = exact or (finished, certainty(finished.problem, finished.found, finished.y, measure, sigma))
    y, found = finished.y, finished.found
    target = np.asarray(problem.observation.target)
    image = target + np.asarray(found.image - finished.problem.observation.target)
    runner_ups = tuple(place.minimum for place in solved[1:])
    status, message, advice = verdict(
        stopped=stopped,
        settled=finished.settled,
        explained=explains(finished.problem, found),
        certainty=sure,
        runner_ups=runner_ups,
        max_steps=max_steps,
    )
    return FitResult(
        status=status,
        message=message,
        advice=advice,
        names=problem.unknowns.names,
        value=problem.values(y),
        initial=problem.unknowns.initial(problem.scene),
        standard_error=sure.standard_error,
        correlation=sure.correlation,
        cramer_rao=sure.cramer_rao,
        sigma=sure.sigma,
        sigma_given=sigma is not None,
        reduced_chi_square=sure.reduced_chi_square,
        condition_number=sure.condition_number,
        weakest=sure.weakest,
        rms_residual=rms_residual(finished.problem, found),
        loss="quantization" if exact else measure.loss,
        candidate=solved[0].minimum.candidate if solved else 0,
        runner_ups=runner_ups,
        profiles=profiles,
        priors=tuple((name, *prior) for name, prior in priors.items()),
        ties=problem.unknowns.ties,
        scene=problem.scene_at(y),
        settings=problem.settings(measure.edges),
        target=target,
        start_image=np.asarray(problem.linearize(problem.start(), measure).image),
        image=image,
        weights=np.asarray(problem.observation.root_weight) ** 2,
        history=tuple(recorder.history),
    )
