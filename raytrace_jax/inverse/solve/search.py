"""The search: places from a scan of small pictures, the best of them solved coarse to fine, and what they led to."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.verdict import evidence, explains
from raytrace_jax.inverse.problem.blur import blur
from raytrace_jax.inverse.problem.problem import Measure, Problem, rms_residual, weighted_residual
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.result import Minimum
from raytrace_jax.inverse.solve.least_squares import COARSE, COMPARED, Progress, solve_level
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.scan import scan

Values = Float[np.ndarray, " parameters"]

COARSE_PIXELS = 20_000
"""About how many pixels the small pictures of the levels have."""

SCAN_PIXELS = 5_000
"""The same for the scan."""

COARSE_BLUR = (8.0, 4.0, 2.0)
"""Standard deviations of the levels, in pixels of the small picture."""

SIGNAL = 0.3
"""A level is too coarse if its blur leaves less than this share of the residual that a solve starts from."""

LEAST_SOLVES, MOST_SOLVES = 2, 5
"""How many places are solved: until the picture is explained, but never only one."""

MOST_COARSE_STEPS = 25

SAME_START, SAME_MINIMUM = 0.1, 0.03
"""Places nearer to each other than this, in natural scales of the parameters, are one."""


@dataclasses.dataclass(frozen=True)
class Levels:
    """The levels of a pyramid.

    Args:
        binning: size of the small pictures' pixels in those of the target.
        sigmas: standard deviations of the levels on small pictures, coarse to fine, in pixels of the target; the last
            is 0.
    """

    binning: int
    sigmas: tuple[float, ...]


def choose_levels(problem: Problem, blur_sigmas: tuple[float, ...] | None) -> Levels:
    """The levels on small pictures: those asked for, or those that suit the target's size."""
    binning = binning_to(problem, COARSE_PIXELS)
    if blur_sigmas is None:
        return Levels(binning, (*(binning * sigma for sigma in COARSE_BLUR), 0.0))
    sigmas = tuple(sigma for sigma in blur_sigmas if sigma > 0)
    # Edge-aware pixels stand for their whole area: they may be as large as the blur.
    return Levels(max(1, min(binning, int(min(sigmas, default=0)))), (*sigmas, 0.0))


def binning_to(problem: Problem, pixels: int) -> int:
    """The binning that leaves about so many pixels."""
    return max(1, round(float(np.sqrt(problem.observation.root_weight.size / pixels))))


@dataclasses.dataclass(frozen=True)
class Solved:
    """A minimum with all that is known of it.

    Args:
        minimum: for the report.
        y: its unknowns.
        residual: its weighted residual.
    """

    minimum: Minimum
    y: Float[Array, " parameters"]
    residual: Float[np.ndarray, "3 height width"]


def find_minima(problem: Problem, levels: Levels, edges: str, scanned: bool, recorder: Recorder) -> list[Solved]:
    """Minima on the small pictures, best first.

    Args:
        problem: what is fitted.
        levels: the pyramid.
        edges: how pictures are sampled.
        scanned: whether to look for starts; if not, the scene's values are the only one.
        recorder: is told of everything.
    """
    starts = recorder.stage("scan", lambda: find_starts(problem, scanned, recorder))
    scale = problem.scale()
    solved: list[Solved] = []
    tried: list[np.ndarray] = []
    for start in map(np.asarray, starts):
        enough = len(tried) >= LEAST_SOLVES and any(place.minimum.explained for place in solved)
        if enough or len(tried) >= MOST_SOLVES:
            break
        if any(apart(start, place, scale) < SAME_START for place in tried):
            continue
        number = len(tried)
        recorder.phase(f"solving from start {number + 1}")

        known = [place.minimum.value for place in solved]

        def solve(start=start, number=number, known=known):
            return descend(problem, start, levels, edges, number, recorder, known).tolist()

        y = problem.array(recorder.stage(f"candidate {number}", solve))
        tried.append(start)
        place = assess(problem, y, Measure(edges, 0.0, levels.binning), number, len(levels.sigmas) - 1)
        near = [o for o in solved if apart(place.minimum.value, o.minimum.value, scale) < SAME_MINIMUM]
        best = min([*near, place], key=lambda one: one.minimum.rms_residual)
        solved = sorted(
            [*(other for other in solved if all(other is not one for one in near)), best],
            key=lambda place: place.minimum.rms_residual,
        )
        recorder.answer = solved[0].y
    return compared(solved)


