"""Cameras: the ray through each point of the picture, and the rays and footprints of pixels.

A new type of camera is a struct in `scene.structs`, a row of `scene.table`, and a function and a row here.
"""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...scene.lens import undistorted_factor
from ...scene.scene import Camera, ImagePlaneCamera, PerspectiveCamera
from ...util.numerics import dot, normalize, per_ray
from ..settings import ResolvedSettings
from .rays import NO_SHAPE, Footprint, Number, Rays, Scalars, Step, Vectors

AnyArray = TypeVar("AnyArray", Array, np.ndarray)


def image_plane_direction(camera: ImagePlaneCamera, u: Scalars, v: Scalars) -> Vectors:
    """Directions from the viewpoint to points of the image plane z = 0, whose middle is at the camera's center."""
    aside, below = off_middle(camera)
    x, y = u - aside / 2, v + below / 2
    target = jnp.stack([x * camera.worlddim[0], y * camera.worlddim[1], jnp.zeros_like(u)])
    return target - per_ray(camera.viewpoint, u.ndim)


def perspective_direction(camera: PerspectiveCamera, u: Scalars, v: Scalars) -> Vectors:
    """Directions whose part along the view is 1.

    At the left and right borders their part to the side is the tangent of half the angle of view, if the principal
    point is in the picture's middle and the lens has no distortion.
    """
    width, height = camera.pixeldim
    forward = normalize(camera.lookat - camera.viewpoint)
    right = normalize(jnp.cross(forward, camera.up))
    up = jnp.cross(right, forward)
    reach = jnp.tan(jnp.deg2rad(camera.fov) / 2)
    aside, below = off_middle(camera)
    across, upwards = reach * (2 * u - 1 - aside), reach * (height / width) * (2 * v - 1 + below)
    factor = undistorted_factor(camera.distortion, across * across + upwards * upwards)
    across, upwards = factor * across, factor * upwards
    forward, right, up = (per_ray(axis, u.ndim) for axis in (forward, right, up))
    return forward + across * right + upwards * up


def off_middle(camera: Camera) -> tuple[Number, Number]:
    """How far `center` is to the right of and below the picture's middle, in halves of its sides: there exactly 0."""
    width, height = camera.pixeldim
    return (2 * camera.center[0] + 1 - width) / width, (2 * camera.center[1] + 1 - height) / height


DIRECTIONS: dict[type, Callable[..., Vectors]] = {
    ImagePlaneCamera: image_plane_direction,
    PerspectiveCamera: perspective_direction,
}
"""The function of each type of camera: in which directions, of any length, points of the picture lie."""


def ray(camera: Camera, u: Scalars, v: Scalars) -> tuple[Vectors, Vectors]:
    """Origins and directions, of any length, of the rays through points of the picture.

    Args:
        u: from the left border, 0, to the right one, 1.
        v: from the lower border, 0, to the upper one, 1.
    """
    direction = DIRECTIONS[type(camera)](camera, u, v)
    return jnp.broadcast_to(per_ray(camera.viewpoint, u.ndim), direction.shape), direction


def picture_place(
    camera: Camera, settings: ResolvedSettings, column: Float[AnyArray, " *rays"], row: Float[AnyArray, " *rays"]
) -> tuple[Float[AnyArray, " *rays"], Float[AnyArray, " *rays"]]:
    """The `u` and `v` at which fractional pixel positions look, of JAX or of numpy.

    Args:
        column: pixels (of those that are rendered: `binning`) from the left; whole numbers are their own points.
        row: pixels from the **top**; the course's y = 0 is the bottom row.
    """
    width, height = settings.picture_size(camera.pixeldim)
    if settings.binning > 1:
        column, row = (settings.binning * (x + 0.5) - 0.5 for x in (column, row))
    from_bottom = (height - 1) - row
    if settings.mapping == "center":
        return (column + 0.5) / width, (from_bottom + 0.5) / height
    # A picture of one pixel has no end points to include: it looks at the middle.
    u = column / (width - 1) if width > 1 else column + 0.5
    v = from_bottom / (height - 1) if height > 1 else from_bottom + 0.5
    return u, v


def pixel_step(camera: Camera, settings: ResolvedSettings) -> Step:
    """The step of `u` from one pixel to the next to the right, and of `v` to the next down, where it is negative."""
    (left, right), (above, below) = picture_place(camera, settings, np.arange(2.0), np.arange(2.0))
    return np.array([right - left, below - above])


def rays_through(camera: Camera, settings: ResolvedSettings, u: Scalars, v: Scalars, step: Float[Array, "2"]) -> Rays:
    """Rays from the viewpoint through points of the picture, as in `ray`.

    Args:
        settings: with `edges="aware"` each ray stands for the pixel around its point, or for one of its samples' part.
        step: how far `u` is from one pixel to the next to the right, and `v` to the next down.
    """
    through, footprint = functools.partial(ray, camera), None
    if settings.edges != "aware":
        o, direction = through(u, v)
        d = normalize(direction)
    else:
        one, sides = jnp.ones_like(u), jnp.diag(step)
        turned = jax.vmap(lambda side: jax.jvp(through, (u, v), (side[0] * one, side[1] * one)), out_axes=(None, 0))
        (o, direction), axes = turned(sides)
        d, (origins, turns) = normalize(direction), jax.tree.map(lambda x: x / settings.samples, axes)
        toward = turns / jnp.sqrt(dot(direction, direction))
        spread = toward - jnp.sum(toward * d, 1)[:, None] * d
        none, passed = jnp.zeros(u.shape, jnp.int32), jnp.full((2, *u.shape), NO_SHAPE, jnp.int32)
        footprint = Footprint(*jax.lax.stop_gradient((origins, spread)), passed, none, none)
    nowhere, outside = jnp.full(u.shape, NO_SHAPE, jnp.int32), jnp.zeros(u.shape, bool)
    throughput = jnp.ones_like(u) if settings.has_throughput else None
    return Rays(o, d, jnp.zeros_like(u), nowhere, outside, footprint, throughput)
