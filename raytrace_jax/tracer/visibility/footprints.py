"""The footprint of a ray on a surface: transport to the next one, nodes of its light, and subdivision.

A footprint is linear: a parallelogram of rays. On a curved surface that is true only for a small one. Where a footprint
would be spread by a wide angle, the ray is *subdivided* instead of bounced: three rays, each with a third of the
footprint, start anew from where it came, and their mean is its colour. A wide spread matters only as much as the ray
counts in its pixel, so that the measure is the product of its weight and the square of the angle, the order of what a
linear footprint leaves out.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...util.numerics import TINY_32, away_from_zero, dot, safe_normalize
from ..geometry.intersection import Hits, Nodes
from ..geometry.rays import Axes, Flags, Footprint, Number, Pairs, Rays, Scalars, Vectors
from ..geometry.shapes import GRAZING, Shapes, surface_value
from ..resolved_settings import SUBDIVISIONS, ResolvedSettings

LEAST_SPREAD = 0.002
"""A ray is subdivided where its weight times the square of a spread, in radians, is more than this.

Half of it takes a seventh to two fifths more rays and gains little. Double it makes pictures of one scene half as wrong
again (experiments/tuning)."""


def transport(rays: Rays, hits: Hits, shape: Shapes, scatter) -> tuple[Axes, ...]:
    """Derivatives of hit point and scattered directions along the footprint's axes (Igehy 1999, by forward mode)."""
    rays, hits, shape = jax.lax.stop_gradient((rays, hits, shape))

    def bounce(o, d):
        # The hit moves so that F stays 0 (implicit function theorem): dt = -dF / (n.d). The change is 0 in value, and
        # only its derivative counts.
        value = surface_value(o + hits.t * d, shape)
        # Always from `hits.n`, which faces the ray: the normal at p may graze it, where rounding decides a sign.
        cos = away_from_zero(dot(hits.n, rays.d), GRAZING)
        t = hits.t - (value - jax.lax.stop_gradient(value)) / cos
        p = o + t * d
        # The gradient of F is linear in p: the normal turns by the curvature times the way.
        return p, *scatter(d, hits.n + shape.curvature * (p - hits.p))

    footprint = rays.beam.footprint
    along = jax.vmap(lambda *axis: jax.jvp(bounce, (rays.o, rays.d), axis)[1])(footprint.o, footprint.d)
    return jax.lax.stop_gradient(along)


def bounded(footprint: Footprint, unit: Number) -> Footprint:
    """The footprint, each axis shortened as a whole where it has outgrown all scenes.

    Between two balls each bounce may spread footprints a thousandfold: after twenty the squares of their edges' slopes
    would be infinite, and derivatives NaN.
    """
    sizes = [jnp.max(jnp.abs(axes), axis=1, keepdims=True) for axes in (footprint.o / unit, footprint.d)]
    # In radians and in units of length: far more than means anything, far less than the root of float32's largest.
    largest = 1e6
    shorten = largest / jnp.maximum(jnp.maximum(*sizes), largest)
    return Footprint(shorten * footprint.o, shorten * footprint.d)


def light_nodes(rays: Rays, hits: Hits, shape: Shapes, p_axes: Axes) -> Nodes:
    """Four points of each footprint on its surface; their mean is its light.

    They are Gauss-Legendre nodes: in an interval of length one they lie `1 / sqrt(12)` to either side of the middle,
    and the mean of a cubic is that of its values there.
    """
    curvature = jax.lax.stop_gradient(shape.curvature)

    def moved(moves: Axes) -> Float[Array, "3 4 *rays"]:
        # All nodes in one array: one program for the four of them, which lie on either side along both axes.
        signs = (-1, -1, 1, 1), (-1, 1, -1, 1)
        u, v = (jnp.asarray(x, moves.dtype).reshape(4, *(1,) * (moves.ndim - 2)) for x in signs)
        return u * moves[0][:, None] + v * moves[1][:, None]

    # A footprint that has outgrown a sphere moves along it by no more than its radius.
    # 1e-20 only guards the root: footprints on surfaces are many orders of magnitude longer, in any unit.
    length = jnp.sqrt(jnp.maximum(jnp.sum(p_axes * p_axes, 1), 1e-20))
    fraction = (12**-0.5 / jnp.maximum(1, length * curvature))[:, None]
    p_moves, d_moves = fraction * p_axes, fraction * rays.beam.footprint.d
    p, d = moved(p_moves), moved(d_moves)
    n = safe_normalize(hits.n[:, None] + curvature * p)
    spread = cosine_spread(*jax.lax.stop_gradient((rays.d, hits.n, d_moves, curvature * p_moves)))
    return Nodes(hits.p[:, None] + p, n, safe_normalize(rays.d[:, None] + d), spread)


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


def wants_subdivision(rays: Rays, spread: Pairs, may_split: Flags, settings: ResolvedSettings) -> tuple[Flags, Flags]:
    """The rays that are better subdivided, and those along the footprint's second axis; `spread` is weighted."""
    # The axis along which the linear footprint is worst is cut. The error falls with the square of its length.
    second = spread[1] > spread[0]
    worst = jnp.where(second, spread[1], spread[0])
    wanted = (worst > LEAST_SPREAD / settings.samples) & may_split & (rays.beam.subdivisions < SUBDIVISIONS)
    return wanted, second


def subdivide(rays: Rays, second: Flags) -> list[Rays]:
    """The three thirds of each footprint, side by side along its first or second axis, as rays of their own."""
    footprint, beam = rays.beam.footprint, rays.beam

    def third(axes):
        return jnp.stack([jnp.where(second, axes[0], axes[0] / 3), jnp.where(second, axes[1] / 3, axes[1])])

    narrow = Footprint(third(footprint.o), third(footprint.d))
    part = dataclasses.replace(beam, footprint=narrow, subdivisions=beam.subdivisions + 1)
    part = dataclasses.replace(rays, beam=part, throughput=rays.throughput / 3)
    # The axes span the square from -1/2 to 1/2: the thirds' middles are at -1/3, 0 and 1/3.
    o_axis, d_axis = (jnp.where(second, axes[1], axes[0]) for axes in (footprint.o, footprint.d))
    return [
        dataclasses.replace(part, o=rays.o + offset * o_axis, d=safe_normalize(rays.d + offset * d_axis))
        for offset in (-1 / 3, 0, 1 / 3)
    ]
