"""The residual of a picture as a function for an optimisation of one's own, with optimistix, optax or anything else."""

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..errors import ParameterError
from ..images.filters import gaussian_blur
from ..scene.scene import Scene
from ..tracer.pure import picture_at
from ..tracer.resolved_settings import ResolvedSettings, resolve_settings
from ..tracer.settings import RenderSettings
from ..util.numerics import real_numbers, with_lower_ranks
from .build_problem import build_problem
from .options import FitOptions
from .problem.observation import Observation
from .problem.unknowns import Unknowns


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
    """

    start: Float[Array, " parameters"]
    scene: Scene
    observation: Observation
    unknowns: Unknowns = eqx.field(static=True)
    settings: ResolvedSettings = eqx.field(static=True)
    target_samples: int | None = eqx.field(static=True, default=None)

    @property
    def lower(self) -> Float[Array, " parameters"]:
        """The least value of each unknown, minus infinity where there is none."""
        return jnp.asarray(self.unknowns.reach[0], self.start.dtype)

    @property
    def upper(self) -> Float[Array, " parameters"]:
        """The largest value of each unknown, infinity where there is none."""
        return jnp.asarray(self.unknowns.reach[1], self.start.dtype)

    @with_lower_ranks
    def residual(
        self, y: Float[Array, " parameters"], args: Float[ArrayLike, ""] | None = None
    ) -> Float[Array, "3 height width"]:
        """Picture minus target, weighted; an error where rays find no room, as `render` raises it.

        Args:
            args: standard deviation in pixels of a Gaussian blur, so that a loop can go from coarse to fine; None is 0.
        """
        y = self._checked(y)
        image = picture_at(y, self.scene, self.unknowns, self.settings)
        blur = jnp.asarray(0.0 if args is None else args, y.dtype)
        return gaussian_blur(self.observation.residual(image), blur)

    def _checked(self, y: ArrayLike) -> Float[Array, " parameters"]:
        """The unknowns as an array. Raises ParameterError: there are not as many, or they are no real numbers."""
        try:
            found = y if isinstance(y, Array) else jnp.asarray(real_numbers(y), self.start.dtype)
        except ValueError as reason:
            raise ParameterError(f"the row of unknowns {reason}.") from None
        if found.shape != self.start.shape or not jnp.issubdtype(found.dtype, jnp.floating):
            names = ", ".join(self.unknowns.names)
            raise ParameterError(
                f"the unknowns have the shape {found.shape} and the dtype {found.dtype}; one real number is wanted for "
                f"each of {names}, in the shape {self.start.shape}."
            )
        return found

    def parameters(self, y: Float[ArrayLike, " parameters"]) -> dict[str, Float[Array, ""]]:
        """The value of each free parameter at unknowns `y`."""
        return dict(zip(self.unknowns.names, self.unknowns.values(self._checked(y)), strict=True))

    def scene_at(self, y: Float[Array, " parameters"]) -> Scene:
        """The scene at unknowns `y`."""
        return self.unknowns.moved(self.scene, self._checked(y))


def make_residual(
    scene: Scene,
    target: ArrayLike,
    free: Sequence[str],
    settings: RenderSettings | None = None,
    *,
    weights: ArrayLike | None = None,
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
        target, weights: as of `fit`.
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
    scene = problem.scene
    if scene.film is not None:
        scene = dataclasses.replace(scene, film=problem.camera.of_scene.film)
    return PictureResidual(
        start=problem.start(),
        scene=scene,
        observation=problem.observation,
        unknowns=problem.unknowns,
        settings=settings,
        target_samples=target_samples,
    )
