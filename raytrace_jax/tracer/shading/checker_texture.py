"""A checker of two colours: the fraction of the first at points and over footprints.

The first colour is where floor(x) + floor(y) is even, with (x, y) = (position - offset) / square. In terms of the
square wave s(x), 1 from 0 to 1 and -1 from 1 to 2, the fraction is (1 + s(x) s(y)) / 2.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.tracer.geometry.rays import Scalars
from raytrace_jax.tracer.shading.quadrature import parts
from raytrace_jax.util.numerics import clamp01, with_lower_ranks

LEAST_RATIO = 3e-3
"""The lesser extent of a footprint counts as at least so much of the larger one: differences are divided by both."""


def checker_fraction(
    position: Float[Array, "2 *rays"],
    axes: Float[Array, "2 2 *rays"] | None,
    square: Float[Array, " *#rays"],
    offset: Float[Array, "2 *#rays"],
) -> Scalars:
    """The fraction of the first colour in parallelograms; at points it is 0 or 1, and its derivative 0.

    The mean of s(x) s(y) over a part is E[s(x)] E[s(y)] + cov(x, y) E[s'(x)] E[s'(y)]: Price's theorem to first
    order in the covariance, without which it would hold for parts along x and y only.

    Args:
        position: the middles, on the surface in units of length.
        axes: derivatives of the position along a footprint's two axes (axis, coordinate); it reaches half of them both
            ways. None for points.
        square: length of a side.
        offset: where a square of the first colour has its corner.
    """
    x, y = (position - offset) / square
    if axes is None:
        return 1 - jnp.abs(jnp.floor(x) + jnp.floor(y)) % 2
    # 4 x 4 parts, 8 x 2 for long footprints. Up to two squares wide the worst error is .019 (.039 for a skew
    # footprint of four squares); with 2 x 2 or 4 x 1 parts it is .071. The derivative by place is .99 to 1.03 of the
    # true one in the mean, and off by a tenth to a quarter in single footprints. The first order may go a little
    # beyond 0 and 1.
    return clamp01((1 + _mean_product(x, y, axes / square)) / 2)


def _mean_of_parts(x: Scalars, y: Scalars, axes: Float[Array, "2 2 *rays"]) -> Scalars:
    """The mean of s(x) s(y) over parallelograms, in squares."""
    divided = parts(axes, 4)
    (first_x, first_y), (second_x, second_y) = divided.axes
    x, x_slope = _square_wave(x + divided.middles[:, 0], first_x, second_x)
    y, y_slope = _square_wave(y + divided.middles[:, 1], first_y, second_y)
    covariance = (first_x * first_y + second_x * second_y) / 12
    # A product with equal weights is one kernel: of sums of slices XLA computes all parts anew in each.
    weights = jnp.full(len(x), 1 / len(x), x.dtype)
    return jnp.tensordot(weights, x * y + covariance * x_slope * y_slope, 1, precision=jax.lax.Precision.HIGHEST)


_mean_product = jax.custom_jvp(_mean_of_parts)
"""`_mean_of_parts` with the derivatives by place of the mean: not one of each part for each direction."""


@with_lower_ranks
def _mean_product_jvp(primals, tangents):
    x, y, axes = primals
    moved = [not isinstance(tangent, jax.custom_derivatives.SymbolicZero) for tangent in tangents]
    if moved[2]:
        # The squares' size changes.
        changes = tuple(
            t if is_moved else jnp.zeros(t.shape, t.dtype) for t, is_moved in zip(tangents, moved, strict=True)
        )
        return jax.jvp(_mean_of_parts, primals, changes)
    mean = _mean_product(x, y, axes)
    change = jnp.zeros_like(mean)
    if moved[0]:
        change += jax.jvp(lambda x: _mean_of_parts(x, y, axes), (x,), (jnp.ones_like(x),))[1] * tangents[0]
    if moved[1]:
        change += jax.jvp(lambda y: _mean_of_parts(x, y, axes), (y,), (jnp.ones_like(y),))[1] * tangents[1]
    return mean, change


_mean_product.defjvp(_mean_product_jvp, symbolic_zeros=True)


def _square_wave(
    x: Float[Array, "parts *rays"], a: Scalars, b: Scalars
) -> tuple[Float[Array, "parts *rays"], Float[Array, "parts *rays"]]:
    """The mean of the square wave over the trapezoid that a parallelogram with extents a and b has on x; its slope."""
    a, b = jnp.abs(a), jnp.abs(b)
    # No footprint is narrower than a millionth of a square, so that it has a derivative at an edge.
    wide = jnp.maximum(jnp.maximum(a, b), 1e-6)
    narrow = jnp.maximum(jnp.minimum(a, b), LEAST_RATIO * wide)
    near, near_slope = _at_one_edge(x, wide, narrow)
    far, far_slope = _at_many_edges(x, jnp.maximum(wide, 0.5), jnp.maximum(narrow, 0.5 * LEAST_RATIO))
    one = wide + narrow < 1
    return jnp.where(one, near, far), jnp.where(one, near_slope, far_slope)


def _at_one_edge(x, wide, narrow) -> tuple[Array, Array]:
    """The wave where no more than the nearest edge is seen: the mean over `narrow` of a ramp as wide as `wide`."""
    edge = jnp.round(x)
    sign = 1 - 2 * (jnp.abs(edge) % 2)
    low, high = x - edge - narrow / 2, x - edge + narrow / 2
    start, end = jnp.clip(-wide / 2, low, high), jnp.clip(wide / 2, low, high)
    ramp = (end - start) * (end + start) / wide
    return sign * (ramp + (high - end) - (start - low)) / narrow, sign * 2 * (end - start) / (wide * narrow)


def _at_many_edges(x, wide, narrow) -> tuple[Array, Array]:
    """Second differences of integrals of the wave: well conditioned for wide ones, whatever the number of edges."""

    def difference(integral):
        ends = [integral(x + (i * wide + j * narrow) / 2) for i in (1, -1) for j in (1, -1)]
        return (ends[0] - ends[1] - ends[2] + ends[3]) / (wide * narrow)

    def triangle(x):
        phase = x - 2 * jnp.floor(x / 2)
        return jnp.where(phase < 1, phase, 2 - phase)

    def parabolas(x):
        within = triangle(x)
        return jnp.where(x - 2 * jnp.floor(x / 2) < 1, 1, -1) * within * (within - 1) / 2

    return difference(parabolas), difference(triangle)
