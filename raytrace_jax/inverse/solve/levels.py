"""Coarse to fine: small pictures, blurred less and less, so that a solve finds its way from far."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from raytrace_jax.images.filters import blurred
from raytrace_jax.inverse.findings import LocalMinimum
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.least_squares import Tolerance, levenberg_marquardt
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.util.numerics import TINY


@dataclasses.dataclass(frozen=True)
class LevelPlan:
    """How coarse the levels are, and when one ends.

    Args:
        pixels: about how many pixels the small pictures have: 160 x 120, a step of which takes a sixteenth of one at
            640 x 480.
        blurs: standard deviations of the levels, in pixels of the small picture; the largest is a twentieth of its
            width. Half of them and double, and none at all, lead three of three starts to the truth too; none in up to
            two fifths more steps (experiments/tuning).
        least_signal: a level is too coarse if its blur leaves less than this share of the residual that a solve starts
            from. With 0.15 and 0.6 a search takes a third to nine tenths more steps at times (experiments/tuning).
        most_steps: steps on each level: a solve that needs more is not on its way to the answer. 12 and 50 do the same
            (experiments/tuning).
        same_minimum: minima of small pictures nearer to each other than this, in natural scales of the parameters, are
            one. Half and double do the same (experiments/tuning).
        far_worse: a blurred level that ends with more than so many times the cost of a minimum that explains the
            picture leads to no rival: its residual is ten times as large.
    """

    pixels: int = 20_000
    blurs: tuple[float, ...] = (8.0, 4.0, 2.0)
    least_signal: float = 0.3
    most_steps: int = 25
    same_minimum: float = 0.03
    far_worse: float = 100.0


LEVEL_PLAN = LevelPlan()


COARSE = Tolerance(relative=1e-3, decrease=1e-2, rejected=2)
"""The tolerance of a level whose answer is only the next one's start: a tenth of an error bar, the root of 1e-2. A
tenth and ten times of it change the steps by a tenth (experiments/tuning)."""

COMPARED = Tolerance(relative=1e-4, decrease=1e-4, rejected=2)
"""The tolerance of the last level on small pictures, where minima are compared. Ten times more or less hardly matters
(experiments/tuning)."""


Values = Float[np.ndarray, " parameters"]


@dataclasses.dataclass(frozen=True)
class Levels:
    """The levels of a coarse-to-fine solve.

    Args:
        binning: size of the small pictures' pixels in those of the target: those by which minima are compared.
        blurs: standard deviations of the levels on small pictures, coarse to fine, in pixels of the target; the last
            is 0.
    """

    binning: int
    blurs: tuple[float, ...]

    def binning_at(self, blur: float) -> int:
        """The binning of a level. Under a blur pixels of twice the size show as much, in a quarter of the time."""
        return max(1, min(2 * self.binning, int(blur))) if blur > 0 else self.binning


def choose_levels(problem: Problem, blurs: Sequence[float] | None) -> Levels:
    """The levels on small pictures: those asked for, or those that suit the target's size."""
    binning = binning_to(problem, LEVEL_PLAN.pixels)
    if blurs is None:
        return Levels(binning, (*(binning * blur for blur in LEVEL_PLAN.blurs), 0.0))
    blurs = tuple(blur for blur in blurs if blur > 0)
    # Edge-aware pixels stand for their whole area, so that they may be as large as the blur.
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
    known: Sequence[LocalMinimum] = (),
) -> FitState | None:
    """Where the levels end, from one start; levels that are too coarse for the start are left out.

    A solve that comes to a minimum that is already `known` is given up: None. So is one that is far worse on a blurred
    level than a minimum that explains the picture.
    """
    y = problem.array(problem.unknowns.unknowns(start))
    state = FitState.at(problem, y, Comparison(edges, binning=levels.binning_at(max(levels.blurs))))
    for level, blur in enumerate(levels.blurs):
        # Leave out a level whose blur takes away what is still off from here.
        if blur > 0 and signal_left(state, blur) < LEVEL_PLAN.least_signal:
            continue
        comparison = Comparison(edges, blur, levels.binning_at(blur), noise=state.rms_residual)
        record = recorder.level(candidate, level, blur, leads=candidate == 0)
        tolerance = COARSE if blur > 0 else COMPARED
        state = levenberg_marquardt(problem, state.y, comparison, tolerance, LEVEL_PLAN.most_steps, record)
        here = problem.values(state.y)
        if any(problem.scaled_distance(here, minimum.summary.value) < LEVEL_PLAN.same_minimum for minimum in known):
            return None
        if blur > 0 and known and known[0].summary.explained:
            best = problem.linearize(known[0].y, comparison)
            if state.linearization.cost > LEVEL_PLAN.far_worse * best.cost:
                return None
    return state


def signal_left(state: FitState, blur: float) -> float:
    """The share of a residual that a blur leaves.

    A blur beyond half the period of what differs leaves nothing of it, and a solve would follow what happens to
    remain. Near the answer, where only edges are a little off, little is left too, and no blur is needed.
    """
    residual = state.residual
    left = blurred(residual, blur / state.comparison.binning)
    return float(np.linalg.norm(left)) / max(float(np.linalg.norm(residual)), TINY)
