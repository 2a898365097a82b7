"""The residual of a picture as a function for an optimisation of one's own, and the error bars of where that ends."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..errors import ParameterError
from ..images.filters import gaussian_blur
from ..scene.scene import Scene
from ..tracer.rendering import picture_at
from ..tracer.settings import RenderSettings, ResolvedSettings, resolve_settings
from ..util.checked import refuse_other
from ..util.numerics import is_traced, on_host, real_numbers, with_lower_ranks
from .build_problem import OfViews, build_problem
from .judge.uncertainty import quantify_uncertainty
from .options import FitOptions, Stage
from .problem.linearize import gauss_newton_step
from .problem.observation import Observation
from .problem.problem import FitState, Problem
from .problem.sampling import lattice_size, resampled, supersampled
from .problem.unknowns import Covariance, Picture, Scalar, Unknowns, Values, Vector, make_prior


class PictureResidual(eqx.Module):
    """The difference of a scene's picture from a target; made by `make_residual`.

    A pytree, whose methods are pure and can be differentiated, compiled and mapped.

    A parameter is a linear function of its unknown from one bound to the other. Beyond a bound the picture stays that
    of the bound, and the derivative is 0: a solver that does not know the bounds stays there. A loop keeps within them
    by `y = jnp.clip(y, picture.lower, picture.upper)` after each step. No function that has the bounds at infinity
    stands for this, since colours of exactly 0 and 1 and an alpha of 1 are usual: they would be at infinity.

    Args:
        start: the unknowns at which the parameters have the scene's values, about as large as 1.
        target_samples: samples a side of the target's pixels, if they are known; only `covariance` asks for them.
        others: of a scene of several cameras those of the others, whose `scene` has their camera first.
    """

    start: Vector
    scene: Scene
    observation: Observation
    unknowns: Unknowns = eqx.field(static=True)
    settings: ResolvedSettings = eqx.field(static=True)
    target_samples: int | None = eqx.field(static=True, default=None)
    others: tuple["PictureResidual", ...] = ()

    @property
    def lower(self) -> Vector:
        """The least value of each unknown, minus infinity where there is none."""
        return jnp.asarray(self.unknowns.reach[0], self.start.dtype)

    @property
    def upper(self) -> Vector:
        """The largest value of each unknown, infinity where there is none."""
        return jnp.asarray(self.unknowns.reach[1], self.start.dtype)

    @with_lower_ranks
    def residual(
        self, y: Vector, args: Float[ArrayLike, ""] | None = None
    ) -> Picture | tuple[Float[Array, "3 _ _"], ...]:
        """Picture minus target, weighted; an error where rays find no room, as `render` raises it.

        Of several cameras a tuple, a residual each in their order.

        Args:
            args: standard deviation in pixels of a Gaussian blur, so that a loop can go from coarse to fine; None is 0.
        """
        y = self._checked(y)
        blur = jnp.asarray(0.0 if args is None else args, y.dtype)
        each = tuple(view._blurred(y, blur) for view in (self, *self.others))
        return each if self.others else each[0]

    def _blurred(self, y: Vector, blur: Scalar) -> Picture:
        """The blurred residual of the first camera alone."""
        image = picture_at(y, self.scene.alone(), self.unknowns.seen_in(self.scene), self.settings)
        return gaussian_blur(self.observation.residual(image), blur)

    def _checked(self, y: ArrayLike) -> Vector:
        """The unknowns as an array. Raises ParameterError: there are not as many, or they are no real numbers."""
        try:
            unknowns = y if isinstance(y, Array) else jnp.asarray(real_numbers(y), self.start.dtype)
        except ValueError as reason:
            raise ParameterError(f"the row of unknowns {reason}.") from None
        if unknowns.shape != self.start.shape or not jnp.issubdtype(unknowns.dtype, jnp.floating):
            names = ", ".join(self.unknowns.names)
            raise ParameterError(
                f"the unknowns have the shape {unknowns.shape} and the dtype {unknowns.dtype}; one real number is "
                f"wanted for each of {names}, in the shape {self.start.shape}."
            )
        return unknowns

    def parameters(self, y: Float[ArrayLike, " parameters"]) -> dict[str, Scalar]:
        """The value of each free parameter at unknowns `y`."""
        return dict(zip(self.unknowns.names, self.unknowns.values(self._checked(y)), strict=True))

    def scene_at(self, y: Vector) -> Scene:
        """The scene at unknowns `y`."""
        return self.unknowns.moved(self.scene, self._checked(y))


def make_residual(
    scene: Scene,
    target: OfViews[ArrayLike],
    free: Sequence[str],
    settings: RenderSettings | None = None,
    *,
    weights: OfViews[ArrayLike | None] = None,
    ties: Mapping[str, str] | None = None,
    fit_exposure: bool = False,
    target_samples: int | None = None,
) -> PictureResidual:
    """The residual `residual(y, args)` of a scene's picture, for an optimisation loop of one's own.

    It shares with `fit` only the change of variables: the unknowns are about as large as 1, and no parameter leaves its
    bounds; those of the unknowns are `lower` and `upper`. There is no search, no robust loss and no correction.
    Pictures are those of points, and their derivatives contain the motion of edges, unless the settings say `edges`:
    with `"point"` they do not, and with `"aware"` the picture is nearly that of a box-filtered target as well.

    With optimistix: `optimistix.least_squares(it.residual, solver, it.start)`. With optax: minimise
    `0.5 * jnp.sum(it.residual(y) ** 2)`. `covariance(it, y)` has the error bars of where a loop ends.

    Args:
        scene: its values are the start, its dtype the precision.
        target, weights: as of `fit`, also of several cameras.
        settings: what to render; unlike in `fit`, its `edges` is used. None takes the settings in the scene's file.
        target_samples: the target's pixels are means of so many samples a side; only `covariance` uses it.

    Returns:
        The residual with its `start`, and what leads from unknowns to parameters and to the scene.

    Raises:
        ParameterError: unknown names, none at all, or one twice; a tie of what is not free.
        PictureError: a target of another size, with NaN or infinity, or constant; weights that make no sense.
    """
    # Only the film's effects that do something, or are free, are computed in the loop.
    settings = resolve_settings(scene, settings)
    ties = {} if ties is None else ties
    options = FitOptions(ties=ties, fit_exposure=fit_exposure, target_samples=target_samples)
    problem = build_problem(scene, target, free, settings, options, weights).problem
    parts = []
    for view in problem.views:
        scene = problem.whole.seen_by(view.scene.camera.name)
        if scene.film is not None:
            scene = dataclasses.replace(scene, film=view.camera.of_scene.film)
        parts.append(
            PictureResidual(problem.start(), scene, view.observation, problem.unknowns, settings, target_samples)
        )
    return dataclasses.replace(parts[0], others=tuple(parts[1:]))


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
    for each in problems:
        refuse_other(each, PictureResidual, "make_residual")
    if is_traced((problems, y)):
        raise ParameterError("covariance wants concrete values: call it outside of JAX's transformations.")
    _refuse_other_unknowns(problems)
    sigma, reach = FitOptions(sigma=sigma).sigma, problems[0].unknowns.reach
    problems[0].parameters(y)  # Refuses what is no row of unknowns.
    place = np.clip(np.asarray(y), *reach)  # Beyond a bound the picture is that of the bound.

    # All residuals in one unit, so that they compare as in the loop.
    problems = [part for each in problems for part in (dataclasses.replace(each, others=()), *each.others)]
    first = _problem_of(problems[0]).in_own_unit()
    states = [_state_at(_problem_of(each).in_own_unit(first.unit), each, place) for each in problems]
    state = states[0].of_views(states)
    # The Gauss-Newton step to the minimum of all sums of squares, cut off at the bounds.
    y = on_host(state.y)
    step = np.clip(y + gauss_newton_step(state.joint), *reach) - y
    state = dataclasses.replace(state, next_step=step)
    uncertainty = quantify_uncertainty(state, None if sigma is None else sigma / first.unit)
    return ErrorBars(first.unknowns.names, uncertainty.standard_error, uncertainty.covariance, uncertainty.weakest)


def _refuse_other_unknowns(problems: Sequence[PictureResidual]) -> None:
    """Raise ParameterError where a row of unknowns does not mean the same values to all problems."""
    first = problems[0].unknowns
    for position, other in enumerate((each.unknowns for each in problems[1:]), 2):
        if other.names != first.names:
            raise ParameterError(
                f"problem 1 has the unknowns {', '.join(first.names)}, and problem {position} has "
                f"{', '.join(other.names)}; all problems need the same ones in the same order."
            )
        for name, here, there in zip(first.names, first.transforms, other.transforms, strict=True):
            if here != there:
                raise ParameterError(
                    f"the unknown of {name} is in units of {here.width:g} in problem 1, and of {there.width:g} in "
                    f"problem {position}: the same number would be two values. Units follow from what the camera "
                    "shows, and those of light from the target's brightness."
                )


def _problem_of(picture: PictureResidual) -> Problem:
    """The problem of a fit whose picture is that of the residual."""
    prior = make_prior({}, picture.unknowns, picture.start.dtype)
    return Problem(
        picture.scene.alone(),
        picture.observation,
        picture.unknowns,
        prior,
        picture.settings,
        picture.scene,
        picture.unknowns.seen_in(picture.scene),
        samples=picture.target_samples,
    )


def _state_at(problem: Problem, picture: PictureResidual, place: Values) -> FitState:
    """The state of a fit whose residual and derivative are those of the loop."""
    stage, y = Stage(picture.settings.edges or "aware"), problem.array(place)
    picture_there = problem.picture(y, stage.edges)
    if picture.settings.edges is None:  # The picture of points, with the derivative of areas.
        points = supersampled(problem, y, picture.settings.samples)
        picture_there = dataclasses.replace(picture_there, image=problem.array(points))
    confusion = resampled(problem, y, stage, lattice_size()).confusion() if stage.edges == "aware" else None
    return FitState(problem, y, stage, problem.linearize(y, stage, picture_there), confusion=confusion)
