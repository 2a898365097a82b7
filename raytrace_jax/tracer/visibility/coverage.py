"""How much of a pixel lies on one side of a straight edge, where the middle of that part is, and how wide it is.

A pixel is the unit square around the origin of its own coordinates (u, v). An edge is a line with unit normal
`(n_u, n_v)` at signed distance `d` from the centre, positive when the centre is on the side that is asked for. Then
`q = d + n.x` is the distance of a point x from the edge. Over the square q is d plus the sum of two independent uniform
numbers, of widths `a = |n_u|` and `b = |n_v|`. So the mean over the square of any f(q) is a second difference of F, the
second antiderivative of f:

    D[F] = (F(d + h+) + F(d - h+) - F(d + h-) - F(d - h-)) / (a b),   h+- = (a +- b) / 2.

With `F_k(x) = max(x, 0)^k / k!` the moments of the part with q > 0 are: its area `A = D[F_2]` (f is the step function),
`A E[q] = D[F_3]`, and `A E[q^2] / 2 = D[F_4]`. The derivative of A by d is `D[F_1]`, the density of q at the edge. That
is the length of the edge inside of the pixel: the weight of a moving edge in the pixel's derivative (`look`).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

LEAST_AREA = 1e-5
"""Smaller parts of a pixel count as a point on the edge. 1e-7 to 1e-3 do the same (experiments/tuning)."""

LEAST_SIDE = 3e-2
"""An edge nearer to parallel with a side than this is turned by so much.

The second difference divides by the sides' extents, and loses as many digits as they are small. An edge on the border
of two pixels, as between the course's walls in pictures of even width, belongs to each by half. Its distances from
their middles are known only to a few thousandths: not turned, both pixels could take all of it, or none."""


class Cut(eqx.Module):
    """A pixel cut in two by an edge: the near part, where the edge's distance is positive, and the far part.

    Args:
        area: share of the near part in the pixel.
        near_shift: position of the near part's centroid along the edge's normal, in pixels from the pixel's centre.
        far_shift: position of the far part's centroid along the edge's normal; negative.
        near_width: standard deviation of the near part along the normal, as a share of the whole pixel's.
        far_width: standard deviation of the far part along the normal, as a share of the whole pixel's.
    """

    area: Float[Array, " *rays"]
    near_shift: Float[Array, " *rays"]
    far_shift: Float[Array, " *rays"]
    near_width: Float[Array, " *rays"]
    far_width: Float[Array, " *rays"]


def reach(normal: Float[Array, "2 *rays"]) -> Float[Array, " *rays"]:
    """The largest distance at which an edge of this direction still cuts the pixel."""
    a, b = sides(normal)
    return (a + b) / 2


def sides(normal: Float[Array, "2 *rays"]) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"]]:
    """Extent of the pixel's two sides along the edge's normal, kept from zero, as they are divided by."""
    return jnp.maximum(jnp.abs(normal[0]), LEAST_SIDE), jnp.maximum(jnp.abs(normal[1]), LEAST_SIDE)


def cut_pixel(d: Float[Array, " *rays"], normal: Float[Array, "2 *rays"]) -> Cut:
    """Cut pixels by edges at distance `d`; an edge that misses its pixel leaves one part whole.

    Differentiable with respect to `d`; the normals and widths are taken as constants.
    """
    a, b = sides(jax.lax.stop_gradient(normal))
    near_area, near_mean, near_width = half_plane(d, a, b)
    # Seen from the far side the edge lies at -d. Means are distances from the edge, shifts are from the pixel's centre.
    _, far_mean, far_width = half_plane(-d, a, b)
    return Cut(near_area, near_mean - d, -(far_mean + d), near_width, far_width)


def half_plane(
    d: Float[Array, " *rays"], a: Float[Array, " *rays"], b: Float[Array, " *rays"]
) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"], Float[Array, " *rays"]]:
    """Area of the part with q > 0, mean of q over it, and its width along the normal as a share of the pixel's."""
    outer, inner = (a + b) / 2, (a - b) / 2

    def difference(power, scale):
        # One corner of the square: x is its distance from the edge, and corners beyond the edge add nothing.
        def term(x):
            positive = jnp.maximum(x, 0)
            return positive**power

        return (term(d + outer) + term(d - outer) - term(d + inner) - term(d - inner)) / (scale * a * b)

    # Where the edge misses the pixel the part is all or nothing, without the rounding of the differences.
    cuts = jnp.abs(d) < outer
    area = jnp.where(cuts, difference(2, 2), jnp.where(d > 0, 1, 0))
    enough = area > LEAST_AREA
    safe_area = jnp.where(enough, area, 1)
    mean = jnp.where(cuts, difference(3, 6) / safe_area, d)
    # E[q^2] is twice D[F_4] / A: x^4 / 12. The whole pixel's variance is that of both uniform numbers.
    square = difference(4, 12) / safe_area
    whole = (a * a + b * b) / 12
    # A part keeps a millionth of the variance at least, so that no footprint becomes a line.
    variance = jnp.clip(jnp.where(cuts, square - mean * mean, whole), 1e-6 * whole, whole)
    # A part too small to look at is a point on the edge.
    mean = jnp.where(enough, mean, 0)
    return jnp.clip(area, 0, 1), mean, jax.lax.stop_gradient(jnp.sqrt(variance / whole))
