"""From a minimum of the small pictures to the answer, on the picture sampled as the target is; and its profiles."""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...util.numerics import MAD_TO_SIGMA, TINY, finite_or_last
from ..judge.structure import EVIDENCE, explains
from ..judge.uncertainty import LARGEST_ERROR, Uncertainty, noise_level
from ..options import FitOptions, Stage
from ..problem.detect import detect_samples, detect_sampling
from ..problem.linearize import LOSSES
from ..problem.problem import FitState, Problem
from ..problem.sampling import COARSE_SAMPLES, ResampledPicture, lattice_size, point_sampled, resampled
from ..problem.unknowns import Images, Values, Vector
from ..progress import LocalMinimum, Progress, Record
from ..result import PROFILE_95, Profile
from .solvers import GaussNewton, LevenbergMarquardt, levenberg_marquardt, minimise


def select_solution(
    problem: Problem,
    minima: list[LocalMinimum],
    level: int,
    options: FitOptions,
    progress: Progress,
    error_of: Callable[[FitState], Values] | None = None,
) -> tuple[list[LocalMinimum], FitState]:
    """Solve the best minimum to the end, and those that the small pictures do not tell from it.

    Args:
        error_of: about the standard errors that the unknowns will have: what is far below them is not computed.

    Returns:
        All minima, best first, with their values and evidence where they were solved to the end; and the best one.
    """
    if options.known_sampling == "auto":
        progress.phase("telling how the target was sampled")
        found = {detect_sampling(view, minima[0].y) for view in problem.views}
        options = dataclasses.replace(options, target_sampling="point" if found == {"point"} else "box")
    progress.phase("solving on the whole picture")
    # Small pictures are a coarse model: a runner-up is out only where twice the usual evidence is against it.
    rivals = [m for m in minima[1:] if m.summary.explained and m.summary.evidence < 2 * EVIDENCE][:2]
    solutions: list[FitState] = []
    for minimum in (minima[0], *rivals):
        record = progress.of_level(minimum.summary.candidate, level)
        solutions.append(refine(problem, minimum.y, options, progress, record, error_of))
        progress.findings.solution = solutions[0]

    # The best is now the one with the least loss. Losses compare at one scale only.
    loss_scale = max(solution.stage.loss_scale for solution in solutions)
    ends: list[tuple[LocalMinimum, FitState]] = []
    for minimum, solution in zip((minima[0], *rivals), solutions, strict=True):
        end = LocalMinimum.of(solution, minimum.summary.candidate, level)
        residual = tuple(view.under_loss("residual", loss_scale) for view in solution.views)
        ends.append((end._replace(residual=residual), solution))
    ends.sort(key=lambda end: finite_or_last(sum(float(np.sum(part**2)) for part in end[0].residual)))
    best, winner = ends[0]
    # Starts that came together on the whole picture are one minimum, as far as solves stop apart.
    distinct = [end for end, _ in ends[1:] if problem.distance(end.summary.value, best.summary.value) > 1e-3]
    untouched = [minimum for minimum in minima[1:] if all(minimum is not rival for rival in rivals)]
    return [end.judged_against(best.residual) for end in (best, *distinct)] + untouched, winner


