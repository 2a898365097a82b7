"""The footprint of a ray on a surface: transport to the next one, nodes of its light, and subdivision.

A footprint is linear: a parallelogram of rays. On a curved surface that is true only for a small one. Where a footprint
would be spread by a wide angle, the ray is *subdivided* instead of bounced: three rays, each with a third of the
footprint, start anew from where it came, and their mean is its colour. A wide spread matters only as much as the ray
counts in its pixel, so that the measure is the product of its weight and the square of the angle, the order of what a
linear footprint leaves out.

Means over a footprint are taken from values at the four nodes of `light_nodes`, or from parts of the footprint, so many
that a mean over each is simple.
"""

import dataclasses
import functools
import operator

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from ...util.numerics import TINY_32, away_from_zero, clamp01, dot, safe_normalize
from ..settings import SUBDIVISIONS
from .intersection import Nodes, SurfaceInteraction
from .rays import Axes, Flags, NodeScalars, Number, Pairs, Rays, Scalars, Vectors
from .shapes import GRAZING, Shapes, across, surface_value

LEAST_SPREAD = 0.002
"""A ray is subdivided where its weight times the square of a spread, in radians, is more than this.

Half of it takes a seventh to two fifths more rays and gains little. Double it makes pictures of one scene half as wrong
again (experiments/tuning)."""


def transport(rays: Rays, si: SurfaceInteraction, shape: Shapes, scatter) -> tuple[Axes, ...]:
    """Derivatives of hit point and scattered directions along the footprint's axes (Igehy 1999, by forward mode)."""
    rays, si, shape = stop_gradient((rays, si, shape))

    def bounce(o, d):
        # The hit moves so that F stays 0 (implicit function theorem): dt = -dF / (n.d). The change is 0 in value, and
        # only its derivative counts.
        value = surface_value(o + si.t * d, shape)
        # Always from `si.n`, which faces the ray: the normal at p may graze it, where rounding decides a sign.
        cos = away_from_zero(dot(si.n, rays.d), GRAZING)
        t = si.t - (value - stop_gradient(value)) / cos
        p = o + t * d
        # The gradient of F is linear in p: the normal turns by the curvature times the way across the axis.
        return p, *scatter(d, si.n + shape.curvature * across(p - si.p, shape))

    along = jax.vmap(lambda *axis: jax.jvp(bounce, (rays.o, rays.d), axis)[1])(rays.footprint.o, rays.footprint.d)
    return stop_gradient(along)


def bounded(o: Axes, d: Axes, unit: Number) -> tuple[Axes, Axes]:
    """A footprint's axes of origin and direction, each shortened as a whole where it has outgrown all scenes.

    Between two balls each bounce may spread footprints a thousandfold: after twenty the squares of their edges' slopes
    would be infinite, and derivatives NaN.
    """
    sizes = [jnp.max(jnp.abs(axes), axis=1, keepdims=True) for axes in (o / unit, d)]
    # In radians and in units of length: far more than means anything, far less than the root of float32's largest.
    largest = 1e6
    shorten = largest / jnp.maximum(jnp.maximum(*sizes), largest)
    return shorten * o, shorten * d


def light_nodes(rays: Rays, si: SurfaceInteraction, shape: Shapes, p_axes: Axes) -> Nodes:
    """Four points of each footprint on its surface; their mean is its light.

    They are Gauss-Legendre nodes: in an interval of length one they lie `1 / sqrt(12)` to either side of the middle,
    and the mean of a cubic is that of its values there.
    """
    shape = stop_gradient(shape)
    curvature = shape.curvature

    def moved(moves: Axes) -> Float[Array, "3 4 *rays"]:
        # All nodes in one array: one program for the four of them, which lie on either side along both axes.
        signs = (-1, -1, 1, 1), (-1, 1, -1, 1)
        u, v = (jnp.asarray(x, moves.dtype).reshape(4, *(1,) * (moves.ndim - 2)) for x in signs)
        return u * moves[0][:, None] + v * moves[1][:, None]

    # A footprint that has outgrown a sphere moves along it by no more than its radius.
    # 1e-20 only guards the root: footprints on surfaces are many orders of magnitude longer, in any unit.
    length = jnp.sqrt(jnp.maximum(jnp.sum(p_axes * p_axes, 1), 1e-20))
    fraction = (12**-0.5 / jnp.maximum(1, length * curvature))[:, None]
    p_moves, d_moves = fraction * p_axes, fraction * rays.footprint.d
    n_moves = curvature * jax.vmap(across, (0, None))(p_moves, shape)
    p, d = moved(p_moves), moved(d_moves)
    n = safe_normalize(si.n[:, None] + moved(n_moves))
    spread = cosine_spread(*stop_gradient((rays.d, si.n, d_moves, n_moves)))
    return Nodes(si.p[:, None] + p, n, safe_normalize(rays.d[:, None] + d), spread)


def cosine_spread(d: Vectors, n: Vectors, d_moves: Axes, n_moves: Axes) -> Scalars:
    """The range of the squared cosine of incidence over footprints, to first order; `moves` are those to the nodes."""
    changes = jnp.sum(n * d_moves + d * n_moves, 1)
    variance = jnp.sum(changes * changes, 0)
    # The square of a cosine changes by twice the cosine times its change. What is uniform and as wide as w has the
    # variance w^2 / 12.
    return 2 * jnp.abs(dot(d, n)) * jnp.sqrt(12 * variance + TINY_32)


