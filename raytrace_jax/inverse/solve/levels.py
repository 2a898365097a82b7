"""Coarse to fine: small pictures, blurred less and less, so that a solve finds its way from far."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from raytrace_jax.images.filters import blurred
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.solve.least_squares import Tolerance, levenberg_marquardt
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.util.numerics import TINY

COARSE_PIXELS = 20_000
"""About how many pixels the small pictures have: 160 x 120, a step of which takes a sixteenth of one at 640 x 480."""

COARSE_BLUR = (8.0, 4.0, 2.0)
"""Standard deviations of the levels, in pixels of the small picture; the largest is a twentieth of its width.
Half of them and double, and none at all, lead three of three starts to the truth too; none in up to two fifths more
steps (experiments/tuning)."""

LEAST_SIGNAL = 0.3
"""A level is too coarse if its blur leaves less than this share of the residual that a solve starts from. With 0.15
and 0.6 a search takes a third to nine tenths more steps at times (experiments/tuning)."""

MOST_STEPS = 25
"""On each level: one that needs more is not on its way to the answer. 12 and 50 do the same (experiments/tuning)."""

COARSE = Tolerance(relative=1e-3, decrease=1e-2, rejected=2)
"""Of a level whose answer is only the next one's start: a tenth of an error bar, the root of 1e-2. A
tenth and ten times of it change the steps by a tenth (experiments/tuning)."""

COMPARED = Tolerance(relative=1e-4, decrease=1e-4, rejected=2)
"""Of the last of these, on which minima are compared. Ten times more or less hardly matters (experiments/tuning)."""

SAME_MINIMUM = 0.03
"""Minima of small pictures nearer to each other than this, in natural scales of the parameters, are one. Half
and double do the same (experiments/tuning)."""

Values = Float[np.ndarray, " parameters"]


@dataclasses.dataclass(frozen=True)
class Levels:
    """The levels of a coarse-to-fine solve.

    Args:
        binning: size of the small pictures' pixels in those of the target.
        blurs: standard deviations of the levels on small pictures, coarse to fine, in pixels of the target; the last
            is 0.
    """

    binning: int
    blurs: tuple[float, ...]


def choose_levels(problem: Problem, blurs: Sequence[float] | None) -> Levels:
    """The levels on small pictures: those asked for, or those that suit the target's size."""
    binning = binning_to(problem, COARSE_PIXELS)
    if blurs is None:
        return Levels(binning, (*(binning * blur for blur in COARSE_BLUR), 0.0))
    blurs = tuple(blur for blur in blurs if blur > 0)
    # Edge-aware pixels stand for their whole area: they may be as large as the blur.
    return Levels(max(1, min(binning, int(min(blurs, default=0)))), (*blurs, 0.0))


def binning_to(problem: Problem, pixels: int) -> int:
    """The binning that leaves about so many pixels."""
    return max(1, round(float(np.sqrt(problem.observation.root_weight.size / pixels))))


def descend(
    problem: Problem,
    start: Values,
    levels: Levels,
    edges: EdgeMode,
    candidate: int,
    recorder: Recorder,
    known: Sequence[Values] = (),
) -> Values:
    """The unknowns at which the levels end, from one start; those too coarse for it are left out.

    A solve that comes to a minimum that is `known` needs no finer levels.
    """
    y = problem.array(problem.unknowns.unknowns(start))
    small = Comparison(edges, binning=levels.binning)
    linearization = problem.linearize(y, small)
    for level, blur in enumerate(levels.blurs):
        if blur > 0 and signal_left(problem, linearization, blur, levels.binning) < LEAST_SIGNAL:
            continue
        noise = problem.rms_residual(linearization, levels.binning)
        comparison = dataclasses.replace(small, blur=blur, noise=noise)
        record = recorder.level(candidate, level, blur, leads=candidate == 0)
        tolerance = COARSE if blur > 0 else COMPARED
        state = levenberg_marquardt(problem, y, comparison, tolerance, MOST_STEPS, record)
        y, linearization = state.y, state.linearization
        here = problem.values(y)
        if any(problem.scaled_distance(here, place) < SAME_MINIMUM for place in known):
            break
    return np.asarray(y)


def signal_left(problem: Problem, linearization: Linearization, blur: float, binning: int) -> float:
    """The share of a residual that a blur leaves.

    A blur beyond half the period of what differs leaves nothing of it, and a solve would follow what happens to
    remain. Where only edges are a little off, as near the answer, little is left too, and no blur is needed.
    """
    residual = problem.residual_of(linearization, binning)
    left = blurred(residual, blur / binning)
    return float(np.linalg.norm(left)) / max(float(np.linalg.norm(residual)), TINY)
