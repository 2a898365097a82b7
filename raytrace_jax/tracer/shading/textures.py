"""Textures as a scene has them on its shapes: which one each hit sees, where on it, and its colour there.

A new type of texture is a struct in `scene.structs`, a row in `scene.table`, its look-up, and a row here.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.parameters import blocks_of, material_of, shape_blocks
from raytrace_jax.scene.scene import Checkers, Images, Scene
from raytrace_jax.scene.schema import NO_BLOCK
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import Vectors, take
from raytrace_jax.tracer.geometry.shape_types import present_types
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.shading.checker_texture import checker_fraction
from raytrace_jax.tracer.shading.image_texture import Pyramid, image_colors, make_pyramid
from raytrace_jax.util.numerics import dot, per_ray, select


class Textures(eqx.Module):
    """The textures of a scene.

    Args:
        pyramids: of each image; of one level where only points are looked up.
        of_shape: of each shape in the order of the file the column of its texture, or `NO_BLOCK`.
        column: the group and the place in it of each texture, as columns count them.
    """

    checkers: Checkers
    images: Images
    pyramids: tuple[Pyramid, ...]
    of_shape: tuple[int, ...] = eqx.field(static=True)
    column: tuple[tuple[str, int], ...] = eqx.field(static=True)


class Place(NamedTuple):
    """The position of a hit on its shape, and how that changes over the footprint.

    Args:
        along: along the shape's two directions from its position, in world units.
        half: half the shape's size along these.
        axes: derivatives of `along` along the footprint's two axes, "axis direction"; None for points.
    """

    along: Float[Array, "2 *rays"]
    half: Float[Array, "2 *rays"]
    axes: Float[Array, "2 2 *rays"] | None


def prepare_pyramids(scene: Scene, edges: EdgeMode | None) -> tuple[Pyramid, ...]:
    """The pyramid of each of a scene's pictures. Points need no coarser pictures, footprints do."""
    levels = None if edges == "aware" else 1
    return tuple(make_pyramid(texels, levels=levels) for texels in scene.images.texels)


def prepare_textures(scene: Scene, pyramids: tuple[Pyramid, ...]) -> Textures | None:
    """The textures of a scene, None where it has none, with the pyramids of its pictures."""
    found = blocks_of(scene, "texture")
    if not found:
        return None
    of_shape = tuple(material_of(scene, shape).read(scene, "texture") for shape in shape_blocks(scene))
    column = tuple((block.type.group, int(block.column or 0)) for block in found)
    return Textures(scene.checkers, scene.images, pyramids, of_shape, column)


def texture_colors(
    textures: Textures, shapes: Shapes, hits: Hits, footprint: Float[Array, "2 3 *rays"] | None
) -> Vectors:
    """The colour of the texture at each hit, 1 where there is none.

    Args:
        footprint: derivatives of the hit point along the axes of the area that each hit stands for; None for points.
    """
    place = place_on(take(shapes, hits.shape), hits, footprint)
    color = jnp.ones_like(hits.p)
    for column in sorted(set(textures.of_shape) - {NO_BLOCK}):
        here = jnp.asarray(np.array(textures.of_shape) == column)[hits.shape]
        group, entry = textures.column[column]
        color = jnp.where(here, LOOK_UPS[group](textures, entry, place), color)
    return color


def place_on(shape: Shapes, hits: Hits, footprint: Float[Array, "2 3 *rays"] | None) -> Place:
    """The positions of hits on their shapes, one shape a ray; anywhere on those that have no mapping."""
    none = jnp.zeros_like(hits.p)
    directions, half = jnp.stack([none, none]), jnp.ones((2, *hits.t.shape), hits.t.dtype)
    for number, shape_type in present_types(shape):
        if shape_type.frame is not None:
            directions, half = select(shape.type == number, shape_type.frame(shape), (directions, half))
    away = hits.p - shape.position
    along = jnp.stack([dot(direction, away) for direction in directions])
    axes = None
    if footprint is not None:
        fixed = jax.lax.stop_gradient(directions)
        axes = jnp.stack([jnp.stack([dot(direction, axis) for direction in fixed]) for axis in footprint])
    return Place(along, half, axes)


def checker_color(textures: Textures, entry: int, place: Place) -> Vectors:
    """The colour of a checker at places."""
    checkers, ray_axes = textures.checkers, place.along.ndim - 1
    square, offset = checkers.square[entry], checkers.offset[:, entry].reshape(2, *(1,) * ray_axes)
    fraction = checker_fraction(place.along, place.axes, square, offset)
    first, second = (per_ray(color[:, entry], ray_axes) for color in (checkers.color1, checkers.color2))
    return second + fraction * (first - second)


def image_color(textures: Textures, entry: int, place: Place) -> Vectors:
    """The colour of a picture at places."""
    images, pyramid = textures.images, textures.pyramids[entry]
    kind, wrap = images.filter[entry], images.wrap[entry]
    # What has no end has no mapping: these hits are another texture's.
    half = jnp.where(jnp.isfinite(place.half), place.half, 1)
    u, v = (place.along / half + 1) / 2
    axes = None if place.axes is None else place.axes / (2 * jax.lax.stop_gradient(half))
    return image_colors(pyramid, u, v, axes, kind=kind, wrap=wrap)


LOOK_UPS: dict[str, Callable[[Textures, int, Place], Vectors]] = {
    "checkers": checker_color,
    "images": image_color,
}
"""For each group of textures the colour of one of them at places."""
