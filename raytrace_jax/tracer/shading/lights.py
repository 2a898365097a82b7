"""Light on a surface: every light as points ask it, and the fraction of it that reaches a hit past the shapes between.

Each shape has a *clearance*, a smooth function of the point that is lit: positive where the shape does not cut the way
to the light, zero on the edge of its shadow. A single point is lit or not; of a footprint
`quadrature.positive_fractions` makes of the clearances at its four nodes the fraction that is lit, and with it the
derivative of shadow edges.
"""

import operator
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import PointLights
from raytrace_jax.tracer.geometry.rays import Flags, Integers, Number, Scalars, Vector, Vectors
from raytrace_jax.tracer.geometry.shape_types import fold_shapes
from raytrace_jax.tracer.geometry.shapes import ShapeType
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.quadrature import positive_fractions
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import dot, vectors_to

T = TypeVar("T")


class LightSample(NamedTuple):
    """One light as seen from points.

    Args:
        toward: vectors from the points to the light, as long as that is far, in world units.
        squared_distance: the square of their length; 1 where a point lies in the light itself.
        energy: what scales its light in the additive model.
    """

    toward: Vectors
    squared_distance: Scalars
    location: Vector
    emissivity: Vector
    energy: Number

    @property
    def direction(self) -> Vectors:
        """The direction to the light, of length one."""
        return self.toward * self.inverse_distance

    @property
    def inverse_distance(self) -> Scalars:
        """One over the distance: the fall-off of the course's classic model, and what makes `toward` a direction."""
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
        own: index of the shape on which they lie.
        facing: whether a hit is on the side that its shape's normal points to. From there the shape's own shadow is
            where the light stands below the surface: the caller takes care of that.
        clear: for each shape which fraction of the light it lets through; None where none of them lets any.
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
