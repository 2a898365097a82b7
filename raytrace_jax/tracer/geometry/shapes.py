"""Planes and spheres as one kind of surface, and where a ray meets them.

Every shape is the zero of `F(p) = normal.(p - position) + curvature/2 (|p - position|^2 - radius^2)`: a plane has
curvature 0, a sphere has normal 0 and curvature 1/radius. On the surface the gradient of F is the outward unit normal,
which gives one formula for the normal and, by the implicit function theorem, one for the derivative of the hit.
"""

import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.numerics import away_from_zero, dot, normalize, safe_sqrt

LEAST_COS = 1e-6
"""A plane is not hit by a ray whose direction is closer than this to parallel (course model, 1.2)."""


class Shapes(eqx.Module):
    """The scene's planes and spheres in the order of the file, as the coefficients of F; `normal` has length one."""

    is_sphere: tuple[bool, ...] = eqx.field(static=True)
    position: Float[Array, "3 *shapes"]
    normal: Float[Array, "3 *shapes"]
    curvature: Float[Array, " *shapes"]
    radius: Float[Array, " *shapes"]


def scene_shapes(scene: Scene) -> Shapes:
    """The coefficients of F for every shape of a scene."""
    planes, spheres = scene.planes, scene.spheres
    no_normal = jnp.zeros_like(spheres.center)
    zeros = jnp.zeros_like(planes.normal[0])
    in_file_order = jnp.asarray(file_order(scene), jnp.int32)
    # A file's normal may have any length: scaled first, its squares neither overflow nor vanish. The scale is only a
    # matter of rounding and has no derivative.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(planes.normal), axis=0))
    normal = normalize(planes.normal / largest)
    return Shapes(
        is_sphere=tuple(name in spheres.names for name in scene.shape_order),
        position=jnp.concatenate([planes.point, spheres.center], 1)[:, in_file_order],
        normal=jnp.concatenate([normal, no_normal], 1)[:, in_file_order],
        curvature=jnp.concatenate([zeros, 1 / spheres.radius])[in_file_order],
        radius=jnp.concatenate([zeros, spheres.radius])[in_file_order],
    )


def file_order(scene: Scene) -> list[int]:
    """For each shape in the order of the file, its place in the list of all planes followed by all spheres."""
    columns = {name: i for i, name in enumerate(scene.planes.names + scene.spheres.names)}
    return [columns[name] for name in scene.shape_order]


def plane_distance(
    o: Float[Array, "3 *rays"], d: Float[Array, "3 *rays"], position: Float[Array, "3"], normal: Float[Array, "3"]
) -> tuple[Float[Array, " *rays"], Bool[Array, " *rays"]]:
    """Distance along each ray to one plane, and whether that is a hit: not parallel, ahead, and not at z > 0."""
    cos = dot_fixed(normal, d)
    t = (dot_fixed(normal, position) - dot_fixed(normal, o)) / away_from_zero(cos, LEAST_COS)
    return t, (jnp.abs(cos) >= LEAST_COS) & (t > 0) & (o[2] + t * d[2] <= 0)


def sphere_distances(
    o: Float[Array, "3 *rays"], d: Float[Array, "3 *rays"], position: Float[Array, "3"], radius: Float[Array, ""]
) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"], Bool[Array, " *rays"]]:
    """Signed distance to the point nearest the centre of one sphere, half the chord there, and whether there is one.

    The discriminant is `r^2 - |oc - (oc.d) d|^2`, the form that loses no digits when the sphere is far away or small
    (Haines et al., Precision improvements for ray/sphere intersection, Ray Tracing Gems, 2019).
    """
    from_center = [o[k] - position[k] for k in range(3)]
    along = -dot(from_center, d)
    across = [from_center[k] + along * d[k] for k in range(3)]
    discriminant = radius * radius - dot(across, across)
    return along, safe_sqrt(discriminant), discriminant > 0


def dot_fixed(a: Float[Array, "3"], b: Float[Array, "3 *rays"]) -> Float[Array, " *rays"]:
    """Inner product of one vector with many."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


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
