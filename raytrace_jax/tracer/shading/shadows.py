"""What share of a point light reaches a hit past the shapes in between: all or nothing, or parts of a footprint.

Each shape has a *clearance*, a smooth function of the point that is lit: positive where the shape does not cut the way
to the light, zero on the edge of its shadow. A single point is lit or not; of a footprint `nodes.node_shares` makes
of the clearances at its four nodes the share that is lit, and with it the derivative of shadow edges.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.intersection import UNROLL
from raytrace_jax.tracer.geometry.shapes import Shapes, dot_fixed
from raytrace_jax.tracer.shading.quadrature import node_shares
from raytrace_jax.util.numerics import away_from_zero, dot, safe_sqrt

Vectors = Float[Array, "3 *rays"]


def light_shares(
    origins: Float[Array, "3 nodes *rays"],
    own: Int[Array, " *rays"],
    light: Float[Array, "3"],
    facing: Bool[Array, " *rays"],
    shapes: Shapes,
) -> Float[Array, "nodes *rays"]:
    """For each node the share of its part of the footprint from which a light is seen; of one node 0 or 1.

    Args:
        origins: where the nodes' shadow rays start, a little off the surface.
        own: index of the shape on which they lie.
        light: where the light is.
        facing: whether a hit is on the side that its shape's normal points to. From there the shape's own shadow is
            where the light stands below the surface, which the caller knows; it is not told again.
        shapes: all shapes of the scene.
    """

    def multiply(shares, index, is_sphere):
        shape = jax.tree.map(lambda values: values[..., index], (shapes.position, shapes.normal, shapes.radius))
        clearance = (sphere_clearance if is_sphere else plane_clearance)(origins, light, *shape)
        told = (own == index) & (facing if is_sphere else True)
        return shares * jnp.where(told, 1, node_shares(clearance))

    shares = jnp.ones_like(origins[0])
    if len(shapes.is_sphere) <= UNROLL:
        for index, is_sphere in enumerate(shapes.is_sphere):
            shares = multiply(shares, index, is_sphere)
        return shares
    for kind in (False, True):
        indices = [index for index, is_sphere in enumerate(shapes.is_sphere) if is_sphere is kind]
        if indices:
            step = lambda shares, index, kind=kind: (multiply(shares, index, kind), None)  # noqa: E731
            shares, _ = jax.lax.scan(step, shares, jnp.asarray(indices, jnp.int32))
    return shares


def sphere_clearance(
    o: Vectors, light: Float[Array, "3"], center: Float[Array, "3"], normal: Float[Array, "3"], radius: Float[Array, ""]
) -> Float[Array, " *rays"]:
    """How far the way from `o` to a light stays outside of a sphere; of a light within it, how far `o` is inside."""
    toward, toward_center = along(light, o), along(center, o)
    length_squared = dot(toward, toward)
    share = dot(toward_center, toward) / jnp.where(length_squared > 0, length_squared, 1)
    nearest = toward_center - jnp.clip(share, 0, 1) * toward
    from_light = light - center
    light_inside = from_light[0] ** 2 + from_light[1] ** 2 + from_light[2] ** 2 < radius * radius
    within = radius - safe_sqrt(dot(toward_center, toward_center))
    return jnp.where(light_inside, within, safe_sqrt(dot(nearest, nearest)) - radius)


def plane_clearance(
    o: Vectors, light: Float[Array, "3"], point: Float[Array, "3"], normal: Float[Array, "3"], radius: Float[Array, ""]
) -> Float[Array, " *rays"]:
    """How far `o` is on the light's side of a plane; where it is not, how far before z = 0, where planes end."""
    light_height, height = dot_fixed(normal, light - point), -dot_fixed(normal, along(point, o))
    same_side = height * jnp.where(light_height < 0, -1, 1)
    # Where the way crosses the plane: not worth asking on the same side, where it may be nowhere.
    share = height / away_from_zero(height - light_height, 1e-9)
    crossing_z = o[2] + jnp.clip(share, 0, 1) * (light[2] - o[2])
    return jnp.where(same_side > 0, same_side, jnp.maximum(same_side, crossing_z))


def along(end: Float[Array, "3"], o: Vectors) -> Vectors:
    """Vectors from many points to one."""
    return end.reshape((3,) + (1,) * (o.ndim - 1)) - o
