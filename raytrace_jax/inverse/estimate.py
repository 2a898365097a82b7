"""The fit: from a target picture to the values of a scene's free parameters, and how far they can be trusted."""

import copy
import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from ..errors import RaytraceWarning
from ..images.jpeg import JpegStorage
from ..images.masks import mask_in_words
from ..scene.scene import Scene, check_scene
from ..tracer.settings import RenderSettings, resolve_settings
from ..util.background import Clock, run_beside
from ..util.checked import refuse_other
from .build_problem import FitSetup, OfViews, build_problem
from .judge.model_check import check_model, expected_error
from .judge.still import compare_still
from .judge.uncertainty import quantify_uncertainty
from .judge.views import each_alone
from .options import FitOptions
from .problem.sampling import COARSE_SAMPLES, supersampled
from .progress import Progress
from .result import FitResult, FitStep
from .solve.candidates import unseen_balls
from .solve.refine import find_profile, select_solution
from .solve.search import binning_to, choose_levels, find_minima
from .status import make_result


def fit(
    scene: Scene,
    target: OfViews[ArrayLike],
    free: Sequence[str],
    settings: OfViews[RenderSettings | None] = None,
    *,
    options: FitOptions = FitOptions(),
    weights: OfViews[ArrayLike | None] = None,
    storage: OfViews[JpegStorage | None] = None,
    shown: Mapping[str, Scene] = MappingProxyType({}),
    on_step: Callable[[FitStep], None] | None = None,
    on_phase: Callable[[str], None] | None = None,
) -> FitResult:
    """Find the values of free parameters with which a scene's picture equals a target, and how sure they are.

    A scan of small pictures over the indices and positions that are free finds places to start from. The best are
    solved by Levenberg-Marquardt on a pyramid of blurred, small, edge-aware pictures, so that residual and derivative
    include the motion of silhouettes and refracted edges. The best of these is refined on the unblurred picture, which
    is sampled like the target. The other solutions are kept as runner-ups.

    Ctrl-C, or the end of `max_seconds`, ends the fit within two seconds and returns what it has found so far. For this
    the fit runs in a thread of its own. A thread that is compiling at that moment is left behind.

    A scene of several cameras is fitted to a picture of each: `fit(scene, {"left": one, "right": other}, ...)`. The
    scene's numbers are common to them, those of a camera and its film are its own unless they are tied. Each view has
    its own noise and samples, and counts by its noise.

    Args:
        scene: the scene; its values are the first start, its dtype the precision.
        target: scene-linear RGB, top row first, of the size that `settings` render. NaN may stand where the weight is
            0; a pixel that `numpy.ma` masks, here or in the weights, has the weight 0.
        target, settings, weights, storage: of several cameras a mapping by their names; settings, weights and storage
            may be common to them.
        settings: how the target was rendered; its `edges` is not used. None takes the settings in the scene's file.
        options: how the fit is set up and solved, as `FitOptions(search=False, sigma=0.01)`.
        weights: weight of each pixel in the sum of squares, 0 to leave it out, "height width"; or of each channel of
            each pixel, "3 height width".
        shown: by a camera's name the scene that it sees, of fewer blocks than the whole and the same names: as one turn
            of a table, of whose other turns the scene has copies elsewhere.
        storage: how a JPEG has compressed the target (`jpeg_storage`): its bias is taken off.
        on_step, on_phase: called with each step of the solver, and with what the fit does next, in words.

    Returns:
        The estimates by name, `result["glass.ior"]`, with error bars, `status` and the fitted scene; an interrupted fit
        returns what it has.

    Raises:
        ParameterError: unknown names, none at all, or one twice; a tie, prior or profile of what is not free; options
            that make no sense.
        PictureError: a target of another size, with NaN or infinity, or constant; weights that make no sense; what no
            free number changes is elsewhere in the target.
    """
    refuse_other(options, FitOptions)
    check_scene(scene)
    each: dict[str, Any] = dict.fromkeys(scene.cameras)
    if isinstance(settings, Mapping) and any(isinstance(one, RenderSettings) for one in settings.values()):
        each |= settings
    else:
        each = dict.fromkeys(each, settings)
    resolved = {name: resolve_settings(scene, one) for name, one in each.items()}
    setup = build_problem(scene, target, free, resolved, options, weights, storage, shown)
    setup = setup._replace(problem=setup.problem.in_own_unit())
    if options.sigma is not None:
        options = dataclasses.replace(options, sigma=options.sigma / setup.problem.unit)
    # The fit runs beside this thread, so that Ctrl-C and the clock can end it at any time.
    clock = Clock(options.max_seconds, lambda: on_phase("stopping ...") if on_phase else None)
    progress = Progress(setup.problem, on_step, on_phase, clock)
    stopped = None
    try:
        run_beside(lambda: find(setup, options, progress), clock)
    except KeyboardInterrupt:
        stopped = "interrupted by the user"
    except TimeoutError:
        stopped = f"stopped after {options.max_seconds:g} seconds"
    return make_result(setup, options, copy.copy(progress.findings), stopped)


def find(setup: FitSetup, options: FitOptions, progress: Progress) -> None:
    """Run all phases of a fit; its findings are those of `progress`."""
    # The answer: minima of small pictures, and the best of them on the whole picture.
    problem, findings = setup.problem, progress.findings
    progress.phase("comparing what nothing free changes")
    displaced = "".join(compare_still(view, options.edges, binning_to(view, 5_000)) for view in problem.views)
    levels, stated = choose_levels(problem, options), (setup.uncertain, options.correlations, progress.clock.check)
    minima = find_minima(problem, levels, options, progress)
    findings.minima = tuple(minima)
    minima, solution = select_solution(
        problem, minima, len(levels), options, progress, lambda state: expected_error(state, *stated)
    )
    findings.minima, findings.solution = tuple(minima), solution

    # What is wrong with it: pixels that are not finite, and balls that the target does not show.
    for view in solution.views:
        bad = np.asarray(view.linearization.bad) & view.problem.observation.counts
        if bad.any():
            words = f"{mask_in_words(bad)}, in the fitted picture or a derivative. They do not count."
            warnings.warn(words, RaytraceWarning, stacklevel=2)
    findings.unseen = unseen_balls(solution)
    uncertainty = quantify_uncertainty(solution, options.sigma)
    opened = [name for names in findings.unseen.values() for name in names]
    findings.uncertainty = uncertainty = uncertainty.opened(problem.unknowns.names, opened)

    # The picture at the start is sampled as that of the solution, to be compared with it.
    progress.phase("rendering the start")
    coarse = None if solution.stage.edges == "point" else COARSE_SAMPLES
    views, start = problem.views, problem.start()
    findings.start_images = tuple(supersampled(view, start, coarse or view.base.samples) for view in views)
    if not uncertainty.is_known:
        return
    findings.alone = each_alone(solution, options.sigma) if problem.others else ()

    # What follows counts in standard errors: profiles, and whether the model is right.
    for place in setup.profiled:
        progress.phase(f"profile of {problem.unknowns.names[place]}")
        profile = find_profile(solution, place, uncertainty, options.max_steps, progress)
        findings.profiles = (*findings.profiles, profile)
    progress.phase("checking the model")
    try:
        check = check_model(solution, uncertainty.standard_error, *stated)
        findings.check = dataclasses.replace(check, displaced=displaced)
    except np.linalg.LinAlgError as reason:  # LAPACK cannot factorise a matrix: the fit has its answer all the same.
        warnings.warn(f"the model could not be checked: {reason}.", RaytraceWarning, stacklevel=2)
