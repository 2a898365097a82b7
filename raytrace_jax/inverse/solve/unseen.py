"""Balls that a picture does not show: their index is that of what is around them, and they may be anywhere."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.solve.candidates import is_material_of
from raytrace_jax.inverse.solve.sampling import supersampled
from raytrace_jax.inverse.statistics.goodness_of_fit import EVIDENCE, vuong_evidence
from raytrace_jax.inverse.statistics.uncertainty import Uncertainty
from raytrace_jax.scene.parameters import Address, Block, resolve


class FaintBalls(NamedTuple):
    """How a ball is found that a picture does not show.

    Args:
        faint: indices nearer to 1 than this are asked whether there is a ball at all: the deflection of light is then
            below a tenth of a radian, and what a search ends at where it finds nothing is nearer still.
        away: natural scales by which a ball is moved out of sight, in each direction in which it may move.
        samples: samples a pixel and side of both pictures where the target's own samples are not known.
    """

    faint: float = 0.05
    away: float = 1e4
    samples: int = 4


FAINT_BALLS = FaintBalls()


def unseen_balls(solution: FitState) -> dict[str, tuple[str, ...]]:
    """The balls without which the picture explains the target as well: their free index and positions, by name.

    Each ball whose index is near 1 is moved out of sight, and the residuals with it and without it are compared.
    """
    problem = solution.problem
    values, found = problem.values(solution.y), dict[str, tuple[str, ...]]()
    samples = (
        problem.base.samples if solution.comparison.edges == "point" else solution.target_samples or FAINT_BALLS.samples
    )
    unbiased = problem.with_bias(np.zeros(problem.observation.target.shape))

    def residual(values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, "3 height width"]:
        y = problem.array(problem.unknowns.unknowns(values))
        return unbiased.residual(supersampled(problem, y, samples))

    for ball, names in faint_balls(problem, values).items():
        places = [problem.unknowns.names.index(name) for name in names[1:]]
        without = values.copy()
        without[places] += FAINT_BALLS.away * problem.scale[places]
        if vuong_evidence(residual(values), residual(without)) < EVIDENCE:
            found[ball] = names
    return found


def faint_balls(problem: Problem, values: Float[np.ndarray, " parameters"]) -> dict[str, tuple[str, ...]]:
    """The balls with a free index near 1 and a free position: the names of these parameters, by the ball's name."""
    scene, faint, positions, balls = problem.scene, dict[Address, str](), dict[str, list[str]](), dict[str, Block]()
    for name, value in zip(problem.unknowns.names, values, strict=True):
        address, block, attribute, _ = resolve(scene, name)
        if attribute.quantity.role == "position" and address.component is not None:
            positions.setdefault(block.name, []).append(name)
            balls[block.name] = block
        elif attribute.quantity.role == "index" and abs(value - 1) < FAINT_BALLS.faint:
            faint[address] = name
    return {
        ball: (name, *names)
        for ball, names in positions.items()
        for address, name in faint.items()
        if is_material_of(scene, balls[ball], address)
    }


def with_open(uncertainty: Uncertainty, names: tuple[str, ...], opened: tuple[str, ...]) -> Uncertainty:
    """The uncertainty with some parameters open: their errors are infinite, and they are undetermined."""
    is_open = np.isin(names, opened)
    open_ = tuple(name for name in names if name in opened or name in uncertainty.undetermined)
    error = np.where(is_open, np.inf, uncertainty.standard_error)
    return dataclasses.replace(uncertainty, standard_error=error, undetermined=open_)
