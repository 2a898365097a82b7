"""Colours between the texels of a pyramid's levels, and between its levels.

The texel in row r and column c of h x w has its centre at u = (c + .5) / w, v = 1 - (r + .5) / h: row 0 is the top.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from raytrace_jax.scene.setting_words import TextureWrap
from raytrace_jax.tracer.geometry.gather import take_column
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.util.numerics import clamp01


def nearest_texel(
    pyramid: Pyramid, u: Float[Array, " *rays"], v: Float[Array, " *rays"], wrap: tuple[TextureWrap, TextureWrap]
) -> Float[Array, "3 *rays"]:
    """The texel of the finest level in which each point lies."""
    level = jnp.zeros(u.shape, jnp.int32)
    height, width = pyramid.size(level)
    return _texel(pyramid, level, jnp.floor((1 - v) * height), jnp.floor(u * width), wrap)


def between_texels(
    pyramid: Pyramid,
    level: Int[Array, " *rays"],
    u: Float[Array, " *rays"],
    v: Float[Array, " *rays"],
    wrap: tuple[TextureWrap, TextureWrap],
    extent: Float[Array, "2 *rays"] | None = None,
) -> Float[Array, "3 *rays"]:
    """Colours between the four nearest texels of a level.

    Args:
        pyramid, level: the picture.
        u, v: from left to right and from the bottom to the top.
        wrap: along u and along v.
        extent: over which share of the picture a colour changes to the next, along u and v; from centre to centre if
            None or larger. Means over intervals of texels of one colour each are such transitions.
    """
    height, width = pyramid.size(level)
    x, y = u * width - 0.5, (1 - v) * height - 0.5
    column, row = jnp.floor(x), jnp.floor(y)
    right, down = x - column, y - row
    if extent is not None:
        # 1e-12 only keeps what is divided by from 0: it is far below the rounding of a coordinate.
        across, along = (jnp.clip(part, 1e-12, 1) for part in (extent[0] * width, extent[1] * height))
        right, down = clamp01(0.5 + (right - 0.5) / across), clamp01(0.5 + (down - 0.5) / along)
    upper, lower = (
        _mix(_texel(pyramid, level, r, column, wrap), _texel(pyramid, level, r, column + 1, wrap), right)
        for r in (row, row + 1)
    )
    return _mix(upper, lower, down)


def between_levels(
    pyramid: Pyramid,
    squared_width: Float[Array, " *rays"],
    u: Float[Array, " *rays"],
    v: Float[Array, " *rays"],
    wrap: tuple[TextureWrap, TextureWrap],
    extent: Float[Array, "2 *rays"] | None = None,
) -> Float[Array, "3 *rays"]:
    """Colours of a level with texels so wide, in texels of the finest, or between the two levels next to it.

    The share of the coarser one is linear in the squared width, as the variance of the blur is, (w^2 - 1) / 12 from the
    means over texels and w^2 / 6 from what is between them.
    """
    top = len(pyramid.sizes) - 1
    powers = [4.0**k for k in range(top + 1)]
    level = sum((squared_width >= power).astype(jnp.int32) for power in powers[1:]) if top else 0
    level = jnp.broadcast_to(jnp.asarray(level, jnp.int32), u.shape)
    power = take_column(jnp.asarray(powers, u.dtype), level)
    share = jnp.clip((squared_width / power - 1) / 3, 0, 1)
    fine = between_texels(pyramid, level, u, v, wrap, extent)
    return _mix(fine, between_texels(pyramid, jnp.minimum(level + 1, top), u, v, wrap, extent), share)


def _texel(
    pyramid: Pyramid,
    level: Int[Array, " *rays"],
    row: Float[Array, " *rays"],
    column: Float[Array, " *rays"],
    wrap: tuple[TextureWrap, TextureWrap],
) -> Float[Array, "3 *rays"]:
    """Texels of whole rows and columns, which may lie beyond the picture."""
    height, width = pyramid.size(level)
    colour = pyramid.texel(level, _wrapped(row, height, wrap[1]), _wrapped(column, width, wrap[0]))
    for index, size, how in ((row, height, wrap[1]), (column, width, wrap[0])):
        if how == "black":
            colour = jnp.where((index >= 0) & (index < size), colour, 0)
    return colour


def _wrapped(index: Float[Array, " *rays"], size: Float[Array, " *rays"], wrap: TextureWrap) -> Int[Array, " *rays"]:
    within = index - size * jnp.floor(index / size) if wrap == "repeat" else index
    return jnp.clip(within, 0, size - 1).astype(jnp.int32)


def _mix(
    a: Float[Array, "3 *rays"], b: Float[Array, "3 *rays"], share: Float[Array, " *rays"]
) -> Float[Array, "3 *rays"]:
    return a + share * (b - a)
