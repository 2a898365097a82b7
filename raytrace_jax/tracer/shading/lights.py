"""Lights as points ask them: where from, how far, and how much.

A new kind of light has its samples in a function of its own, which `light_samples` goes through too.
"""

from collections.abc import Iterator
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
        location: where the light is.
        emissivity: its colour.
        energy: what scales its light in the additive model.
    """

    toward: Float[Array, "3 *rays"]
    squared_distance: Float[Array, " *rays"]
    location: Float[Array, "3"]
    emissivity: Float[Array, "3"]
    energy: Float[Array, ""]

    @property
    def direction(self) -> Float[Array, "3 *rays"]:
        """The direction to the light, of length one."""
        return self.toward / jnp.sqrt(self.squared_distance)

    @property
    def inverse_distance(self) -> Float[Array, " *rays"]:
        """One over the distance: the fall-off of the course's classic model, and what makes `toward` a direction."""
        return 1 / jnp.sqrt(self.squared_distance)


def light_samples(lights: PointLights, p: Float[Array, "3 *rays"]) -> Iterator[LightSample]:
    """Every light as seen from points `p`; whether anything is in between is the models' to ask (`shadows`)."""
    for k in range(len(lights.names)):
        location = lights.location[:, k]
        toward = vectors_to(location, p)
        squared = dot(toward, toward)
        yield LightSample(
            toward, jnp.where(squared > 0, squared, 1), location, lights.emissivity[:, k], lights.energy[k]
        )
