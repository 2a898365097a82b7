"""What a fit asks of its forward model: pictures with their derivatives, and colours at points.

This is the seam between a fit and the tracer. A scene of another type may bring a model of its own:
`forward_model.register` it, as for any `functools.singledispatch`.
"""

import functools
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.light_picture import Found, Places, differentiate_light, prepare_light
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.points import prepare_points, render_points
from raytrace_jax.tracer.programs.batches import Points
from raytrace_jax.tracer.resolved_settings import ResolvedSettings


@runtime_checkable
class ForwardModel(Protocol):
    """Computes what pixels show of a scene's light, before the film."""

    def differentiate(
        self, y: Float[Array, " light"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
    ) -> Found:
        """Colours of pixels and their derivatives by the unknowns `y`; see `differentiate_light`."""
        ...

    def prepare_differentiate(
        self, y: Float[Array, " light"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings
    ) -> None:
        """Compile what `differentiate` will run, and run nothing."""
        ...

    def points(
        self, scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> Float[np.ndarray, "scenes 3 points"]:
        """Colours at points of the pictures of several scenes; see `render_points`."""
        ...

    def prepare_points(
        self, scene: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> None:
        """Compile what `points` will run, and run nothing."""
        ...


class Tracer:
    """The forward model of all scenes that are traced."""

    differentiate = staticmethod(differentiate_light)
    prepare_differentiate = staticmethod(prepare_light)
    points = staticmethod(render_points)
    prepare_points = staticmethod(prepare_points)


@functools.singledispatch
def forward_model(scene: Scene) -> ForwardModel:
    """The forward model for a scene's type; the tracer, unless another one was registered."""
    return Tracer()
