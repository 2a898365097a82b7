"""What a fit asks of its forward model: pictures with their derivatives, and colours at points.

This is the seam between a fit and the tracer. A scene of another type may bring a model of its own:
`forward_model.register` it, as for any `functools.singledispatch`.
"""

import functools
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.pixels import (
    PixelDerivatives,
    Pixels,
    pixel_colors,
    pixel_derivatives,
    prepare_colors,
    prepare_derivatives,
)
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.run import Points


class Picture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        image: the picture.
        columns: its derivative with respect to each of the unknowns.
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Trace.sees_edge`; else None.
    """

    image: Float[Array, "3 height width"]
    columns: Float[Array, "parameters 3 height width"]
    sees_edge: Bool[np.ndarray, "height width"] | None = None


@runtime_checkable
class ForwardModel(Protocol):
    """Computes what pixels show of a scene's light, before the film."""

    def differentiate(
        self, y: Float[Array, " light"], scene: Scene, pixels: Pixels, unknowns: Unknowns, settings: ResolvedSettings
    ) -> PixelDerivatives:
        """Colours of pixels and their derivatives by the unknowns `y`; see `pixel_derivatives`."""
        ...

    def prepare_differentiate(
        self, y: Float[Array, " light"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings
    ) -> None:
        """Compile what `differentiate` will run, and run nothing."""
        ...

    def points(
        self, scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> Float[np.ndarray, "scenes 3 points"]:
        """Colours at points of the pictures of several scenes; see `pixel_colors`."""
        ...

    def prepare_points(
        self, scene: Scene, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> None:
        """Compile what `points` will run, and run nothing."""
        ...


class Tracer:
    """The forward model of all scenes that are traced."""

    differentiate = staticmethod(pixel_derivatives)
    prepare_differentiate = staticmethod(prepare_derivatives)
    points = staticmethod(pixel_colors)
    prepare_points = staticmethod(prepare_colors)


@functools.singledispatch
def forward_model(scene: Scene) -> ForwardModel:
    """The forward model for a scene's type; the tracer, unless another one was registered."""
    return Tracer()
