"""What lies at infinity in each direction, from an equirectangular picture, at points and as means over footprints.

Of h x w texels the column is (atan2(d.x, -d.z) / 2 pi + 1/2) w - 1/2, so that the middle lies along -z and its right
half towards +x, and the row is acos(d.y) / pi h - 1/2: row 0 is up. Columns go round, rows end at the poles.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.setting_words import TextureWrap
from raytrace_jax.tracer.shading.image_texture import PARTS
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.quadrature import mean, parts
from raytrace_jax.tracer.shading.texels import between_levels, between_texels
from raytrace_jax.util.numerics import dot

WRAP: tuple[TextureWrap, TextureWrap] = ("repeat", "clamp")


def environment_at_directions(pyramid: Pyramid, d: Float[Array, "3 *rays"]) -> Float[Array, "3 *rays"]:
    """Colours in directions, between the four nearest texels.

    Args:
        pyramid: the picture, of which only the finest level is looked at.
        d: directions, of any length but 0.
    """
    u, v = equirectangular(d)
    return between_texels(pyramid, jnp.zeros(u.shape, jnp.int32), u, v, WRAP)


def environment_over_footprints(
    pyramid: Pyramid, d: Float[Array, "3 *rays"], axes: Float[Array, "2 3 *rays"]
) -> Float[Array, "3 *rays"]:
    """Means of the colours over parallelograms of directions, which go to those in one direction as these shrink.

    Args:
        pyramid: the picture with all its levels.
        d: the middles, of length 1.
        axes: derivatives of the directions along a footprint's two axes; it reaches half of them both ways.
    """
    divided = parts(axes, PARTS)
    u, v = equirectangular(jnp.moveaxis(divided.middles, 0, 1) + d[:, None])
    first, second = divided.axes
    # In texels of the rows, which are as high everywhere: those near the poles are narrow, but their columns alike.
    square = (dot(first, first) + dot(second, second)) / 2 * (pyramid.sizes[0][0] / math.pi) ** 2
    colours = between_levels(pyramid, jnp.broadcast_to(square / 3 + 1, u.shape), u, v, WRAP)
    return jnp.stack([mean(channel) for channel in colours])


def equirectangular(d: Float[Array, "3 *rays"]) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"]]:
    """Coordinates from 0 to 1 in the picture, from left to right and from the bottom to the top.

    The angle from the vertical is atan2 of both components, which is exact near the poles, where acos is not.
    """
    x, y, z = d
    squared = x * x + z * z
    # The column changes with the direction by one over the distance from the axis: so this is at most a million.
    pole = squared < 1e-12
    x, z = jnp.where(pole, 0, x), jnp.where(pole, -1, z)
    y = jnp.where(pole, jnp.where(y < 0, -1, 1), y)
    distance = jnp.where(pole, 0, jnp.sqrt(jnp.where(pole, 1, squared)))
    return jnp.arctan2(x, -z) / (2 * math.pi) + 0.5, 1 - jnp.arctan2(distance, y) / math.pi
