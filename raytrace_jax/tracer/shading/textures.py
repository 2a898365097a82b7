"""Textures as a scene has them on its shapes: which one each hit sees, where on it, its colour there; and checkers.

A new type of texture is a struct in `scene.structs`, a row in `scene.table`, its look-up, and a row here.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...scene.parameters import blocks_of, material_of, shape_blocks
from ...scene.scene import Checkers, Images, Scene
from ...scene.schema import NO_BLOCK
from ...scene.setting_words import EdgeMode
from ...util.numerics import clamp01, dot, instantiated, is_zero, per_ray, select, with_lower_ranks
from ..geometry.footprints import parts
from ..geometry.intersection import SurfaceInteraction
from ..geometry.rays import Axes, PairAxes, Pairs, Scalars, Vectors, take
from ..geometry.shape_types import per_face, present_types
from ..geometry.shapes import Shapes
from .image_texture import Pyramid, image_colors, make_pyramid


class Textures(eqx.Module):
    checkers: Checkers
    images: Images
    pyramids: tuple[Pyramid, ...]  # Of each image; of one level where only points are looked up.
    of_face: tuple[int, ...] = eqx.field(static=True)  # The column of each face's texture, or `NO_BLOCK`.
    column: tuple[tuple[str, int], ...] = eqx.field(static=True)  # The group of each texture, and its place in it.


class Place(NamedTuple):
    """The position of a hit on its shape along the shape's two directions, in world units."""

    along: Pairs
    half: Pairs  # Half the shape's size.
    axes: PairAxes | None  # Derivatives over the footprint, "axis direction"; None for points.


def prepare_pyramids(scene: Scene, edges: EdgeMode | None) -> tuple[Pyramid, ...]:
    """The pyramid of each of a scene's pictures. Points need no coarser pictures, footprints do."""
    levels = None if edges == "aware" else 1
    return tuple(make_pyramid(texels, levels=levels) for texels in scene.images.texels)


def prepare_textures(scene: Scene, pyramids: tuple[Pyramid, ...]) -> Textures | None:
    found = blocks_of(scene, "texture")
    if not found:
        return None
    of_shapes = [material_of(scene, shape).read(scene, "texture") for shape in shape_blocks(scene)]
    column = tuple((block.type.group, int(block.column or 0)) for block in found)
    return Textures(scene.checkers, scene.images, pyramids, tuple(per_face(scene, of_shapes)), column)


def texture_colors(textures: Textures, shapes: Shapes, si: SurfaceInteraction, footprint: Axes | None) -> Vectors:
    """The colour of the texture at each hit, 1 where there is none; `footprint` has the hit point's derivatives."""
    place = place_on(take(shapes, si.shape), si, footprint)
    color = jnp.ones_like(si.p)
    for column in sorted(set(textures.of_face) - {NO_BLOCK}):
        here = jnp.asarray(np.array(textures.of_face) == column)[si.shape]
        group, entry = textures.column[column]
        color = jnp.where(here, LOOK_UPS[group](textures, entry, place), color)
    return color


def place_on(shape: Shapes, si: SurfaceInteraction, footprint: Axes | None) -> Place:
    """The positions of hits on their shapes, one shape a ray; anywhere on those that have no mapping."""
    none = jnp.zeros_like(si.p)
    directions, half = jnp.stack([none, none]), jnp.ones((2, *si.t.shape), si.t.dtype)
    for number, shape_type in present_types(shape):
        if shape_type.frame is not None:
            directions, half = select(shape.type == number, shape_type.frame(shape), (directions, half))
    away = si.p - shape.position
    along = jnp.stack([dot(direction, away) for direction in directions])
    axes = None
    if footprint is not None:
        fixed = jax.lax.stop_gradient(directions)
        axes = jnp.stack([jnp.stack([dot(direction, axis) for direction in fixed]) for axis in footprint])
    return Place(along, half, axes)


def checker_color(textures: Textures, entry: int, place: Place) -> Vectors:
    checkers, ray_axes = textures.checkers, place.along.ndim - 1
    square, offset = checkers.square[entry], checkers.offset[:, entry].reshape(2, *(1,) * ray_axes)
    fraction = checker_fraction(place.along, place.axes, square, offset)
    first, second = (per_ray(color[:, entry], ray_axes) for color in (checkers.color1, checkers.color2))
    return second + fraction * (first - second)


def image_color(textures: Textures, entry: int, place: Place) -> Vectors:
    images, pyramid = textures.images, textures.pyramids[entry]
    kind, wrap = images.filter[entry], images.wrap[entry]
    # What has no end has no mapping: these hits are another texture's.
    half = jnp.where(jnp.isfinite(place.half), place.half, 1)
    u, v = (place.along / half + 1) / 2
    axes = None if place.axes is None else place.axes / (2 * jax.lax.stop_gradient(half))
    return image_colors(pyramid, u, v, axes, kind=kind, wrap=wrap)


LOOK_UPS: dict[str, Callable[[Textures, int, Place], Vectors]] = {"checkers": checker_color, "images": image_color}
"""For each group of textures the colour of one of them at positions."""


# A checker's first colour is where floor(x) + floor(y) is even, with (x, y) = (position - offset) / square. In terms of
# the square wave s(x), 1 from 0 to 1 and -1 from 1 to 2, its fraction is (1 + s(x) s(y)) / 2.


