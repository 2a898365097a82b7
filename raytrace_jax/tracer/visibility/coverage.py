"""Area, centroid and width of the part of a pixel on one side of a straight edge.

A pixel is the unit square around the origin of its own coordinates (u, v). An edge is a line with unit normal
`(n_u, n_v)` at signed distance `d` from the centre, positive when the centre is on the side that is asked for. Then
`q = d + n.x` is the distance of a point x from the edge. Over the square q is d plus the sum of two independent uniform
numbers, of widths `a = |n_u|` and `b = |n_v|`. So the mean over the square of any f(q) is a second difference of F, the
second antiderivative of f:

    D[F] = (F(d + h+) + F(d - h+) - F(d + h-) - F(d - h-)) / (a b),   h+- = (a +- b) / 2.

The derivative of the area by d is the density of q at the edge. That is the length of the edge inside of the pixel: the
weight of a moving edge in the pixel's derivative (`look`).
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from ...util.numerics import TINY_32, dot, select
from ..geometry import shapes
from ..geometry.rays import Flags, Pairs, Rays, Scalars
from ..geometry.shapes import Approach, Edge, Shapes
from ..geometry.solid import chord


class SurfaceAhead(eqx.Module):
    shape: Shapes
    curved: Flags
    t: Scalars
    side: Scalars  # Sign of the cosine of incidence, as in `shapes.divisor`.
    approach: Approach


def occlusion_edge(rays: Rays, near: SurfaceAhead, behind: SurfaceAhead, exists: Flags) -> Edge:
    """The edge where two surfaces are equally far and change places; `near` is the nearer one.

    The plain event function is the difference of the distances. But where a ray grazes a sphere, the sphere's distance
    changes without bound. For a sphere that is seen from outside the event function is therefore the sphere's own
    function F at the point where the ray meets the other surface: it has the same zero, and stays smooth at the rim.
    """
    fixed_rays, fixed_near, fixed_behind = stop_gradient((rays, near, behind))
    along = chord(fixed_rays.o, fixed_rays.d, fixed_near.shape).along
    # The nearer sphere's F tells which surface comes first only before the sphere's middle, at `along`: beyond it F
    # grows again towards the far side of the sphere.
    by_near = (near.side < 0) & near.curved & (fixed_behind.t < along)
    by_behind = (behind.side < 0) & behind.curved & ~by_near

    # The sphere whose function is taken, and the other surface, whose point it is taken at.
    sphere = select(by_near, near.shape, behind.shape)
    fixed_sphere = stop_gradient(sphere)
    t = jnp.where(by_near, behind.t, near.t)
    fixed_t = stop_gradient(t)
    other = select(by_near, behind.approach, near.approach)
    # Positive where `near` is first: the other point is inside of the nearer sphere, or outside of the one behind.
    sign = jnp.where(by_near, -1, 1)
    # Chain rule over the footprint: F changes with the point, which moves across the ray and along it.
    n = shapes.surface_normal(fixed_rays.o + fixed_t * fixed_rays.d, fixed_sphere)
    cos = dot(n, fixed_rays.d)
    slope = sign * (jnp.sum(n * (rays.footprint.o + fixed_t * rays.footprint.d), 1) + cos * other.slope)
    by_function = by_near | by_behind
    value = jnp.where(by_function, sign * shapes.surface_value(rays.o + t * rays.d, sphere), behind.t - near.t)
    radius = 1 / jnp.where(by_function, fixed_sphere.curvature, 1)
    fraction = jnp.where(
        by_function,
        jnp.minimum(shapes.fraction_of_radius(slope, radius), other.fraction),
        jnp.minimum(near.approach.fraction, behind.approach.fraction),
    )
    slope = jnp.where(by_function, slope, behind.approach.slope - near.approach.slope)
    return Edge(value, slope, fraction, exists)


def edge_distance(edge: Edge):
    """Signed distance of the edge from the footprint's centre, its unit normal, and the fraction of the footprint used.

    Only the fraction s of the footprint in which the event function is linear is split. Without damping that fraction
    of the rays would meet the edge, each with a derivative 1 / s times as large: right in the mean, but few rays would
    carry all of it. So the derivative is damped by a factor c. An estimate that is c D / s with probability s, else 0,
    has the mean square error `D^2 (c^2 / s - 2 c + 1)` for a mean D, which is least at c = s.
    """
    # To first order a point at x has the value g + slope.x: the edge is a line at the distance g / |slope|. TINY_32
    # guards the root's derivative where the slope is 0.
    steepness = jnp.sqrt(jnp.sum(edge.slope * edge.slope, 0) + TINY_32)
    direction = edge.slope / steepness
    direction, fraction = stop_gradient((direction, edge.fraction))
    unit = steepness * fraction
    distance = edge.value / unit
    # The value stays as it is; only its derivative is damped.
    fixed = stop_gradient(distance)
    return fixed + fraction * (distance - fixed), direction, fraction, unit


def most_central(edges: list[Edge]):
    """`edge_distance` of the edge whose signed distance is smallest.

    Signed, not absolute: an edge beyond which the centre lies hides the surface there, whatever the others do.
    """

    def nearer(best, other):
        return tuple(jnp.where(other[0] < best[0], new, old) for new, old in zip(other, best, strict=True))

    found = [(edge, *edge_distance(edge)) for edge in edges]
    # An edge that does not exist is far away: edges cut footprints at distances below 1.
    return functools.reduce(nearer, [(jnp.where(edge.exists, d, 1e6), *rest) for edge, d, *rest in found])


class Cut(eqx.Module):
    """A pixel cut in two by an edge: the near part, where the edge's distance is positive, and the far part."""

    area: Scalars  # Fraction of the near part in the pixel.
    shift: Pairs  # Positions of both parts' centroids along the edge's normal, in pixels from the pixel's centre.
    width: Pairs  # Standard deviations of both parts along the normal, as fractions of the whole pixel's.


