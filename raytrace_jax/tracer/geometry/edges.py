"""The edges that a ray's footprint may straddle, as event functions and their derivatives over the footprint.

`visibility.look` tells what they are for; `kinds` has those of the shapes. All derivatives over the footprint are
constants to the parameter derivative, but for those of a silhouette: a ball that grows as it recedes keeps its outline
to the last digit.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.geometry.shapes import Shapes, divisor, surface_normal
from raytrace_jax.util.numerics import TINY_32, dot

FADE_RADIUS = 1.0
"""Silhouettes fade where a footprint is wider than this share of the sphere's radius: they are blurred no further.

From 0.5 to 2 errors change by a twentieth, in small pictures by more (experiments/tuning)."""

FADE_COS = 0.4
"""Edges fade where the cosine of incidence changes by more than this share of itself towards the footprint's sides.

0.2 makes pictures of two scenes worse; 0.8 is a little worse on one and better on the other (experiments/tuning)."""

LEAST_SHARE = 1e-3
"""No edge fades to less than this share of the footprint, as distances are divided by the share.

Anything from 1e-4 to 1e-2 does the same (experiments/tuning)."""

GRAZING = 1e-3
"""Footprints on a surface stop growing at this cosine of incidence. 1e-4 to 1e-2 do the same (experiments/tuning)."""

WITHIN = 0.9995
"""Edges farther from the centre than this share of the footprint's reach are left alone: almost nothing lies beyond.

Anything from 0.995 to 0.99995 does the same (experiments/tuning)."""


class Edge(eqx.Module):
    """One candidate edge of each ray.

    Args:
        exists: there is such an edge.
        value: the event function, positive where the nearest surface is present.
        slope: its derivatives along the footprint's two axes.
        share: how much of the footprint, side to side, the linear event function is good for.
    """

    exists: Bool[Array, " *rays"]
    value: Float[Array, " *rays"]
    slope: Float[Array, "2 *rays"]
    share: Float[Array, " *rays"]


class Approach(eqx.Module):
    """How the distance to a surface changes over a footprint; constant to the parameter derivative.

    Args:
        slope: derivatives of the distance along the footprint's two axes.
        share: how much of the footprint that is about right for: the cosine of incidence changes little there.
    """

    slope: Float[Array, "2 *rays"]
    share: Float[Array, " *rays"]


def approach(
    rays: Rays, shape: Shapes, t: Float[Array, " *rays"], side: Float[Array, " *rays"] | None = None
) -> Approach:
    """How each footprint approaches one shape that is hit at t; `side` as in `shapes.divisor`, None for flat shapes."""
    rays, shape, t = jax.lax.stop_gradient((rays, shape, t))
    n = shape.normal if side is None else surface_normal(rays.o + t * rays.d, shape)
    cos = dot(n, rays.d)
    footprint = rays.beam.footprint
    across = [footprint.o[k] + t * footprint.d[k] for k in range(2)]
    divide_by = divisor(cos, GRAZING, side)
    slope = jnp.stack([-dot(n, across[k]) / divide_by for k in range(2)])
    change = jnp.abs(dot(n, footprint.d[0])) + jnp.abs(dot(n, footprint.d[1]))
    if side is not None:
        change += shape.curvature * jnp.sqrt(dot(across[0], across[0]) + dot(across[1], across[1]) + TINY_32)
    return Approach(slope, jnp.clip(2 * FADE_COS * jnp.abs(cos) / (change + TINY_32), LEAST_SHARE, 1))


def share_of_radius(slope: Float[Array, "2 *rays"], radius: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The share of the footprint over which an event function changes by no more than a radius (or half a side)."""
    return jnp.clip(FADE_RADIUS * radius / (jnp.abs(slope[0]) + jnp.abs(slope[1]) + TINY_32), LEAST_SHARE, 1)


def extent(edge: Edge) -> Float[Array, " *rays"]:
    """How much the event function changes from the footprint's centre to its farthest corner."""
    return (jnp.abs(edge.slope[0]) + jnp.abs(edge.slope[1])) / 2


def is_within(edge: Edge) -> Bool[Array, " *rays"]:
    """Whether any part of the footprint that matters lies on the near side of the edge."""
    return edge.value > -WITHIN * edge.share * extent(edge)
