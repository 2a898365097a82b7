"""Indices of refraction that differ from channel to channel: by Abbe's number, or as measured.

Cauchy's `n(lambda) = A + B / lambda^2` through the index n_d at the helium line and `V = (n_d - 1) / (n_F - n_C)`; each
channel is one wavelength. Where no material has dispersion the channels are traced together.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.layout import shape_materials

LINE_D, LINE_F, LINE_C = 587.56, 486.13, 656.27
"""Fraunhofer's lines in nanometres: n_d is at the first, Abbe's number spans the others."""


def cauchy_index(
    n_d: Float[Array, " *materials"], abbe: Float[Array, " *materials"], wavelength: float
) -> Float[Array, " *materials"]:
    """The index of refraction at a wavelength in nanometres, from n_d and Abbe's number (both without a unit)."""
    b = (n_d - 1) / (abbe * (LINE_F**-2 - LINE_C**-2))
    return n_d + b * (wavelength**-2 - LINE_D**-2)


def channel_indices(scene: Scene) -> Float[Array, "3 shapes"] | None:
    """Each shape's index for each channel; None where no material has dispersion."""
    if not scene.abbe_materials.names and not scene.channel_materials.names:
        return None
    alike = jnp.broadcast_to(scene.materials.ior, (3, len(scene.materials.names)))
    dispersed = scene.abbe_materials
    # Red, green and blue stand for one wavelength each, in nanometres.
    by_abbe = jnp.stack([cauchy_index(dispersed.ior, dispersed.abbe, length) for length in (610.0, 550.0, 465.0)])
    every = jnp.concatenate([alike, by_abbe, scene.channel_materials.ior], axis=-1)
    return every[:, jnp.asarray(shape_materials(scene), jnp.int32)]
