"""A footprint in equal parts, so many that a mean over each is simple."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

LONG = 4
"""A footprint whose squared length is more than so many times its squared width is cut into longer rows: up to there
parts in as many rows as columns are no longer than twice as wide."""


class Parts(NamedTuple):
    """Parallelograms side by side that make up a larger one."""

    middles: Float[Array, "parts coordinates *rays"]
    """From the middle of the whole."""

    axes: Float[Array, "2 coordinates *rays"]
    """Derivatives along the axes of each part, the longer one first: it reaches half of them to both sides."""


def parts(axes: Float[Array, "2 coordinates *rays"], n: int) -> Parts:
    """The n x n parts of footprints, or, of long ones, 2 n along the length and n / 2 across.

    Args:
        axes: derivatives along the two axes of each footprint, in coordinates of one unit.
        n: an even number.
    """
    squares = [sum(component * component for component in axis) for axis in axes]
    swapped = squares[1] > squares[0]
    first, second = jnp.where(swapped, axes[::-1], axes)
    long = jnp.maximum(*squares) > LONG * jnp.minimum(*squares)
    rays = (1,) * (axes.ndim - 2)

    def middles(count: int) -> Float[Array, "parts *ones"]:
        places = [((k // count + 0.5) * count / n**2 - 0.5, (k % count + 0.5) / count - 0.5) for k in range(n * n)]
        return jnp.asarray(places, axes.dtype).T.reshape(2, n * n, *rays)

    along, across = jnp.where(long, middles(n // 2), middles(n))
    offsets = along[:, None] * first + across[:, None] * second
    sizes = jnp.where(long, 1 / (2 * n), 1 / n), jnp.where(long, 2 / n, 1 / n)
    return Parts(offsets, jnp.stack([sizes[0] * first, sizes[1] * second]))
