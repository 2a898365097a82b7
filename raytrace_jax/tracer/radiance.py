"""The radiance of a picture's pixels, and its derivatives in forward mode, before the camera's response.

Both exist outside of JAX's transformations, by `in_batches`, and as a part of the caller's program, by `in_one_call`.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import PictureError, SettingsError
from ..scene.response import Frame, develop
from ..scene.scene import Scene, map_scenes
from ..util.compilation import jit
from ..util.numerics import is_zero
from ..util.session import lack_of_memory
from .batches import TracePoints, in_batches
from .film import Film, Image
from .pixels import SceneFunction, mean_of_samples, picture_pixels, pixel_derivatives, pixel_outputs
from .resolved_settings import ResolvedSettings
from .settings import AOVS

Jacobian = Float[Array, "parameters 3 height width"]


def refuse_too_large(scene: Scene, settings: ResolvedSettings, derivatives: int = 0) -> None:
    """Raise PictureError where there is no memory for a picture, and SettingsError of a crop outside of it."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    channels = 3 * (1 + derivatives) + sum(len(AOVS[name].channels) for name in settings.aov)
    # A channel of a pixel is rendered and written in several copies. Between pictures of 1024 and 2048 pixels a side
    # the peak grows by 34 bytes (OpenEXR), 32 (PNG), 37 (64 bits) and, with a derivative, 31.
    if lack := lack_of_memory(30 * channels * width * height):
        by = f" with derivatives by {derivatives} numbers" if derivatives else ""
        raise PictureError(
            f"a picture of {width} x {height} pixels{by} {lack}: render it in parts (--crop), or smaller (--size)."
        )


def render_radiance(
    scene: Scene, settings: ResolvedSettings, trace_points: TracePoints = in_batches, reversible: bool = False
) -> Film:
    """The picture of a scene before the camera's response, by settings that say `edges`; the scene was checked."""
    numpy: Any = np if trace_points is in_batches else jnp
    _, _, width, height = settings.window(scene.camera.pixeldim)
    scenes = map_scenes(lambda x: numpy.asarray(x)[None], dataclasses.replace(scene, film=None))
    pixels = picture_pixels(scene, settings, numpy)
    found: dict[str, Any] = {}
    overflow: Any = 0
    if settings.samples == 1 or settings.aov:
        # The variables are those of the pixels' own points: their means would mean nothing.
        found, overflow = pixel_outputs(scenes, pixels, settings, trace_points, reversible)
    if settings.samples > 1:
        without = dataclasses.replace(settings, aov=())

        def colors(points):
            found, overflow = pixel_outputs(scenes, pixels._replace(points=points), without, trace_points, reversible)
            return [found["color"]], overflow

        [found["color"]], more = mean_of_samples(pixels, settings.samples, colors)
        overflow = overflow + more
    aov = {name: x[0].reshape(*x.shape[1:-1], height, width) for name, x in found.items()}
    if trace_points is in_batches:
        # Put there as they are: `jnp.asarray` would compile a program for each size.
        aov, overflow = jax.device_put((aov, np.int32(overflow)))
    return Film(aov.pop("color"), aov, overflow)


def radiance_derivatives(
    y: Array,
    scene: Scene,
    unknowns: SceneFunction,
    settings: ResolvedSettings,
    trace_points: TracePoints = in_batches,
    reversible: bool = False,
) -> tuple[Any, Any, Any]:
    """A picture before the camera's response, its derivatives by `y` in forward mode, and the overflow.

    Without `edges` the picture is that of points, and only the derivative that of areas.
    """
    _, _, width, height = settings.window(scene.camera.pixeldim)
    pixels = picture_pixels(scene, settings, np if trace_points is in_batches else jnp)
    found = pixel_derivatives(y, scene, pixels, unknowns, settings.of_derivative, trace_points, reversible)
    image, overflow = found.color.reshape(3, height, width), found.overflow
    if not settings.edges:
        points = dataclasses.replace(settings.of_points, aov=())
        radiance = render_radiance(unknowns.moved(scene, y), points, trace_points, reversible)
        image, overflow = radiance.image, overflow + radiance.overflow
    return image, found.jacobian.reshape(-1, 3, height, width), overflow


@jax.custom_jvp
def not_differentiable(values: Any) -> Any:
    """The values themselves, with respect to which nothing may be differentiated."""
    return values


def _refuse_derivative(primals, tangents):
    if is_zero(tangents):
        return *primals, *tangents
    raise SettingsError(
        "edges: a picture whose derivative contains the motion of edges has no second derivative; RenderSettings("
        "edges='point') has one, without that motion, and Gauss-Newton steps (J^T J) do with first derivatives."
    )


not_differentiable.defjvp(_refuse_derivative, symbolic_zeros=True)


@functools.partial(jit, static_argnames=("unknowns", "frame"))
def develop_derivatives(
    image: Image,
    jacobian: Jacobian,
    y: Float[Array, " parameters"],
    scene: Scene,
    unknowns: SceneFunction,
    frame: Frame,
) -> tuple[Image, Jacobian]:
    """A picture of radiance as the camera's response shows it, and its derivatives by all unknowns.

    Args:
        scene: gives the response, with None for effects that do nothing.
    """

    def developed(image, y):
        return develop(image, unknowns.moved(scene, y).film, frame)

    def derivative(change, direction):
        return jax.jvp(developed, (image, y), (change, direction))

    # Chain rule: derivatives of the radiance pass through the response, and the response's own ones are added.
    return jax.vmap(derivative, out_axes=(None, 0))(jacobian, jnp.eye(len(y), dtype=y.dtype))
