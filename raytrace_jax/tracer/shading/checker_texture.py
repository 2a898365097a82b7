"""A checker of two colours: the fraction of the first at points and over footprints.

The first colour is where floor(x) + floor(y) is even, with (x, y) = (position - offset) / square. In terms of the
square wave s(x), 1 from 0 to 1 and -1 from 1 to 2, the fraction is (1 + s(x) s(y)) / 2.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.tracer.geometry.rays import Scalars
from raytrace_jax.tracer.shading.quadrature import parts
from raytrace_jax.util.numerics import clamp01, instantiated, is_zero, select, with_lower_ranks


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
    place = (position - offset) / square
    if axes is None:
        return 1 - jnp.abs(jnp.sum(jnp.floor(place), 0)) % 2
    # 4 x 4 parts, 8 x 2 for long footprints. Up to two squares wide the worst error is .019 (.039 for a skew
    # footprint of four squares); with 2 x 2 or 4 x 1 parts it is .071. The derivative by place is .99 to 1.03 of the
    # true one in the mean, and off by a tenth to a quarter in single footprints. The first order may go a little
    # beyond 0 and 1.
    return clamp01((1 + mean_product(place, axes / square)) / 2)


@jax.custom_jvp
def mean_product(place: Float[Array, "2 *rays"], axes: Float[Array, "2 2 *rays"]) -> Scalars:
    """The mean of s(x) s(y) over parallelograms, in squares."""
    return _mean_and_slopes(place, axes)[0]


def _mean_product_jvp(primals, tangents):
    (place, axes), (place_dot, axes_dot) = primals, tangents
    if not is_zero(axes_dot):
        # The squares' size changes.
        return jax.jvp(lambda *given: _mean_and_slopes(*given)[0], primals, instantiated(tangents))
    # The derivatives by place once, not of each part for each direction.
    mean, slopes = _mean_and_slopes(place, axes)
    return mean, jnp.sum(slopes * place_dot, 0)


mean_product.defjvp(with_lower_ranks(_mean_product_jvp), symbolic_zeros=True)


def _mean_and_slopes(
    place: Float[Array, "2 *rays"], axes: Float[Array, "2 2 *rays"]
) -> tuple[Scalars, Float[Array, "2 *rays"]]:
    """The mean of s(x) s(y) over parallelograms, and its derivatives by place."""
    divided = parts(axes, 4)
    first, second = divided.axes
    value, slope, bend = _square_wave(place[:, None] + jnp.moveaxis(divided.middles, 0, 1), first, second)
    covariance = jnp.sum(jnp.prod(divided.axes, axis=1), 0) / 12
    terms = jnp.prod(value, 0) + covariance * jnp.prod(slope, 0)
    slopes = slope * value[::-1] + covariance * bend * slope[::-1]
    # A product with equal weights is one kernel: of sums of slices XLA computes all parts anew in each.
    weights = jnp.full(terms.shape[0], 1 / terms.shape[0], terms.dtype)
    each = [jnp.tensordot(weights, x, 1, precision=jax.lax.Precision.HIGHEST) for x in (terms, *slopes)]
    return each[0], jnp.stack(each[1:])


Wave = tuple[Float[Array, "2 parts *rays"], Float[Array, "2 parts *rays"], Float[Array, "2 parts *rays"]]
"""The mean of the square wave along x and along y, its slope, and how the slope changes."""


def _square_wave(x: Float[Array, "2 parts *rays"], a: Float[Array, "2 *rays"], b: Float[Array, "2 *rays"]) -> Wave:
    """The wave over the trapezoids that a parallelogram with extents a and b has on x and on y."""
    a, b = jnp.abs(a), jnp.abs(b)
    # The lesser extent counts as at least so much of the larger one: differences are divided by both.
    least_ratio = 3e-3
    # No footprint is narrower than a millionth of a square, so that it has a derivative at an edge.
    wide = jnp.maximum(jnp.maximum(a, b), 1e-6)
    narrow = jnp.maximum(jnp.minimum(a, b), least_ratio * wide)
    near = _at_one_edge(x, wide[:, None], narrow[:, None])
    far = _at_many_edges(x, jnp.maximum(wide, 0.5)[:, None], jnp.maximum(narrow, 0.5 * least_ratio)[:, None])
    return select((wide + narrow < 1)[:, None], near, far)


def _at_one_edge(x, wide, narrow) -> Wave:
    """The wave where no more than the nearest edge is seen: the mean over `narrow` of a ramp as wide as `wide`."""
    edge = jnp.round(x)
    sign = (1 - 2 * (jnp.abs(edge) % 2)) / narrow
    low, high, half = x - edge - narrow / 2, x - edge + narrow / 2, wide / 2
    start, end = jnp.clip(-half, low, high), jnp.clip(half, low, high)
    ramp = (end - start) * (end + start) / wide
    steep = sign * 2 / wide
    # Within the ramp both ends move with x, and the slope stays.
    beyond = [(end < low) | (end > high) for end in (half, -half)]
    moves = beyond[0].astype(x.dtype) - beyond[1].astype(x.dtype)
    return sign * (ramp + (high - end) - (start - low)), steep * (end - start), steep * moves


def _at_many_edges(x, wide, narrow) -> Wave:
    """Second differences of integrals of the wave: well conditioned for wide ones, whatever the number of edges."""
    i, j, sign = jnp.asarray([(i, j, i * j) for i in (0.5, -0.5) for j in (0.5, -0.5)], x.dtype).T
    i, j, sign = (side.reshape(4, *(1,) * x.ndim) for side in (i, j, 4 * sign))
    ends = x + (i * wide + j * narrow)
    phase = ends - 2 * jnp.floor(ends / 2)
    wave = jnp.where(phase < 1, 1, -1)
    triangle = jnp.where(phase < 1, phase, 2 - phase)
    scale = 1 / (wide * narrow)
    integrals = wave * triangle * (triangle - 1) / 2, triangle, wave
    return tuple(scale * jnp.sum(sign * integral, 0) for integral in integrals)