def find_starts(problem: Problem, scanned: bool, recorder: Recorder) -> list[list[float]]:
    """The places to solve from, most promising first."""
    if not scanned:
        return [problem.unknowns.initial(problem.scene).tolist()]
    done = 0

    def tell(pictures: int) -> None:
        nonlocal done
        done += pictures
        recorder.phase(f"scanning, {done} pictures")

    recorder.phase("scanning: compiling")
    return [values.tolist() for _, values in scan(problem, binning_to(problem, SCAN_PIXELS), tell)]


def descend(
    problem: Problem,
    start: Float[np.ndarray, " parameters"],
    levels: Levels,
    edges: str,
    number: int,
    recorder: Recorder,
    known: Sequence[Float[np.ndarray, " parameters"]] = (),
) -> Float[np.ndarray, " parameters"]:
    """The unknowns at which the levels end, from one start; those too coarse for it are left out.

    A solve that comes to a minimum that is `known` needs no finer levels.
    """
    scale = problem.scale()
    progress = Progress(problem.array(problem.unknowns.unknowns(start)))
    coarse = Measure(edges, 0.0, levels.binning)
    found = problem.linearize(progress.y, coarse)
    for level, sigma in enumerate(levels.sigmas):
        if sigma > 0 and signal_left(problem, found, sigma, levels.binning) < SIGNAL:
            continue
        measure = dataclasses.replace(coarse, sigma=sigma, noise=rms_residual(problem, found, levels.binning))
        record = recorder.level(number, level, sigma, leads=number == 0)
        settled = solve_level(
            lambda y, measure=measure: problem.linearize(y, measure),
            progress,
            COARSE if sigma > 0 else COMPARED,
            MOST_COARSE_STEPS,
            record,
        )
        found = settled or problem.linearize(progress.y, measure)
        here = problem.values(progress.y)
        if any(apart(here, place, scale) < SAME_MINIMUM for place in known):
            break
    return np.asarray(progress.y)


def signal_left(problem: Problem, found: Linearization, sigma: float, binning: int) -> float:
    """The share of a residual that a blur leaves.

    A blur beyond half the period of what differs leaves nothing of it, and a solve would follow what happens to
    remain. Where only edges are a little off, as near the answer, little is left too, and no blur is needed.
    """
    residual = weighted_residual(problem, found, binning)
    left = blur(residual, jnp.asarray(sigma / binning, residual.dtype))
    return float(jnp.linalg.norm(left)) / max(float(jnp.linalg.norm(residual)), 1e-300)


def assess(problem: Problem, y: Float[Array, " parameters"], measure: Measure, number: int, level: int) -> Solved:
    """What there is to say of the place that a solve led to."""
    found, binning = problem.linearize(y, measure), measure.binning
    size, explained = rms_residual(problem, found, binning), explains(problem, found, binning)
    minimum = Minimum(number, problem.values(y), size, level, explained, 0.0)
    return Solved(minimum, y, np.asarray(weighted_residual(problem, found, binning)))


def apart(one: Values, other: Values, scale: Values) -> float:
    """The largest difference of any parameter, in natural scales."""
    return float(np.max(np.abs(one - other) / scale))


def compared(solved: list[Solved]) -> list[Solved]:
    """The same, each with the evidence that the first is better."""
    best = solved[0]

    def judged(place: Solved) -> Solved:
        found = evidence(best.residual, place.residual)
        return dataclasses.replace(place, minimum=dataclasses.replace(place.minimum, evidence=found))

    return [best, *map(judged, solved[1:])]
