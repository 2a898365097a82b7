"""Means over a footprint on a surface.

They are taken from values at the four nodes that `footprints.light_nodes` places there, or from parts of the footprint,
so many that a mean over each is simple.
"""

import functools
import operator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...util.numerics import clamp01, dot
from ..geometry.intersection import Nodes
from ..geometry.rays import Scalars


def positive_fractions(values: Float[Array, "*nodes rays"]) -> Float[Array, "*nodes rays"]:
    """The fraction of each node's part of a footprint where a function is positive, given its values there.

    The function is linear over a footprint; each of the four nodes stands for a quarter, whose middle is nearer to the
    middle of the whole than the node is. Of single points it is 1 where the value is positive, else 0.
    """
    if values.ndim == 1:
        return (values > 0).astype(values.dtype)
    middle = mean(values)
    fixed = jax.lax.stop_gradient(values)
    # Kept from zero, as it is divided by: 1e-9 to 1e-3 do the same.
    steepness = 1 / jnp.maximum(jnp.max(fixed, 0) - jnp.min(fixed, 0), 1e-6)
    # A Gauss-Legendre node lies sqrt(4/3) times as far from the middle as the middle of its half does.
    return clamp01(0.5 + (values + ((4 / 3) ** 0.5 - 1) * middle) * steepness)


def total_fraction(nodes: Nodes, eta: Scalars) -> Scalars:
    """The fraction of each footprint that is reflected totally: where the squared cosine of refraction is negative."""
    cos = dot(nodes.d, nodes.n)
    return 1 - mean(positive_fractions(1 - (1 - cos * cos) / (eta * eta)))


def mean(values: Float[Array, "*nodes rays"]) -> Scalars:
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
