"""A photograph's camera in the frame of its board: places of points in the picture, and rays through its pixels.

The frame is the board's: x to the right, y up, z towards who looks at it, in the board's unit of length. A camera is a
row of numbers: a rotation vector and a translation, as OpenCV has them (into a frame of x to the right, y down, z
forward), the full horizontal angle of view in degrees, the distortion k1, k2 of `scene.lens`, and how far the
principal point is to the right of and below the picture's middle, in widths of the picture. Pixels are OpenCV's: (0, 0)
is the middle of the upper left one.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.lens import undistorted_factor
from raytrace_jax.util.numerics import TINY

COUNT = 11
"""How many numbers a camera has."""

POSE, FOV, K1, K2, ASIDE = slice(0, 6), 6, 7, 8, slice(9, 11)

LENS = slice(FOV, COUNT)
"""Places of the lens's numbers, which do not depend on where the camera stands."""

Numbers = Float[Array, " numbers"]

Size = tuple[int, int] | Float[Array, "2"]
"""Width and height of a picture, in pixels."""


def rotation(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The rotation by the length of a vector about it (Rodrigues); its derivative at 0 is finite."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    squared = vector @ vector
    is_small = squared < 1e-12
    angle = jnp.sqrt(jnp.where(is_small, 1.0, squared))
    sine = jnp.where(is_small, 1 - squared / 6, jnp.sin(angle) / angle)
    cosine = jnp.where(is_small, 0.5 - squared / 24, (1 - jnp.cos(angle)) / (angle * angle))
    return jnp.eye(3, dtype=vector.dtype) + sine * cross + cosine * (cross @ cross)


def focal_length(camera: Numbers, size: Size) -> Float[Array, ""]:
    """The focal length in pixels of a picture of this width and height."""
    return size[0] / (2 * jnp.tan(jnp.deg2rad(camera[FOV]) / 2))


def principal_point(camera: Numbers, size: Size) -> Float[Array, "2"]:
    """The principal point, in pixels."""
    return (jnp.asarray(size, float) - 1) / 2 + camera[ASIDE] * size[0]


def project(camera: Numbers, size: Size, points: Float[Array, "*any 3"]) -> Float[Array, "*any 2"]:
    """Where points are seen, in pixels; they lie in front of the camera."""
    seen = points @ rotation(camera[:3]).T + camera[3:6]
    x = seen[..., :2] / jnp.maximum(seen[..., 2:], TINY)
    squared = jnp.sum(x * x, axis=-1, keepdims=True)
    share = 1 + camera[K1] * squared + camera[K2] * squared * squared
    return focal_length(camera, size) * share * x + principal_point(camera, size)


def viewpoint(camera: Numbers) -> Float[Array, "3"]:
    """Where the camera is."""
    return -rotation(camera[:3]).T @ camera[3:6]


def directions(camera: Numbers, size: Size, pixels: Float[Array, "*any 2"]) -> Float[Array, "*any 3"]:
    """Unit directions in which pixels look."""
    x = (pixels - principal_point(camera, size)) / focal_length(camera, size)
    x = x * undistorted_factor(camera[K1 : K2 + 1], jnp.sum(x * x, axis=-1))[..., None]
    ahead = jnp.concatenate([x, jnp.ones_like(x[..., :1])], axis=-1)
    ahead = ahead / jnp.sqrt(jnp.sum(ahead * ahead, axis=-1, keepdims=True))
    return ahead @ rotation(camera[:3])


def on_board(
    origin: Float[Array, "*any 3"], direction: Float[Array, "*any 3"]
) -> tuple[Float[Array, "*any 2"], Float[Array, " *any"]]:
    """Where rays meet the board's plane, and how far along them; less than 0 where they never do."""
    falls = -direction[..., 2]
    distance = jnp.where(falls > TINY, origin[..., 2] / jnp.where(falls > TINY, falls, 1.0), -1.0)
    return (origin + distance[..., None] * direction)[..., :2], distance
