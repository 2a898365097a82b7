"""Means over a footprint on a surface, from values at the four nodes that `footprints.light_nodes` places there."""

import functools
import operator
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.util.numerics import clamp01, dot

Nodes = Sequence[tuple[Hits, Float[Array, "3 *rays"]]]
"""Hits with the directions of the rays to them: the four nodes of each footprint, or one, the hit itself."""

LEAST_CHANGE = 1e-6
"""Functions whose sign decides change at least that much over a footprint, by which they are divided. Anything from
1e-9 to 1e-3 does the same on two scenes (experiments/tuning)."""

SQRT_4_3 = (4 / 3) ** 0.5
"""A Gauss-Legendre node of an interval lies that much farther from its middle than the middle of its half does."""


def positive_shares(values: Sequence[Float[Array, " *rays"]]) -> list[Float[Array, " *rays"]]:
    """The share of each node's part of a footprint where a function is positive, given its values there.

    The function is linear over a footprint; each of the four nodes stands for a quarter, whose middle is nearer to the
    middle of the whole than the node is.
    """
    middle = mean(values)
    spread = functools.reduce(jnp.maximum, values) - functools.reduce(jnp.minimum, values)
    spread = jnp.maximum(jax.lax.stop_gradient(spread), LEAST_CHANGE)
    return [clamp01(0.5 + (value - middle + middle * SQRT_4_3) / spread) for value in values]


def node_shares(values: Float[Array, "nodes *rays"]) -> Float[Array, "nodes *rays"]:
    """The same of an array whose first axis are the nodes; of a single node 1 where its value is positive, else 0."""
    if len(values) == 1:
        return (values > 0).astype(values.dtype)
    return jnp.stack(positive_shares(list(values)))


def total_share(nodes: Nodes, eta: Float[Array, " *rays"]) -> Float[Array, " *rays"]:
    """The share of each footprint that is reflected totally: where the squared cosine of refraction is negative."""
    cosines = [dot(d, hits.n) for hits, d in nodes]
    return 1 - mean(positive_shares([1 - (1 - cos * cos) / (eta * eta) for cos in cosines]))


def mean(values: Sequence[Float[Array, "*axes"]]) -> Float[Array, "*axes"]:
    """The mean of arrays; a single one as it is."""
    total = functools.reduce(operator.add, values)
    return total / len(values) if len(values) > 1 else total
