"""Steps on the picture of the target's own samples, to where the fewest of them lie on the wrong side of an edge."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.bounds import cut_short, held
from raytrace_jax.inverse.solve.gauss_newton import FARTHEST, REST, gauss_newton_step, move_in_errors
from raytrace_jax.inverse.solve.grid_picture import GridPicture, grid_picture
from raytrace_jax.inverse.solve.iterate import Step, iterate
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine_options import RefineOptions
from raytrace_jax.inverse.solve.sampling import Moments
from raytrace_jax.util.numerics import finite_or_last


class GridDescent(NamedTuple):
    """When steps on the picture of the target's own samples end.

    Args:
        most_steps: steps with one derivative. The first two or three take off most of what there is, but for
            combinations that few samples tell: a free field of view before a level board wants fifteen.
        worth: a step that lowers the cost by less than this share of the lowest so far is in vain. Of POV-Ray's
            checker, 640 x 480, the first three steps took off 0.97, 0.74 and 0.35 of it, and those after them less;
            with a free field of view, 160 x 120, ten in a row took off 0.1 to 0.3 each, and with 0.3 here the fit ended
            at the third, its index off by 2e-4 in place of 1e-5.
        in_vain: so many steps in vain, one after the other, end the descent: where few samples decide, steps go to and
            fro.
        to_and_fro: the solver is at rest where the next step is shorter than so many times the resolution: a few
            samples on the wrong side of edges make such steps. Of POV-Ray's checker, 640 x 480, steps went to and fro
            by about 2.5.
        short: a step shorter than so many standard errors is not taken.
        below_resolution: after a step in vain, a step shorter than this share of the resolution is not taken: the
            picture cannot tell where it leads from here.
        near: natural scales within which one derivative and one list of pixels serve: a tenth of a pixel of a large
            ball.
        most_lists: how often the pixels are listed; each list is made where the steps with the one before ended.
        lengths, most_rounds: lengths at which places around are tried, in those that tell them apart, and how often.
    """

    most_steps: int = 24
    worth: float = 0.1
    in_vain: int = 2
    to_and_fro: float = 5.0
    short: float = 0.1
    below_resolution: float = 0.3
    near: float = 1e-3
    most_lists: int = 3
    lengths: tuple[float, ...] = (-2.0, -0.5, 0.5, 2.0)
    most_rounds: int = 2


GRID_DESCENT = GridDescent()


def settle_on_grid(
    problem: Problem,
    solution: FitState,
    samples: int,
    options: RefineOptions,
    recorder: Recorder,
    coarse: Moments | None = None,
) -> FitState:
    """Take steps on the picture of the target's n x n samples; the edge-aware derivative leads.

    That picture has no derivative of use: it changes only where an edge crosses a sample, and then in a jump. But on
    average it changes as the area on one side of the edge does, whose derivative is the edge-aware one. So each step
    leads to where few samples are on the wrong side, and the next one ends nearer. A step samples the pixels at edges
    anew, which is cheap beside a derivative.

    Args:
        problem: what is fitted.
        solution: the solution of its edge-aware picture.
        samples: the n of n x n samples a pixel.
        options: numbers for the history.
        recorder: is told of everything.
        coarse: `COARSE_SAMPLES` samples a pixel and side at the solution, if they are known.
    """
    comparison = solution.comparison
    grid, lowest = follow(problem, solution, samples, options, recorder, coarse)
    if not lowest.settled:
        # Place what the derivative cannot lead, and hold it there while that leads the others.
        start = look_around(grid, lowest, comparison)
        grid = grid_picture(problem, start, comparison, samples)
        lowest = descend(grid, grid.problem, comparison, options, recorder)
    return settled(problem, solution, grid, lowest)


def follow(
    problem: Problem,
    solution: FitState,
    samples: int,
    options: RefineOptions,
    recorder: Recorder,
    coarse: Moments | None,
) -> tuple[GridPicture, FitState]:
    """The place where steps that the derivative leads end, with the list of pixels there."""
    comparison, start = solution.comparison, solution.y
    for number in range(1, GRID_DESCENT.most_lists + 1):
        recorder.phase("comparing with a picture of the target's own samples")
        grid = grid_picture(problem, start, comparison, samples, coarse)
        lowest = descend(grid, grid.leading, comparison, options, recorder)
        # Farther away another derivative holds, and edges may have left the listed pixels.
        moved = problem.scaled_distance(problem.values(lowest.y), problem.values(start))
        if number == GRID_DESCENT.most_lists or moved < GRID_DESCENT.near:
            return grid, lowest
        start, coarse = lowest.y, None
    raise AssertionError("the last list returns")


def settled(problem: Problem, solution: FitState, grid: GridPicture, lowest: FitState) -> FitState:
    """The solution at the lowest place, with the edge-aware picture there and its bias."""
    comparison = solution.comparison
    aware = problem.picture(lowest.y, comparison.edges)
    corrected = problem.with_bias(np.asarray(lowest.linearization.image) - np.asarray(aware.image))
    linearization = corrected.linearize(lowest.y, comparison)
    return dataclasses.replace(
        solution,
        problem=corrected,
        y=lowest.y,
        linearization=linearization,
        settled=lowest.settled and linearization.is_finite,
        next_move=lowest.next_move,
        target_samples=grid.samples,
        resolution=grid.resolution(),
    )


def descend(
    grid: GridPicture, problem: Problem, comparison: Comparison, options: RefineOptions, recorder: Recorder
) -> FitState:
    """Gauss-Newton steps with the derivative of the list's place.

    Args:
        grid: the picture of the target's own samples.
        problem: its weights lead: those of `grid.leading`, or all to hold what edges along the grid tell.
        comparison, options, recorder: as for `settle_on_grid`.

    Returns:
        The place of the lowest cost, at rest where the next step is about as long as the picture tells places apart.
    """
    resolution = grid.resolution()

    def at(y: Float[Array, " parameters"]) -> FitState:
        return FitState(problem, y, comparison, problem.linearize_picture(grid.at(y), y, comparison))

    def look(last: Step[int], y: Float[Array, " parameters"]) -> FitState:
        return last.best if y is last.best.y else at(y)

    def propose(last: Step[int], seen: FitState) -> Step[int]:
        # See whether the step before was worth it.
        lowest, y, linearization = last.best, seen.y, seen.linearization
        is_first = seen is lowest
        is_lowest = is_first or (linearization.is_finite and linearization.cost < lowest.linearization.cost)
        is_worth = is_first or linearization.cost < (1 - GRID_DESCENT.worth) * lowest.linearization.cost
        in_vain = 0 if is_worth else last.memory + 1
        # Choose the next step; its length decides whether this place is one of rest.
        free = held(linearization, y, problem.unknowns)
        step, move = gauss_newton_step(free), move_in_errors(free)
        to = problem.array(cut_short(problem, y, y + step))
        reach, beside = problem.scaled_distance(problem.values(to), problem.values(y)), in_deviations(step, resolution)
        if is_lowest:
            is_at_rest = reach < FARTHEST and (move < REST or beside < GRID_DESCENT.to_and_fro)
            lowest = dataclasses.replace(seen, settled=is_at_rest, next_move=move)
        # End where the next step would tell nothing more, or leaves the neighbourhood in which the derivative holds.
        is_short = move < GRID_DESCENT.short or (in_vain > 0 and beside < GRID_DESCENT.below_resolution)
        ends = in_vain == GRID_DESCENT.in_vain or is_short or not 0 < reach < FARTHEST
        return Step(lowest, is_lowest, None if ends else to, in_vain)

    start = at(problem.array(grid.y))
    begin = Step(start, True, start.y, 0)
    return iterate(begin, look, propose, GRID_DESCENT.most_steps, recorder.level(options.candidate, options.level))


def look_around(grid: GridPicture, lowest: FitState, comparison: Comparison) -> Float[Array, " parameters"]:
    """The best of places around one where steps with the derivative end above what is there.

    Lines of a board that are parallel to the rows change sides all at once: the derivative of areas leads nowhere. So
    places along the directions in which the picture tells places apart are tried by their costs alone, at several
    lengths, one direction after the other, twice at most (a pattern search, Hooke and Jeeves 1961).
    """
    problem = grid.problem

    def at(y: Float[np.ndarray, " parameters"]) -> FitState:
        place = problem.array(cut_short(problem, lowest.y, y))
        return FitState(problem, place, comparison, problem.linearize_picture(grid.at(place), place, comparison))

    best = at(np.asarray(lowest.y))
    for _ in range(GRID_DESCENT.most_rounds):
        before = best
        for direction in grid.apart.T:
            tried = [at(np.asarray(best.y) + share * direction) for share in GRID_DESCENT.lengths]
            best = min([best, *tried], key=lambda state: finite_or_last(state.linearization.cost))
        if best is before:
            break
    return best.y


def in_deviations(
    step: Float[np.ndarray, " parameters"], covariance: Float[np.ndarray, "parameters parameters"]
) -> float:
    """The longest part of a step, in standard deviations."""
    spread, length = np.sqrt(np.maximum(np.diagonal(covariance), 0)), np.abs(step)
    return float(np.max(np.divide(length, spread, out=np.full_like(length, np.inf), where=spread > 0)))