def checker_fraction(position: Pairs, axes: Array | None, square: Array, offset: Array) -> Scalars:
    """The fraction of the first colour in parallelograms; at points it is 0 or 1, and its derivative 0.

    The mean of s(x) s(y) over a part is E[s(x)] E[s(y)] + cov(x, y) E[s'(x)] E[s'(y)]: Price's theorem to first
    order in the covariance, without which it would hold for parts along x and y only.

    Args:
        axes: derivatives of the position along a footprint's two axes (axis, coordinate); it reaches half of them both
            ways. None for points.
    """
    place = (position - offset) / square
    if axes is None:
        return 1 - jnp.abs(jnp.sum(jnp.floor(place), 0)) % 2
    # 4 x 4 parts, 8 x 2 for long footprints. Up to two squares wide the worst error is .019 (.039 for a skew
    # footprint of four squares); with 2 x 2 or 4 x 1 parts it is .071. The derivative by place is .99 to 1.03 of the
    # true one in the mean, and off by a tenth to a quarter in single footprints. The first order may go a little
    # beyond 0 and 1.
    return clamp01((1 + mean_product(place, axes / square)) / 2)


@jax.custom_jvp
def mean_product(place: Pairs, axes: PairAxes) -> Scalars:
    return _mean_and_slopes(place, axes)[0]


def _mean_product_jvp(primals, tangents):
    (place, axes), (place_dot, axes_dot) = primals, tangents
    if not is_zero(axes_dot):
        # The squares' size changes.
        return jax.jvp(lambda *given: _mean_and_slopes(*given)[0], primals, instantiated(tangents))
    # The derivatives by place once, not of each part for each direction.
    mean, slopes = _mean_and_slopes(place, axes)
    return mean, jnp.sum(slopes * place_dot, 0)


mean_product.defjvp(with_lower_ranks(_mean_product_jvp), symbolic_zeros=True)


def _mean_and_slopes(place: Pairs, axes: PairAxes) -> tuple[Scalars, Pairs]:
    middles, sides = parts(axes, 4)
    value, slope, bend = _square_wave(place[:, None] + jnp.moveaxis(middles, 0, 1), *sides)
    covariance = jnp.sum(jnp.prod(sides, axis=1), 0) / 12
    terms = jnp.prod(value, 0) + covariance * jnp.prod(slope, 0)
    slopes = slope * value[::-1] + covariance * bend * slope[::-1]
    # A product with equal weights is one kernel: of sums of slices XLA computes all parts anew in each.
    weights = jnp.full(terms.shape[0], 1 / terms.shape[0], terms.dtype)
    each = [jnp.tensordot(weights, x, 1, precision=jax.lax.Precision.HIGHEST) for x in (terms, *slopes)]
    return each[0], jnp.stack(each[1:])


def _square_wave(x: Float[Array, "2 parts *rays"], a: Pairs, b: Pairs) -> tuple[Array, ...]:
    """The mean of the square wave over the trapezoids that a parallelogram with extents a and b has on x and on y.

    And its slope, and how the slope changes.
    """
    a, b = jnp.abs(a), jnp.abs(b)
    # The lesser extent counts as at least so much of the larger one: differences are divided by both.
    least_ratio = 3e-3
    # No footprint is narrower than a millionth of a square, so that it has a derivative at an edge.
    wide = jnp.maximum(jnp.maximum(a, b), 1e-6)
    narrow = jnp.maximum(jnp.minimum(a, b), least_ratio * wide)
    near = _at_one_edge(x, wide[:, None], narrow[:, None])
    far = _at_many_edges(x, jnp.maximum(wide, 0.5)[:, None], jnp.maximum(narrow, 0.5 * least_ratio)[:, None])
    return select((wide + narrow < 1)[:, None], near, far)


def _at_one_edge(x, wide, narrow) -> tuple[Array, ...]:
    """The wave where no more than the nearest edge is seen: the mean over `narrow` of a ramp as wide as `wide`."""
    edge = jnp.round(x)
    sign = (1 - 2 * (jnp.abs(edge) % 2)) / narrow
    low, high, half = x - edge - narrow / 2, x - edge + narrow / 2, wide / 2
    start, end = jnp.clip(-half, low, high), jnp.clip(half, low, high)
    ramp = (end - start) * (end + start) / wide
    steep = sign * 2 / wide
    # Within the ramp both ends move with x, and the slope stays.
    beyond = [(end < low) | (end > high) for end in (half, -half)]
    moves = beyond[0].astype(x.dtype) - beyond[1].astype(x.dtype)
    return sign * (ramp + (high - end) - (start - low)), steep * (end - start), steep * moves


def _at_many_edges(x, wide, narrow) -> tuple[Array, ...]:
    """Second differences of integrals of the wave: well conditioned for wide ones, whatever the number of edges."""
    i, j, sign = jnp.asarray([(i, j, i * j) for i in (0.5, -0.5) for j in (0.5, -0.5)], x.dtype).T
    i, j, sign = (side.reshape(4, *(1,) * x.ndim) for side in (i, j, 4 * sign))
    ends = x + (i * wide + j * narrow)
    phase = ends - 2 * jnp.floor(ends / 2)
    wave = jnp.where(phase < 1, 1, -1)
    triangle = jnp.where(phase < 1, phase, 2 - phase)
    scale = 1 / (wide * narrow)
    integrals = wave * triangle * (triangle - 1) / 2, triangle, wave
    return tuple(scale * jnp.sum(sign * integral, 0) for integral in integrals)
