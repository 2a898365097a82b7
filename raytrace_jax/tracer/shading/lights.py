"""Lights as points ask them: where from, how far, and how much.

A new kind of light answers `sample` in a function of its own.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import PointLights
from raytrace_jax.util.numerics import dot, vectors_to


class LightSample(NamedTuple):
    """One light as seen from points.

    Args:
        toward: vectors from the points to the light, as long as that is far, in world units.
        squared_distance: the square of their length; 1 where a point lies in the light itself.
        emissivity: the light's colour.
    """

    toward: Float[Array, "3 *rays"]
    squared_distance: Float[Array, " *rays"]
    emissivity: Float[Array, "3"]

    @property
    def inverse_distance(self) -> Float[Array, " *rays"]:
        """One over the distance: the fall-off of the course's classic model, and what makes `toward` a direction."""
        return 1 / jnp.sqrt(self.squared_distance)


def sample(lights: PointLights, k: int, p: Float[Array, "3 *rays"]) -> LightSample:
    """Light `k` as seen from points `p`; whether anything is in between is the models' to ask (`shadows`)."""
    toward = vectors_to(lights.location[:, k], p)
    squared = dot(toward, toward)
    return LightSample(toward, jnp.where(squared > 0, squared, 1), lights.emissivity[:, k])