def reach(normal: Pairs) -> Scalars:
    """The largest distance at which an edge of this direction still cuts more of the pixel than a corner."""
    a, b = sides(normal)
    return 0.9995 * ((a + b) / 2)


def sides(normal: Pairs) -> tuple[Scalars, Scalars]:
    """Extents `a = |n_u|` and `b = |n_v|` of the pixel's sides along the edge's normal, each 0.03 at least.

    The second difference divides by `a b`: its area has an error of about epsilon / (a b). An edge that is nearer to
    parallel with a side is turned by so much: on the border of two pixels, as between the course's walls in pictures of
    even width, both could otherwise take all of it, or none.
    """
    a, b = (jnp.maximum(jnp.abs(n), 0.03) for n in (normal[0], normal[1]))
    return a, b


def cut_pixel(d: Scalars, normal: Pairs) -> Cut:
    """Cut pixels by edges at distance `d`; an edge that misses its pixel leaves one part whole.

    Differentiable with respect to `d`; the normals and widths are taken as constants.
    """
    # Seen from the far side the edge lies at -d. Means are distances from the edge, shifts are from the pixel's centre.
    side = jnp.asarray([1.0, -1.0], d.dtype).reshape(2, *(1,) * d.ndim)
    area, mean, width = half_plane(side * d, *sides(stop_gradient(normal)))
    return Cut(area[0], side * mean - d, width)


@jax.custom_jvp
def half_plane(d: Pairs, a: Scalars, b: Scalars) -> tuple[Pairs, Pairs, Pairs]:
    """Area of the part with q > 0, mean of q over it, and its width along the normal as a fraction of the pixel's.

    The sides extend by `a` and `b` along the normal; widths are constants.
    """
    return _moments(d, a, b)[0]


@half_plane.defjvp
def _half_plane_jvp(primals, tangents):
    found, slopes = _moments(*primals)
    return found, (*(slope * tangents[0] for slope in slopes), jnp.zeros_like(found[2]))


def _moments(d, a, b) -> tuple[tuple[Pairs, Pairs, Pairs], tuple[Array, Array]]:
    """The moments by second differences, and the derivatives of area and mean by the distance.

    With `F_k(x) = max(x, 0)^k / k!`, and the square's corners at distances x_i from the edge with signs s_i = u_i v_i,

        D[F_k] = sum_i s_i F_k(x_i) / (a b),
        A = D[F_2],  E[q] = D[F_3] / A,  E[q^2] = 2 D[F_4] / A,  dA/dd = D[F_1],  dE[q]/dd = 1 - E[q] D[F_1] / A.

    (Heckbert 1986, "Filtering by repeated integration": a box filter is a difference of an antiderivative.)
    """
    # The square's corners: x is their distance from the edge, and corners beyond the edge add nothing.
    u, v = (jnp.asarray(x, d.dtype).reshape(4, *(1,) * d.ndim) for x in ((1, -1, 1, -1), (1, -1, -1, 1)))
    x = jnp.maximum(d + (u * a + v * b) / 2, 0)
    weighted, scale = u * v * x, 1 / (a * b)
    length, twice_area, cubes, fourths = (scale * jnp.sum(weighted * x**power, 0) for power in range(4))
    # Where the edge misses the pixel the part is all or nothing, without the rounding of the differences.
    cuts = 2 * jnp.abs(d) < a + b
    area = jnp.where(cuts, twice_area / 2, jnp.where(d > 0, 1, 0))
    enough = area > 1e-5  # Smaller parts count as a point on the edge; 1e-7 to 1e-3 do the same.
    inverse = 1 / jnp.where(enough, area, 1)
    mean = jnp.where(enough, jnp.where(cuts, cubes / 6 * inverse, d), 0)
    # E[q^2] is twice D[F_4] / A: x^4 / 12. The whole pixel's variance is that of both uniform numbers.
    whole = (a * a + b * b) / 12
    # A part keeps a millionth of the variance at least, so that no footprint becomes a line.
    variance = jnp.where(cuts, fourths / 12 * inverse - mean * mean, whole)
    width = jnp.sqrt(jnp.clip(variance, 1e-6 * whole, whole) / whole)
    length = jnp.where(cuts, length, 0)
    mean_slope = jnp.where(enough, 1 - jnp.where(cuts, mean * length * inverse, 0), 0)
    return (jnp.clip(area, 0, 1), mean, width), (length, mean_slope)
