"""A shading model: what it takes of a hit, and what it gives to the tracer; and what models share: light and textures.

Each shape has a *clearance*, a smooth function of the point that is lit: positive where the shape does not cut the way
to the light, zero on the edge of its shadow. A single point is lit or not; of a footprint
`footprints.positive_fractions` makes of the clearances at its four nodes the fraction that is lit, and with it the
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
from ..geometry.footprints import positive_fractions
from ..geometry.intersection import SurfaceInteraction
from ..geometry.rays import (
    Axes,
    Flags,
    Integers,
    NodeScalars,
    NodeVectors,
    Number,
    Rays,
    Scalars,
    Vector,
    Vectors,
    take,
)
from ..geometry.shape_types import fold_shapes
from ..geometry.shapes import Faces, ShapeType
from ..geometry.solid import belongs
from ..world import World
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


class Surface(eqx.Module):
    """What a surface shows and sends on, kept until the colours of the rays that it sends on are known."""

    local: Vectors  # Light of its own.
    mirror: Scalars  # Weight of the reflected ray.
    through: Scalars  # Weight of the transmitted ray.

    def combine(self, reflected: Vectors, transmitted: Vectors) -> Vectors:
        """The colour of each hit, from the colours of the rays that it sent on (black for none)."""
        return self.local + self.mirror * reflected + self.through * transmitted

    def child_weights(self) -> tuple[Scalars, Scalars]:
        """About how much the reflected and the transmitted ray count in it, in the largest channel."""
        return self.mirror, self.through


def black(world: World, rays: Rays) -> Float[Array, "3 *ones"]:
    return jnp.zeros((3,) + (1,) * (rays.d.ndim - 1), rays.d.dtype)


class Model(NamedTuple):
    """A model of what light does at surfaces and between them; its rules for paths are `settings.MODEL_RULES`."""

    # What a surface shows of its own, and the rays that it sends on: of hits, rays, the world, the media and the
    # material at each hit, and quadrature nodes in each footprint (hits for points).
    shade: Callable[..., tuple[Any, Children]]
    transparency: Callable[[Any], Scalars]  # Of materials, how much of what shines through counts.
    media: Callable[[World, SurfaceInteraction, Flags], Media]  # At hits; and whether the ray enters.
    background: Callable[[World, Rays], Float[Array, "3 *#rays"]] = black  # What rays that hit nothing see.


def materials_at(world: World, si: SurfaceInteraction, footprint: Axes | None = None) -> Any:
    """The material at each hit, with emission and diffuse colour scaled by a texture; `footprint` as it wants it."""
    material = take(world.materials, si.shape)
    if world.textures is None:
        return material
    color = texture_colors(world.textures, world.shapes, si, footprint)
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
    origins: NodeVectors,
    own: Integers,
    light: Vector,
    facing: Flags,
    world: World,
    clear: Float[Array, " shapes"] | None = None,
) -> NodeScalars:
    """The fraction of each node's part of the footprint from which a light is seen; for a single point 0 or 1.

    Args:
        origins: where the nodes' shadow rays start, a little off the surface.
        own: the shape on which they lie.
        facing: whether a hit is on the side that its shape's normal points to. From there the shape's own shadow is
            where the light stands below the surface: the caller takes care of that.
        clear: which fraction of the light each shape lets through; None where none of them lets any.
    """

    def ask(shape_type: ShapeType, faces: Faces, index):
        clearance = shape_type.clearance(origins, light, faces, world.unit) / world.unit
        # A flat shape never stands in the way of its own points.
        ignored = belongs(own, index, shape_type.face_count) & (facing if shape_type.curved else True)
        fraction = positive_fractions(clearance)
        if clear is not None:
            fraction += clear[index] * (1 - fraction)
        return jnp.where(faces[0].is_met & ~ignored, fraction, 1)

    return fold_shapes(world.shapes, ask, operator.mul, jnp.ones_like(origins[0]))
