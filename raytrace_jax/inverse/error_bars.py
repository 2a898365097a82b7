"""The error bars of a loop of one's own: the covariance of what one picture or several determine."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ..errors import ParameterError
from ..util.checked import refuse_other
from ..util.numerics import is_traced
from .judge.uncertainty import quantify_uncertainty
from .observe.resampled import resampled
from .observe.sampling import Sampling, lattice_size, sampled, stages_of, supersampled
from .options import FitOptions, Stage
from .problem.problem import FitState, Problem
from .problem.unknowns import Covariance, Values, make_prior
from .residual_function import PictureResidual
from .solve.solvers import gauss_newton_step


class ErrorBars(NamedTuple):
    """How sure values are; made by `covariance`.

    Args:
        names: the parameters, in the order of the unknowns.
        standard_error: one standard deviation of each value; infinity where the pictures do not determine it, NaN where
            sums of squares are beyond the dtype.
        covariance: that of the values; its root is the standard error where that is finite.
        weakest: the combination of parameters that the pictures determine least, in words.
    """

    names: tuple[str, ...]
    standard_error: Values
    covariance: Covariance
    weakest: str


def covariance(
    problem: PictureResidual | Sequence[PictureResidual],
    y: ArrayLike,
    *,
    sigma: float | None = None,
) -> ErrorBars:
    """The covariance of the parameters' values (not of the unknowns) at the end of a loop of one's own.

    Unknowns `y` are taken for the minimum of the sum of squares of `residual(y)`, without a blur; of several problems,
    for that of all their sums of squares together. Weights say how the noise of the pictures compares. The errors are
    those of `fit`: the sandwich `H^-1 M H^-1`, which holds whatever the noise's distribution, also where neighbours go
    together. M is taken from what the residuals show, with what the target's storage adds; the noise of two pictures
    is independent. Where `y` is not quite the minimum the step that is left to it is added. Errors say nothing of a
    scene that is wrong: look at the residual.

    Args:
        problem: made by `make_residual`; or several with the same unknowns, such as two cameras or two colours.
        y: concrete values, outside of JAX's transformations.
        sigma: standard deviation of the noise in one channel of a pixel of weight 1, in the target's unit: no error is
            below what such noise makes. None: what the residuals show is all.

    Returns:
        The names, their standard errors and covariance.

    Raises:
        ParameterError: no problem, or problems with other unknowns; not one real number for each; a traced `y`; a sigma
            that is not above 0.
    """
    problems = [problem] if isinstance(problem, PictureResidual) else list(problem)
    if not problems:
        raise ParameterError("covariance has no problem; one that make_residual has made is wanted, or several.")
    for one in problems:
        refuse_other(one, PictureResidual, "make_residual")
    if is_traced((problems, y)):
        raise ParameterError("covariance wants concrete values: call it outside of JAX's transformations.")
    _refuse_other_unknowns(problems)
    sigma, reach = FitOptions(sigma=sigma).sigma, problems[0].unknowns.reach
    problems[0].parameters(y)  # Refuses what is no row of unknowns.
    place = np.clip(np.asarray(y), *reach)  # Beyond a bound the picture is that of the bound.

    # All residuals in one unit, so that they compare as in the loop.
    first = _problem_of(problems[0]).in_own_unit()
    states = [_state_at(_problem_of(one).in_own_unit(first.unit), one, place) for one in problems]
    step = _step_left(states)
    states[0] = dataclasses.replace(states[0], next_step=step)
    found = quantify_uncertainty(states[0], None if sigma is None else sigma / first.unit, *states[1:])
    return ErrorBars(first.unknowns.names, found.standard_error, found.covariance, found.weakest)


def _refuse_other_unknowns(problems: Sequence[PictureResidual]) -> None:
    """Raise ParameterError where a row of unknowns does not mean the same values to all problems."""
    first = problems[0].unknowns
    for number, other in enumerate((one.unknowns for one in problems[1:]), 2):
        if other.names != first.names:
            raise ParameterError(
                f"problem 1 has the unknowns {', '.join(first.names)}, and problem {number} has "
                f"{', '.join(other.names)}; all problems need the same ones in the same order."
            )
        for name, here, there in zip(first.names, first.transforms, other.transforms, strict=True):
            if here != there:
                raise ParameterError(
                    f"the unknown of {name} is in units of {here.width:g} in problem 1, and of {there.width:g} in "
                    f"problem {number}: the same number would be two values. Units follow from what the camera shows, "
                    "and those of light from the target's brightness."
                )


def _problem_of(picture: PictureResidual) -> Problem:
    """The problem of a fit whose picture is that of the residual."""
    prior = make_prior({}, picture.unknowns, picture.start.dtype)
    stages = stages_of(picture.target_samples)
    return Problem(picture.scene, picture.observation, picture.unknowns, prior, picture.settings, stages)


def _state_at(problem: Problem, picture: PictureResidual, place: Values) -> FitState:
    """The state of a fit whose residual and derivative are those of the loop."""
    stage, y = Stage(picture.settings.edges or "aware"), problem.array(place)
    found = problem.picture(y, stage.edges)
    if picture.settings.edges is None:  # The picture of points, with the derivative of areas.
        points = supersampled(problem, y, picture.settings.samples)
        found = dataclasses.replace(found, image=problem.array(points))
    if picture.target_samples is not None and stage.edges == "aware":
        confused = resampled(problem, y, stage, lattice_size()).confusion()
        problem = sampled(problem, Sampling(picture.target_samples, confused))
    return FitState(problem, y, stage, problem.linearize(y, stage, found))


def _step_left(states: Sequence[FitState]) -> Values:
    """The step of Gauss and Newton to the minimum of all sums of squares, as far as the bounds allow."""
    first = states[0]
    parts = {
        name: jnp.asarray(np.concatenate([np.asarray(getattr(one.linearization, name)) for one in states]))
        for name in ("jacobian", "residual")
    }
    curvature = sum(np.asarray(one.linearization.curvature) for one in states)
    joint = dataclasses.replace(first.linearization, **parts, curvature=jnp.asarray(curvature))
    y = np.asarray(first.y, np.float64)
    return np.clip(y + gauss_newton_step(joint), *first.problem.unknowns.reach) - y
