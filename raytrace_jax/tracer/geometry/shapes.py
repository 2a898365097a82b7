"""All types of shapes as one type of surface: the zero of an implicit function, whose gradient is the normal.

Every shape lies on the zero of `F(p) = normal.(p - position) + curvature/2 (|p - position|^2 - radius^2)`: a plane has
curvature 0, a sphere has normal 0 and curvature 1/radius. On the surface the gradient of F is the outward unit normal,
which gives one formula for the normal and, by the implicit function theorem, one for the derivative of the hit.
"""

import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from raytrace_jax.util.numerics import away_from_zero, dot, with_lower_ranks

LEAST_COS = 1e-6
"""A flat shape is not hit by a ray whose direction is closer than this to parallel (course model, 1.2)."""


class Shapes(eqx.Module):
    """Shapes as the coefficients of F, `normal` of length one; those of a scene, or one for each ray.

    Args:
        types: the types of the scene's shapes in the order of the file, names of `shape_types.SHAPE_TYPES`.
        type: of each shape the place of its type in that table.
        position, normal, curvature, radius: the coefficients.
        axes: two half-side vectors, along which a shape with sides extends to either side of its position; 0 for
            shapes without, None where the scene has none with.
    """

    types: tuple[str, ...] = eqx.field(static=True)
    type: Int[Array, " *shapes"]
    position: Float[Array, "3 *shapes"]
    normal: Float[Array, "3 *shapes"]
    curvature: Float[Array, " *shapes"]
    radius: Float[Array, " *shapes"]
    axes: Float[Array, "2 3 *shapes"] | None = None


def surface_value(p: Float[Array, "3 *rays"], shape: Shapes) -> Float[Array, " *rays"]:
    """F at points `p`, one shape a ray: negative inside of a sphere, behind a plane."""
    from_position = p - shape.position
    return dot(shape.normal, from_position) + shape.curvature / 2 * (
        dot(from_position, from_position) - shape.radius * shape.radius
    )


def surface_normal(p: Float[Array, "3 *rays"], shape: Shapes) -> Float[Array, "3 *rays"]:
    """The gradient of F: on the surface the outward unit normal; one shape a ray."""
    return shape.normal + shape.curvature * (p - shape.position)


def divisor(
    cos: Float[Array, " *rays"],
    least: Float[Array, " *#rays"] | float,
    side: Float[Array, " *#rays"] | None = None,
) -> Float[Array, " *rays"]:
    """A cosine of incidence to divide by: `cos`, or `least` with its sign where it is smaller in magnitude.

    `side` is the sign where it is known, -1 for a surface that faces the ray: where the ray only just touches a sphere,
    rounding must not choose.
    """
    return away_from_zero(cos, least) if side is None else side * jnp.maximum(side * cos, least)


@jax.custom_jvp
def hit_distance(
    t: Float[Array, " *rays"],
    o: Float[Array, "3 *rays"],
    d: Float[Array, "3 *rays"],
    shape: Shapes,
    least_cos: Float[Array, " *#rays"] | float = LEAST_COS,
    side: Float[Array, " *#rays"] | None = None,
) -> Float[Array, " *rays"]:
    """`t` itself, where it is known to be the distance at which a ray meets its shape, made differentiable.

    `F(o + t d; shape) = 0` gives `dt = -dF / (n.d)`, with dF the change of F at fixed t. It is one division a ray,
    whatever number of shapes had to be searched to find `t`, and it treats near, far and own-chord roots alike.
    At grazing incidence dt is unbounded in truth; the divisor stops at `least_cos`.

    Args:
        t: distances; their own derivative, if they have one, is ignored.
        o, d: origins and unit directions.
        shape: the coefficients of each ray's shape.
        least_cos, side: the least cosine of incidence by which to divide, and its known sign, as in `divisor`.
    """
    return t


@with_lower_ranks
def _hit_distance_jvp(primals, tangents):
    t, o, d, shape, least_cos, side = primals
    _, o_dot, d_dot, shape_dot, *_ = tangents
    p = o + t * d
    n = surface_normal(p, shape)
    from_position = p - shape.position
    # dF term by term; what is not differentiated costs nothing.
    terms = []
    for change, derivative in (
        (o_dot, lambda change: dot(n, change)),
        (d_dot, lambda change: t * dot(n, change)),
        (shape_dot.position, lambda change: -dot(n, change)),
        (shape_dot.normal, lambda change: dot(from_position, change)),
        (shape_dot.radius, lambda change: -shape.curvature * shape.radius * change),
    ):
        if not isinstance(change, jax.custom_derivatives.SymbolicZero):
            terms.append(derivative(change))
    if not terms:
        return t, jnp.zeros_like(t)
    cos = dot(n, d)
    return t, -functools.reduce(operator.add, terms) / divisor(cos, least_cos, side)


hit_distance.defjvp(_hit_distance_jvp, symbolic_zeros=True)