def refine(
    problem: Problem,
    y: Vector,
    options: FitOptions,
    progress: Progress,
    record: Record,
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
    is_weighed = bool(problem.others) and options.sigma is None

    def solve(y: Vector, stage: Stage, method: LevenbergMarquardt) -> FitState:
        return solve_robustly(problem, y, stage, options.sigma, record, method)

    if stage.edges == "point":
        problem = problem.of_views([dataclasses.replace(view, samples=view.base.samples) for view in problem.views])
        # To about an error bar, since the steps that follow do not ask whether the cost falls. The few point samples
        # that an edge has passed are outliers.
        near = LevenbergMarquardt(steps, relative=1e-6, decrease=1e-6, rejected=1)
        solution = solve(y, dataclasses.replace(stage, loss="cauchy"), near)
        if is_weighed:
            solution = balanced(solution)
            problem = solution.problem
        solution = minimise(GaussNewton(), solution, lambda y: FitState.at(problem, y, solution.stage), record)
        return solution if stage.loss != "l2" else solve(solution.y, stage, LevenbergMarquardt(steps))

    # Corrections, and what is not explained, move the answer by more than a hundredth of an error bar.
    solution = solve(y, stage, LevenbergMarquardt(steps, relative=1e-6, decrease=1e-4, rejected=1))
    if is_weighed:
        solution = balanced(solution)
        problem = solution.problem
    samples, coarse = ["aware" if options.known_sampling == "aware" else view.samples for view in problem.views], []
    if None in samples:
        progress.phase("telling the target's samples")
        coarse = [point_sampled(view, solution.y, COARSE_SAMPLES) for view in problem.views]
        parts = zip(solution.views, samples, coarse, strict=True)
        samples = [detect_samples(view, pair[1]) if known is None else known for view, known, pair in parts]
    if samples != ["aware"] * len(samples):
        # Beside samples that are known areas are those of a view whose samples are edge-aware ones.
        known = [None if each == "aware" else each for each in samples]
        views = [dataclasses.replace(view, samples=n) for view, n in zip(problem.views, known, strict=True)]
        return settle(problem.of_views(views), solution, progress, record, coarse, error_of and error_of(solution))
    return solve(solution.y, stage, LevenbergMarquardt(steps)) if explains(solution) else solution


def balanced(solution: FitState) -> FitState:
    """The state whose views count by their noise: residuals of each have the size of the first one's."""
    # Of a view that shows nothing of what is free it is that of all its residuals.
    each = [(view, np.any(np.asarray(view.linearization.matters))) for view in solution.views]
    noises, views = [noise_level(view) if matters else view.rms_residual for view, matters in each], []
    for view, noise in zip(solution.views, noises, strict=True):
        # A view without noise counts a thousand times as much as another, not infinitely.
        factor = float(np.clip((noises[0] + 1e-12) / (noise + 1e-12), 1e-3, 1e3))
        observation = view.problem.observation.weighted(np.full(view.problem.observation.counts.shape, factor**2))
        problem = dataclasses.replace(view.problem, observation=observation, unit=view.problem.unit / factor)
        views.append(FitState.at(problem, view.y, view.stage))
    return solution.of_views(views, settled=solution.settled)


def settle(
    problem: Problem,
    solution: FitState,
    progress: Progress,
    record: Record,
    coarse: Sequence[Images] = (),
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
        coarse: `COARSE_SAMPLES` samples a pixel and side at the solution, of each view, if they are known.
        error: about the standard errors that the unknowns will have: samples that would move them by far less are not
            traced, and so short steps are not taken.
    """
    # The typical residual's: pixels at edges are off by what is to be found here.
    noises = [0.0 if error is None else MAD_TO_SIGMA * float(v.linearization.typical) for v in solution.views]
    stage, y, sizes, left = solution.stage, solution.y, [lattice_size()] * len(noises), 4
    whose = "a supersampled picture" if problem.samples is None else "a picture of the target's own samples"
    # Again with more samples, or with another derivative and list of pixels, which hold up to a tenth of a pixel of a
    # large ball. What is not explained will not be explained by them.
    while True:
        progress.phase(f"comparing with {whose}")
        begun = time.monotonic()
        known = coarse or [None] * len(noises)
        views = zip(problem.views, sizes, known, noises, strict=True)
        pictures = [resampled(view, y, stage, size, pair, noise) for view, size, pair, noise in views]
        # Each step samples as much again; most targets take two or three.
        if (seconds := 3 * (time.monotonic() - begun)) > 10:
            progress.phase(f"comparing with {whose}: about {seconds:.0f} s")

        near = functools.partial(state_on, pictures, stage)
        lowest = minimise(GaussNewton(error=error), near(y), near, record)
        ends = zip(pictures, lowest.views, sizes, strict=True)
        needed = [max(size, picture.needed_size(view, error)) for picture, view, size in ends]
        moved, coarse, left = problem.distance(problem.values(lowest.y), problem.values(y)), (), left - 1
        if (moved < 1e-3 and needed == sizes) or left == 0 or not explains(lowest):
            break
        y, sizes = lowest.y, needed
    views = [with_aware_picture(*pair) for pair in zip(lowest.views, pictures, strict=True)]
    is_finite = all(view.linearization.is_finite for view in views)
    return lowest.of_views(views, settled=lowest.settled and is_finite)


def state_on(pictures: Sequence[ResampledPicture], stage: Stage, y: Vector) -> FitState:
    """The state at unknowns near which each view is resampled."""
    states = [picture.state(y, stage) for picture in pictures]
    return states[0].of_views(states)


def with_aware_picture(view: FitState, picture: ResampledPicture) -> FitState:
    """A view at the end of steps on a resampled picture: with the edge-aware picture there, and its bias."""
    problem = view.problem
    bias = np.asarray(view.linearization.image) - np.asarray(problem.picture(view.y, view.stage.edges).image)
    observed = dataclasses.replace(problem, observation=problem.observation.with_bias(bias))
    return dataclasses.replace(
        view,
        problem=observed,
        linearization=observed.linearize(view.y, view.stage),
        confusion=picture.confusion(),
        within=picture.weighted_variance if problem.samples is None else None,
    )


def solve_robustly(
    problem: Problem, y: Vector, stage: Stage, sigma: float | None, record: Record, method: LevenbergMarquardt
) -> FitState:
    """Solve from `y`, once, or several times with a scale of the loss and of the noise that follow the residual.

    The scale of a robust loss follows the typical residual down, solve by solve: near the answer few residuals are
    large, and the loss lets the others decide. If the noise is not known, but there are priors, it is estimated with
    each solve too: priors count beside it.
    """
    has_prior = np.any(np.asarray(problem.prior.precision) > 0)
    if stage.loss == "l2" and (sigma is not None or not has_prior):
        return levenberg_marquardt(problem, y, dataclasses.replace(stage, noise=sigma or 0.0), record, method)
    # Each solve needs the residual of the one before, and the first one that of the start.
    solution = FitState.at(problem, problem.array(y), dataclasses.replace(stage, loss_scale=1.0))
    # Where the picture fits exactly the scale is 1e-12 or ten roundings: 1e-15 to 1e-6 do the same.
    least = max(1e-12, 10 * float(jnp.finfo(problem.dtype).eps))
    # Go on while the typical residual falls by three tenths or more: ten solves take off a factor of 35.
    for _ in range(10):
        before = solution.typical
        noise = sigma if sigma is not None else max(map(noise_level, solution.views))
        scale = LOSSES[stage.loss].tuning * max(MAD_TO_SIGMA * before, sigma or 0.0, least)
        stage = dataclasses.replace(stage, noise=noise, loss_scale=scale)
        solution = levenberg_marquardt(problem, solution.y, stage, record, method)
        if not solution.settled or solution.typical > 0.7 * before:
            break
    return solution


def find_profile(
    solution: FitState, place: int, uncertainty: Uncertainty, max_steps: int, progress: Progress
) -> Profile:
    """Hold one parameter at values to both sides of its estimate and fit the others again at each.

    Each point starts from its neighbour, moved along the regression of the other parameters on the held one. The values
    reach to three standard errors on either side, beyond the 1.96 of a parabola's 95 % interval. The interval of a
    profile that curves up less closes too, down to (1.96 / 3)^2 = 0.43 of a parabola's curvature.
    """
    problem = solution.problem
    name, estimate = problem.unknowns.names[place], problem.values(solution.y)
    # The step of the held parameter, and how the others move with it.
    error = uncertainty.standard_error[place]
    if not np.isfinite(error):
        error = LARGEST_ERROR * float(problem.scale[place])
    errors = np.where(np.isfinite(uncertainty.standard_error), uncertainty.standard_error, 0)
    along = uncertainty.correlation[:, place] * errors / max(float(errors[place]), TINY)
    along[place] = 1.0
    # Chi-square is about the number of residuals, a million at 640 x 480 pixels, of which a decrease of 1e-10 is 1e-4.
    method = LevenbergMarquardt(max_steps, relative=1e-7, decrease=1e-10)

    # Go outwards on each side. Twice the rise of the cost, in units of the noise, is chi-square.
    points = {0.0: (estimate, 0.0)}
    for side in (-1, 1):
        values = estimate
        # Six points, half a standard error apart. A root of the profile that bends like x + c x^2, in standard errors,
        # is off by at most c/16 between two of them, where it is taken for straight.
        for step in side * 0.5 * np.arange(1, 7):
            progress.phase(f"profile of {name}, {step:+.2g} standard errors")
            guess = problem.y_of(values + along * (estimate[place] + step * error - values[place]))
            least = levenberg_marquardt(problem, guess, solution.stage, method=method, held=[place])
            values, rise = problem.values(least.y), least.joint.cost - solution.joint.cost
            points[float(step)] = values, 2 * rise / uncertainty.sigma**2
    # Put both sides together, from the lowest value to the highest.
    ordered = [points[step] for step in sorted(points)]
    value = np.array([values[place] for values, _ in ordered])
    chi_square = np.array([square for _, square in ordered])
    others = np.stack([values for values, _ in ordered], axis=1)
    return Profile(name, value, chi_square, others, interval(value, chi_square))


def interval(value: Float[np.ndarray, " points"], chi_square: Float[np.ndarray, " points"]) -> tuple[float, float]:
    """Values where a profile crosses the 95 % bound on both sides of its lowest point; infinite if it never does."""
    lowest = int(np.argmin(chi_square))

    def crossing(places) -> float:
        for inner, outer in itertools.pairwise(places):
            if chi_square[outer] >= PROFILE_95:
                # The root of chi-square runs nearly straight, so that it is interpolated linearly.
                low, high = np.sqrt(np.maximum(chi_square[[inner, outer]], 0))
                fraction = (np.sqrt(PROFILE_95) - low) / (high - low)
                return float(value[inner] + fraction * (value[outer] - value[inner]))
        return float("inf")

    left, right = crossing(range(lowest, -1, -1)), crossing(range(lowest, len(value)))
    return (-left if np.isinf(left) else left), right
