"""A shading model: what it takes of a hit, and what it gives to the tracer; and what models share: light and textures.

Each shape has a *clearance*, a smooth function of the point that is lit: positive where the shape does not cut the way
to the light, zero on the edge of its shadow. A single point is lit or not; of a footprint
`quadrature.positive_fractions` makes of the clearances at its four nodes the fraction that is lit, and with it the
derivative of shadow edges.
"""

import operator
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...scene.scene import PointLights
from ...util.numerics import dot, vectors_to
from ..geometry.intersection import Hits
from ..geometry.rays import Axes, Flags, Integers, Number, Rays, Scalars, Vector, Vectors, take
from ..geometry.shape_types import fold_shapes
from ..geometry.shapes import ShapeType
from ..resolved_settings import ResolvedSettings
from ..world import World
from .quadrature import positive_fractions
from .textures import texture_colors

T = TypeVar("T")


class Children(eqx.Module):
    """The rays that a hit sends on: directions of a reflected and a transmitted one, and which of them are wanted."""

    reflect: Flags
    transmit: Flags
    reflected: Vectors
    transmitted: Vectors
    entering: Flags  # Whether it was hit on the side that its normal points to.
    off: Vectors | None = None  # The way by which they start off the surface, with no shape as their origin.


class Media(NamedTuple):
    """The media on both sides of a hit."""

    eta: Scalars  # `eta_t / eta_i`, the index behind the surface over that in front of it.
    front: Integers | None = None  # The shape whose medium the ray ran through, or `NO_SHAPE`; None without media.
    transmittance: Vectors | None = None  # The fraction of radiance that it lets through.


class Model(NamedTuple):
    """A model of what light does at surfaces and between them; its rules for paths are `settings.MODEL_RULES`."""

    # What a surface shows of its own, and the rays that it sends on: of hits, rays, the world, the media and the
    # material at each hit, settings, and quadrature nodes in each footprint (hits for points). Its `Surface` is kept
    # until the colours of these rays are known.
    shade: Callable[..., tuple[Any, Children]]
    combine: Callable[[Any, Array, Array], Vectors]  # The colour of each hit, from these colours (black for none).
    child_weights: Callable[[Any], tuple[Array, Array]]  # About how much both rays count in it, in the largest channel.
    transparency: Callable[[Any], Scalars]  # Of materials, how much of what shines through counts.
    media: Callable[[World, Hits, Flags, ResolvedSettings], Media]  # At hits; and whether the ray enters.
    background: Callable[[World, Rays], Float[Array, "3 *#rays"]]  # What rays that hit nothing see.


def black(world: World, rays: Rays) -> Float[Array, "3 *ones"]:
    return jnp.zeros((3,) + (1,) * (rays.d.ndim - 1), rays.d.dtype)


def materials_at(world: World, hits: Hits, footprint: Axes | None = None) -> Any:
    """The material at each hit, with emission and diffuse colour scaled by a texture; `footprint` as it wants it."""
    material = take(world.materials, hits.shape)
    if world.textures is None:
        return material
    color = texture_colors(world.textures, world.shapes, hits, footprint)
    return material._replace(emission=material.emission * color, diffuse=material.diffuse * color)


class LightSample(NamedTuple):
    """One light as seen from points."""

    toward: Vectors  # Vectors from the points to the light, as long as that is far, in world units.
    squared_distance: Scalars  # The square of their length; 1 where a point lies in the light itself.
    location: Vector
    emissivity: Vector
    energy: Number  # What scales its light in the additive model.

    @property
    def direction(self) -> Vectors:
        return self.toward * self.inverse_distance

    @property
    def inverse_distance(self) -> Scalars:
        return jax.lax.rsqrt(self.squared_distance)


def over_lights(answer: Callable[[LightSample], T], lights: PointLights, p: Vectors) -> T:
    """The answers of all lights as seen from points `p`, the lights on the first axis."""

    def one(location: Vector, emissivity: Vector, energy: Number) -> T:
        toward = vectors_to(location, p)
        squared = dot(toward, toward)
        return answer(LightSample(toward, jnp.where(squared > 0, squared, 1), location, emissivity, energy))

    return jax.vmap(one, in_axes=-1)(lights.location, lights.emissivity, lights.energy)


def light_fractions(
    origins: Float[Array, "3 *nodes rays"],
    own: Integers,
    light: Vector,
    facing: Flags,
    world: World,
    settings: ResolvedSettings,
    clear: Float[Array, " shapes"] | None = None,
) -> Float[Array, "*nodes rays"]:
    """The fraction of each node's part of the footprint from which a light is seen; for a single point 0 or 1.

    Args:
        origins: where the nodes' shadow rays start, a little off the surface.
        own: the shape on which they lie.
        facing: whether a hit is on the side that its shape's normal points to. From there the shape's own shadow is
            where the light stands below the surface: the caller takes care of that.
        clear: which fraction of the light each shape lets through; None where none of them lets any.
    """
    shapes = world.shapes

    def ask(shape_type: ShapeType, index):
        shape = jax.tree.map(lambda values: values[..., index], shapes)
        clearance = shape_type.clearance(origins, light, shape, world.unit, settings) / world.unit
        # A flat shape never stands in the way of its own points.
        ignored = (own == index) & (facing if shape_type.curved else True)
        ignored = ignored if shape.hidden is None else ignored | shape.hidden
        fraction = positive_fractions(clearance)
        if clear is not None:
            fraction += clear[index] * (1 - fraction)
        return jnp.where(ignored, 1, fraction)

    return fold_shapes(shapes.types, ask, operator.mul, jnp.ones_like(origins[0]))
