"""The search: a scan of small pictures for places, the best of them solved coarse to fine, and what they led to."""

import dataclasses
import math
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...errors import PictureError, RaytraceWarning
from ...images.filters import blurred
from ...scene.response import RESPONSE_EFFECTS
from ...scene.scene import map_scenes
from ...util.numerics import TINY, finite_or_last, on_host
from ..options import FitOptions, Stage
from ..problem.observation import Observation
from ..problem.prediction import best_response
from ..problem.problem import FitState, Problem
from ..problem.unknowns import Values, Vector
from ..progress import LocalMinimum, Progress
from .candidates import groups, table
from .solvers import LevenbergMarquardt, levenberg_marquardt

Rows = Float[np.ndarray, "pictures parameters"]
"""Values of the parameters, a row for each of some pictures."""

Pictures = Float[np.ndarray, "pictures 3 height width"]

LEAST_SIGNAL = 0.3
"""A level is too coarse if its blur leaves less than this fraction of the residual that a solve starts from. With 0.15
and 0.6 a search takes a third to nine tenths more steps at times (experiments/tuning)."""

LEAST_SOLVES = 2
"""Places that are solved even if the first explains the picture, lest a second answer is missed. One takes half the
steps, four three times as many (experiments/tuning)."""


SCAN_BLUR, AT_ONCE = 1.0, 50
"""Blur of a scan's pictures in their pixels, since they are sampled at points; and the number of pictures between which
the user can interrupt it."""


def choose_levels(problem: Problem, options: FitOptions) -> tuple[Stage, ...]:
    """The levels on small pictures that are asked for, or suit the target's size, coarse to fine.

    There are no levels where one start is to be solved without blur: the whole picture's own solve does that.
    """
    # About 160 x 120, a step of which takes a sixteenth of one at 640 x 480.
    binning = binning_to(problem, 20_000)
    # From a twentieth of the width on. Half and double, and none at all, lead to the truth too, none in more steps.
    blurs = [binning * blur for blur in (8.0, 4.0, 2.0)]
    if options.blur is not None:
        blurs = [blur for blur in options.blur if blur > 0]
        if not (blurs or options.search or options.known_sampling == "auto"):
            return ()
        # Edge-aware pixels stand for their whole area, so that they may be as large as the blur.
        binning = max(1, min(binning, int(min(blurs, default=0))))
    # Under a blur pixels of twice the size show as much, in a quarter of the time.
    blurred = [Stage(options.edges, blur, max(1, min(2 * binning, int(blur)))) for blur in blurs]
    return *blurred, Stage(options.edges, binning=binning)


def binning_to(problem: Problem, pixels: int, at_least: bool = False) -> int:
    """The binning that leaves about this many pixels, or at least so many."""
    binning = math.sqrt(math.prod(problem.observation.target.shape[1:]) / pixels) / problem.zoom
    return max(1, math.floor(binning + 1e-6) if at_least else round(binning))


def descend(
    problem: Problem,
    start: Values,
    levels: Sequence[Stage],
    candidate: int,
    progress: Progress,
    known: Sequence[LocalMinimum] = (),
) -> FitState | None:
    """The end of the levels from one start; levels that are too coarse for the start are left out.

    A solve that comes to a minimum that is already `known` is given up: None. So is one that is far worse on a blurred
    level than a minimum that explains the picture.
    """
    state = FitState.at(problem, problem.y_of(start), dataclasses.replace(levels[0], blur=0.0))
    for number, stage in enumerate(levels):
        blur = stage.blur
        # Leave out a level whose blur takes away what is still off from here.
        if blur > 0 and signal_left(state, blur) < LEAST_SIGNAL:
            continue
        stage = dataclasses.replace(stage, noise=state.rms_residual)
        # The next level's start need not be as near as the end, by which minima are compared. A solve that needs more
        # than 25 steps is not on its way to the answer.
        relative, decrease = (1e-3, 1e-2) if blur > 0 else (1e-4, 1e-4)
        method = LevenbergMarquardt(25, relative, decrease, rejected=2)
        record = progress.of_level(candidate, number, blur, leads=candidate == 0)
        held = held_under(problem, state.y, blur)
        state = levenberg_marquardt(problem, state.y, stage, record, method, held)
        if any(is_same(problem, problem.values(state.y), minimum.summary.value) for minimum in known):
            return None
        rival = known[0] if blur > 0 and known and known[0].summary.explained else None
        # A residual ten times as large.
        if rival is not None and state.joint.cost > 100.0 * FitState.at(problem, rival.y, stage).joint.cost:
            return None
    return state


def is_same(problem: Problem, one: Values, other: Values) -> bool:
    """Whether two minima are one: in natural scales of the parameters. Half and double do the same."""
    return problem.distance(one, other) < 0.03


