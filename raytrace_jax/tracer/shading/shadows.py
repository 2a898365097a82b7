"""What share of a point light reaches a hit past the shapes in between: all or nothing, or parts of a footprint.

Each shape has a *clearance*, a smooth function of the point that is lit: positive where the shape does not cut the way
to the light, zero on the edge of its shadow. A single point is lit or not; of a footprint `quadrature.positive_shares`
makes of the clearances at its four nodes the share that is lit, and with it the derivative of shadow edges.
"""

import operator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.dispatch import fold_shapes
from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.quadrature import positive_shares
from raytrace_jax.tracer.world import World


def light_shares(
    origins: Float[Array, "3 *nodes rays"],
    own: Int[Array, " rays"],
    light: Float[Array, "3"],
    facing: Bool[Array, " rays"],
    world: World,
    settings: ResolvedSettings,
    clear: Float[Array, " shapes"] | None = None,
) -> Float[Array, "*nodes rays"]:
    """The share of each node's part of the footprint from which a light is seen; for a single point 0 or 1.

    Args:
        origins: where the nodes' shadow rays start, a little off the surface.
        own: index of the shape on which they lie.
        light: where the light is.
        facing: whether a hit is on the side that its shape's normal points to. From there the shape's own shadow is
            where the light stands below the surface, which the caller knows; it is not told again.
        world: gives all shapes of the scene.
        settings: give the model's rules.
        clear: for each shape which share of the light it lets through; None where none of them lets any.
    """
    shapes = world.shapes

    def ask(kind: ShapeKind, index):
        shape = jax.tree.map(lambda values: values[..., index], shapes)
        clearance = kind.clearance(origins, light, shape, world.unit, settings) / world.unit
        # A flat shape never stands in the way of its own points.
        told = (own == index) & (facing if kind.curved else True)
        share = positive_shares(clearance)
        if clear is not None:
            share += clear[index] * (1 - share)
        return jnp.where(told, 1, share)

    return fold_shapes(shapes.kinds, ask, operator.mul, jnp.ones_like(origins[0]))