def spread_squared(d_axes: Axes) -> Pairs:
    """Squares of the angles by which a scattered footprint is spread along its two axes, in radians."""
    # About a half turn is the widest that counts; 0.75 to 6 do the same.
    return jnp.minimum(jnp.sum(d_axes * d_axes, 1), 3.0**2)


def wants_subdivision(rays: Rays, spread: Pairs, may_split: Flags, samples: int, corner: Flags) -> tuple[Flags, Flags]:
    """The rays that are better subdivided, and those along the footprint's second axis; `spread` is weighted.

    Those at a `corner` of a body are, along one axis after the other.
    """
    # The axis along which the linear footprint is worst is cut. The error falls with the square of its length.
    second = spread[1] > spread[0]
    worst = jnp.where(second, spread[1], spread[0])
    second = jnp.where(corner, rays.footprint.subdivisions % 2 == 1, second)
    wanted = (corner | (worst > LEAST_SPREAD / samples)) & may_split & (rays.footprint.subdivisions < SUBDIVISIONS)
    return wanted, second


def subdivide(rays: Rays, second: Flags) -> list[Rays]:
    """The three thirds of each footprint, side by side along its first or second axis, as rays of their own."""
    footprint = rays.footprint

    def third(axes):
        return jnp.stack([jnp.where(second, axes[0], axes[0] / 3), jnp.where(second, axes[1] / 3, axes[1])])

    deeper = footprint.subdivisions + 1
    part = dataclasses.replace(footprint, o=third(footprint.o), d=third(footprint.d), subdivisions=deeper)
    part = dataclasses.replace(rays, footprint=part, throughput=rays.throughput / 3)
    # The axes span the square from -1/2 to 1/2: the thirds' middles are at -1/3, 0 and 1/3.
    o_axis, d_axis = (jnp.where(second, axes[1], axes[0]) for axes in (footprint.o, footprint.d))
    return [
        dataclasses.replace(part, o=rays.o + offset * o_axis, d=safe_normalize(rays.d + offset * d_axis))
        for offset in (-1 / 3, 0, 1 / 3)
    ]


def positive_fractions(values: NodeScalars) -> NodeScalars:
    """The fraction of each node's part of a footprint where a function is positive, given its values there.

    The function is linear over a footprint; each of the four nodes stands for a quarter, whose middle is nearer to the
    middle of the whole than the node is. Of single points it is 1 where the value is positive, else 0.
    """
    if values.ndim == 1:
        return (values > 0).astype(values.dtype)
    middle = mean(values)
    fixed = stop_gradient(values)
    # Kept from zero, as it is divided by: 1e-9 to 1e-3 do the same.
    steepness = 1 / jnp.maximum(jnp.max(fixed, 0) - jnp.min(fixed, 0), 1e-6)
    # A Gauss-Legendre node lies sqrt(4/3) times as far from the middle as the middle of its half does.
    return clamp01(0.5 + (values + ((4 / 3) ** 0.5 - 1) * middle) * steepness)


def total_fraction(nodes: Nodes, eta: Scalars) -> Scalars:
    """The fraction of each footprint that is reflected totally: where the squared cosine of refraction is negative."""
    cos = dot(nodes.d, nodes.n)
    return 1 - mean(positive_fractions(1 - (1 - cos * cos) / (eta * eta)))


def mean(values: NodeScalars) -> Scalars:
    """The mean over the nodes, written out: as a reduction, derivatives take a quarter longer on the CPU.

    Of single points it is the values themselves.
    """
    return values if values.ndim == 1 else functools.reduce(operator.add, values) * (1 / len(values))


def parts(axes: Float[Array, "2 coordinates *rays"], n: int) -> tuple[Array, Array]:
    """The n x n parts of footprints, n even; long footprints have 2 n along the length and n / 2 across.

    Returns:
        The parts' middles, "parts coordinates *rays", and the derivatives along the axes of each, the longer one first.
    """
    squares = [sum(component * component for component in axis) for axis in axes]
    swapped = squares[1] > squares[0]
    first, second = jnp.where(swapped, axes[::-1], axes)
    # More than twice as long as wide: else n x n parts are no longer than twice as wide themselves.
    long = jnp.maximum(*squares) > 4 * jnp.minimum(*squares)
    rays = (1,) * (axes.ndim - 2)

    def middles(count: int) -> Float[Array, "parts *ones"]:
        places = [((k // count + 0.5) * count / n**2 - 0.5, (k % count + 0.5) / count - 0.5) for k in range(n * n)]
        return jnp.asarray(places, axes.dtype).T.reshape(2, n * n, *rays)

    along, across = jnp.where(long, middles(n // 2), middles(n))
    offsets = along[:, None] * first + across[:, None] * second
    sizes = jnp.where(long, 1 / (2 * n), 1 / n), jnp.where(long, 2 / n, 1 / n)
    return offsets, jnp.stack([sizes[0] * first, sizes[1] * second])