def held_under(problem: Problem, y: Vector, blur: float) -> list[int]:
    """The places of the film's unknowns that a blurred level holds, for a sharp picture tells them better.

    What the scene lacks, such as a shade on a board, is large where all that is fine is blurred. It would drive gain,
    offset, and a blur that is less than the level's anywhere, and with them what is sought.
    """
    values, squared = problem.values(y), {effect.name for effect in RESPONSE_EFFECTS if effect.is_squared}
    held = []
    for view in problem.views if blur > 0 else ():
        effects, names = view.camera.free_effects, enumerate(view.local.names)
        held += [k for k, name in names if effects.get(name) in squared and values[k] < blur * view.zoom]
        held += view.camera.linear_indices
    return held


def signal_left(state: FitState, blur: float) -> float:
    """The fraction of a residual that a blur leaves.

    A blur beyond half the period of what differs leaves nothing of it, and a solve would follow what happens to
    remain. Near the answer, where only edges are a little off, little is left too, and no blur is needed.
    """
    left = [
        np.linalg.norm(blurred(view.residual, blur * view.problem.zoom / view.stage.binning)) for view in state.views
    ]
    return float(np.linalg.norm(left) / max(np.linalg.norm([np.linalg.norm(r) for r in state.residuals]), TINY))


def evaluate(
    problem: Problem, values: Rows, binning: int, tell: Callable[[int], None]
) -> tuple[Float[np.ndarray, " pictures"], Rows]:
    """The distances from the target of pictures of some rows of values, and the rows with the best film of each.

    The measure is the root mean square of the blurred, weighted difference; infinite where a picture is not finite. The
    numbers of the film in which the picture is linear, such as its gain, take their best values.
    """
    costs, films = [], np.array(values, np.float64)
    for chunk in np.array_split(np.arange(len(values)), -(-len(values) // AT_ONCE)):
        squares = []
        for view in problem.views:
            films[chunk], images, observation = view_pictures(view, films[chunk], view.zoomed_binning(binning))
            target, root = np.asarray(observation.target), np.asarray(observation.root_weight)
            squares.append(np.mean(blurred((images - target) * root, SCAN_BLUR) ** 2, axis=(1, 2, 3)))
            tell(len(chunk))
        costs += [finite_or_last(float(cost)) for cost in np.sqrt(np.mean(squares, axis=0))]
    return np.array(costs), films


def view_pictures(problem: Problem, rows: Rows, binning: int) -> tuple[Rows, Pictures, Observation]:
    """A view's pictures of rows of values, those rows with the best film of each, and what it is compared with."""
    observation, points = problem.binned(binning), problem.points(*problem.places(binning), binning)
    # As many each time: another number of them is another program.
    scenes = problem.scenes_with(np.resize(rows, (AT_ONCE, rows.shape[1])))
    kept = map_scenes(lambda x: np.asarray(x)[: len(rows)], scenes)
    images = problem.model.points(kept, points, problem.base).reshape(-1, *observation.target.shape)
    if problem.camera.is_needed:
        rows, images = best_films(problem, rows, images, binning)
    return rows, images, observation


def best_films(
    problem: Problem,
    rows: Rows,
    light: Pictures,
    binning: int,
) -> tuple[Rows, Pictures]:
    """Rows of values whose linear numbers of the film are best for the target, and the pictures that they make."""
    developed = best_response(
        problem.array(np.resize(rows, (AT_ONCE, *rows.shape[1:]))),
        problem.array(np.resize(light, (AT_ONCE, *light.shape[1:]))),
        problem.camera.of_scene,
        problem.binned(binning),
        problem.array(SCAN_BLUR),
        problem.local,
        problem.frame(binning),
        problem.camera.linear_indices,
    )
    best, images = (on_host(x)[: len(rows)] for x in developed)
    return best, images


def scan(problem: Problem, tell: Callable[[int], None]) -> list[Values]:
    """The places from which a solve is worth while, best first.

    Spheres are searched one after the other, with those before at the best place found. Two grids are tried for each:
    all indices at positions near the start, and a few indices at positions anywhere in the picture. A place is worth
    while if it is the best of its neighbours on such a grid. Pictures of few pixels tell that; those that are left are
    compared by larger ones.
    """
    # 40 x 30, and 80 x 60, in which a ball still has an outline. In 32 x 24 of 64 x 48 6 of 40 fits found no answer.
    first, binning = binning_to(problem, 1_200, at_least=True), binning_to(problem, 5_000)
    (cost,), (initial,) = evaluate(problem, problem.initial[None], binning, tell)
    seeds = [(float(cost), initial)]
    for grids in groups(problem):
        best = seeds[0][1]
        for grid in grids:
            rows = table(best, grid)
            costs, _ = evaluate(problem, rows, first, tell)
            shape = [size for choice in grid for size in choice.values.shape[:-1]]
            lowest = ndimage.minimum_filter(costs.reshape(shape), size=3, mode="nearest").reshape(-1)
            rows = rows[(costs <= lowest) & (lowest < np.inf)]
            if len(rows):
                costs, rows = evaluate(problem, rows, binning, tell)
                seeds += [(float(c), row) for c, row in zip(costs, rows, strict=True) if c < np.inf]
        seeds.sort(key=lambda seed: seed[0])
    # The start has no neighbours on a grid to be compared with: it stays only if it is the best of all.
    return [row for k, (_, row) in enumerate(seeds) if k == 0 or row is not initial]


def find_minima(
    problem: Problem,
    levels: Sequence[Stage],
    options: FitOptions,
    progress: Progress,
) -> list[LocalMinimum]:
    """Minima on the small pictures, best first.

    Those of several views are sought from where a solve of one view alone ended, of each view until one of them leads
    to what explains all: a grid that finds a ball in one picture is too coarse for two, which tell its depth apart.
    A start that leads to a picture which is not finite is left out, with a warning.

    Raises:
        PictureError: no start leads to a picture that is finite.
    """
    levels, minima = levels or [Stage(options.edges)], list[LocalMinimum]()
    if not options.search or not problem.others:
        starts = find_starts(problem, options.search, progress)
        minima = solved_minima(problem, starts, LEAST_SOLVES, levels, progress)
    else:
        for view in problem.views:
            ends = [end.summary for end in find_minima(view, levels, options, progress)]
            starts = [end.value for end in ends if end.explained] or [ends[0].value]
            minima = solved_minima(problem, starts, len(starts), levels, progress, minima)
            if any(minimum.summary.explained for minimum in minima):
                break
    if not minima:
        raise PictureError(
            "the fit has nowhere to begin: the picture of every start, or a derivative of it, is not finite. Look at "
            "the scene's numbers, or start elsewhere."
        )
    return [minimum.judged_against(minima[0].residual) for minimum in minima]


def solved_minima(
    problem: Problem,
    starts: Sequence[Values],
    least: int,
    levels: Sequence[Stage],
    progress: Progress,
    minima: Sequence[LocalMinimum] = (),
) -> list[LocalMinimum]:
    """The minima to which some starts lead, and other ones, best first.

    Args:
        least: how many solves are made although one has led to what explains the target.
    """
    minima, tried = list(minima), list[np.ndarray]()
    for start in starts:
        # Take the next start that is not like one before, unless there is answer enough.
        enough = len(tried) >= least and any(minimum.summary.explained for minimum in minima)
        if enough or len(tried) == 5:
            break
        if any(problem.distance(start, other) < 0.1 for other in tried):
            continue
        candidate = 1 + max((step.candidate for step in progress.findings.steps), default=-1)
        progress.phase(f"solving from start {candidate + 1}")
        end = descend(problem, start, levels, candidate, progress, minima)
        tried.append(start)
        if end is None:
            continue
        if not end.joint.is_finite:
            place = ", ".join(f"{name} {value:.6g}" for name, value in zip(problem.unknowns.names, start, strict=True))
            words = f"start {candidate + 1} ({place}) is left out: its picture, or a derivative of it, is not finite."
            warnings.warn(words, RaytraceWarning, stacklevel=2)
            continue
        # Put its minimum among the others; the best so far is the answer if the fit is stopped.
        minima = with_minimum(problem, minima, LocalMinimum.of(end, candidate, len(levels) - 1))
        progress.findings.answer = minima[0].y
    return minima


def find_starts(problem: Problem, scanned: bool, progress: Progress) -> list[Values]:
    """The places to solve from, most promising first."""
    if not scanned:
        start = problem.initial[None]
        # With the best film, as the places of a scan have.
        if any(view.camera.linear_indices for view in problem.views):
            _, start = evaluate(problem, start, binning_to(problem, 5_000), lambda pictures: None)
        return [*start]
    pictures = [0]

    def tell(further: int) -> None:
        pictures.append(pictures[-1] + further)
        progress.phase(f"scanning, {pictures[-1]} pictures")

    progress.phase("scanning: compiling")
    return scan(problem, tell)


def with_minimum(problem: Problem, minima: list[LocalMinimum], new: LocalMinimum) -> list[LocalMinimum]:
    """The minima and a new one, best first; only the best is kept of minima that are one."""

    def size(minimum: LocalMinimum) -> float:
        return minimum.summary.rms_residual

    same = [each for each in minima if is_same(problem, new.summary.value, each.summary.value)]
    others = [each for each in minima if all(each is not other for other in same)]
    return sorted([*others, min([*same, new], key=size)], key=size)
