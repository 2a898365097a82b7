"""A batch of rays, and the camera's rays through given points of the picture."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._numerics import normalize
from .scene import Camera
from .settings import RenderSettings

NO_SHAPE = -1
"""The shape index of a ray that starts in free space, and of one that hits nothing."""


class Rays(eqx.Module):
    """Rays `o + t d`, with what decides exactly, without an epsilon, whether they can meet their own origin again.

    Args:
        o: origins, world units.
        d: directions of length one.
        path_length: length of the path from the viewpoint to the origin, world units.
        origin_shape: index of the shape on which the ray starts, or `NO_SHAPE`.
        inside: whether the ray leaves that shape's surface towards the side that its normal points away from.
    """

    o: Float[Array, "3 *rays"]
    d: Float[Array, "3 *rays"]
    path_length: Float[Array, " *rays"]
    origin_shape: Int[Array, " *rays"]
    inside: Bool[Array, " *rays"]


def film_points(
    camera: Camera, settings: RenderSettings, column: Float[Array, " *rays"], row: Float[Array, " *rays"]
) -> Float[Array, "3 *rays"]:
    """Points of the image plane z = 0 at which fractional pixel positions look.

    Args:
        camera: gives the extent of the image plane.
        settings: gives the size of the picture and the mapping.
        column: pixels from the left; whole numbers are the pixels' own points.
        row: pixels from the **top**; the course's y = 0 is the bottom row.
    """
    width, height = settings.picture_size(camera.pixeldim)
    from_bottom = (height - 1) - row
    if settings.mapping == "center":
        u, v = (column + 0.5) / width, (from_bottom + 0.5) / height
    else:  # A picture of one pixel has no end points to include: it looks at the middle.
        u = column / (width - 1) if width > 1 else column + 0.5
        v = from_bottom / (height - 1) if height > 1 else from_bottom + 0.5
    return jnp.stack([u * camera.worlddim[0], v * camera.worlddim[1], jnp.zeros_like(u)])


def camera_rays(
    camera: Camera, settings: RenderSettings, column: Float[Array, " *rays"], row: Float[Array, " *rays"]
) -> Rays:
    """Rays from the viewpoint through fractional pixel positions, as in `film_points`."""
    target = film_points(camera, settings, column, row)
    o = jnp.broadcast_to(camera.viewpoint.reshape((3,) + (1,) * column.ndim), target.shape)
    return Rays(
        o=o,
        d=normalize(target - o),
        path_length=jnp.zeros_like(column),
        origin_shape=jnp.full(column.shape, NO_SHAPE, jnp.int32),
        inside=jnp.zeros(column.shape, bool),
    )
