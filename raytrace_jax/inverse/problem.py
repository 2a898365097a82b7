"""One fit's fixed parts, and its linearisation at any point."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import PictureError
from ..parameters import get_parameter, set_parameters
from ..plan import Plan, plan_render
from ..render import run_with_room
from ..scene import Scene
from ..settings import RenderSettings
from .pyramid import bin_pixels
from .residual import Linearization, linearize
from .transforms import Transform, default_transform

PLAN_SLACK = 1.3
"""Room for the rays that the scene may grow while its parameters move, before the tracer must be compiled anew."""


@dataclasses.dataclass(frozen=True)
class Measure:
    """How picture and target are compared.

    Args:
        edges: how the picture is sampled, `point` or `aware`.
        sigma: standard deviation of the blur in pixels.
        loss_scale: scale of the Cauchy loss; infinity is plain least squares.
        binning: how many pixels are averaged to one in each direction, in picture and target.
    """

    edges: str
    sigma: float = 0.0
    loss_scale: float = np.inf
    binning: int = 1


class Problem:
    """A scene, a target, and what is free between them."""

    def __init__(
        self,
        scene: Scene,
        target: Float[Array, "3 height width"],
        names: tuple[str, ...],
        settings: RenderSettings,
    ):
        self.scene, self.target, self.names = scene, target, names
        self._settings = settings
        self.initial = np.array([float(get_parameter(scene, name)) for name in names])
        self.transforms: tuple[Transform, ...] = tuple(map(default_transform, names, self.initial))
        self._plans: dict[RenderSettings, Plan] = {}
        self._binned = {1: target}

    def settings(self, measure: Measure) -> RenderSettings:
        """The render settings of one way to compare."""
        binning = self._settings.binning * measure.binning
        return dataclasses.replace(self._settings, edges=measure.edges, binning=binning)

    def unknowns(self) -> Float[Array, " parameters"]:
        """The unknowns at the start."""
        y = [transform.to_unknown(value) for transform, value in zip(self.transforms, self.initial, strict=True)]
        return jnp.asarray(y, self.target.dtype)

    def values(self, y: Float[Array, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """The parameters' values at unknowns `y`."""
        return np.array([float(t.to_value(y[k])) for k, t in enumerate(self.transforms)])

    def scene_at(self, y: Float[Array, " parameters"]) -> Scene:
        """The scene at unknowns `y`."""
        return set_parameters(self.scene, dict(zip(self.names, self.values(y), strict=True)))

    def linearize(self, y: Float[Array, " parameters"], measure: Measure) -> Linearization:
        """Residual and Jacobian at `y`; the tracer's plan is enlarged as soon as rays would find no room."""
        settings = self.settings(measure)
        plan = self._plans.get(settings) or plan_render(self.scene_at(y), settings, PLAN_SLACK)
        # By way of the host: an array that lies on several devices is another kind of argument, and compiles anew.
        y = jnp.asarray(np.asarray(y))
        if measure.binning not in self._binned:
            self._binned[measure.binning] = bin_pixels(self.target, measure.binning)
        target = self._binned[measure.binning]
        sigma, loss_scale = (jnp.asarray(x, y.dtype) for x in (measure.sigma / measure.binning, measure.loss_scale))

        def program(plan):
            found = linearize(y, self.scene, target, sigma, loss_scale, self.names, self.transforms, settings, plan)
            return found, found.wanted

        found, self._plans[settings] = run_with_room(program, plan, settings)
        return found


def check_target(target, scene: Scene, settings: RenderSettings) -> Float[Array, "3 height width"]:
    """The target in the scene's dtype.

    Raises:
        PictureError: another size than the render, NaN, infinity, or a constant picture.
    """
    _, _, width, height = settings.window(scene.camera.pixeldim)
    picture = np.asarray(target)
    if picture.ndim != 3 or picture.shape[0] != 3:
        raise PictureError(f"the target has shape {picture.shape}; wanted (3, {height}, {width})")
    if picture.shape[1:] != (height, width):
        raise PictureError(
            f"the target is {picture.shape[2]} x {picture.shape[1]} pixels, the scene renders {width} x {height}; "
            "set the size to the target's, or crop"
        )
    bad = int(np.sum(~np.isfinite(picture)))
    if bad:
        raise PictureError(f"the target has {bad} values that are NaN or infinite; a fit needs finite ones")
    if np.all(picture == picture[:, :1, :1]):
        raise PictureError("the target is one constant colour; there is nothing in it to fit")
    return jnp.asarray(picture, scene.camera.viewpoint.dtype)
