"""The materials of shapes, laid out for tracing: of each model the properties that it uses, and indices by channel."""

from collections import namedtuple
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import ChannelMaterials, Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.tracer.geometry.shape_types import shape_materials

LINE_CHANNEL = 1
"""The channel, green, whose index stands for a material with three where one index serves all channels."""

SINGLE_INDEX = BLOCK_TYPES["material"][0]
"""The type of material that has one index for all channels."""


def _struct(model: ModelName) -> type[Any]:
    """The properties that the table of blocks has for a model."""
    return namedtuple(
        f"{model.title()}Materials", [row.name for row in SINGLE_INDEX.continuous if row.is_used_by(model)]
    )


# Each has its name in this module, for programs are kept in files with the names of what they take and give.
ClassicMaterials, AdditiveMaterials, PhysicalMaterials = map(_struct, ("classic", "additive", "physical"))

MATERIALS: dict[ModelName, type[Any]] = {
    "classic": ClassicMaterials,
    "additive": AdditiveMaterials,
    "physical": PhysicalMaterials,
}
"""For each model the properties that it uses, as in `scene.Materials`: what the table of blocks has for it."""


def prepare_materials(scene: Scene, model: ModelName) -> Any:
    """The material of every shape, in the order of the file, as the model's struct."""
    columns = jnp.asarray(shape_materials(scene), jnp.int32)
    struct = MATERIALS[model]
    return struct(*(material_property(scene, name)[..., columns] for name in struct._fields))


def material_property(scene: Scene, name: str) -> Float[Array, "*components materials"]:
    """A property of all materials, type by type, as columns count them; of three indices `LINE_CHANNEL`."""
    groups = [getattr(scene, row.group) for row in BLOCK_TYPES["material"]]
    found = []
    for group in [group for group in groups if group.names] or groups[:1]:
        values = getattr(group, name)
        found.append(values[LINE_CHANNEL] if name == "ior" and isinstance(group, ChannelMaterials) else values)
    return found[0] if len(found) == 1 else jnp.concatenate(found, axis=-1)


# Indices that differ from channel to channel: as measured, or by Abbe's number, through Cauchy's
# `n(lambda) = A + B / lambda^2` with the index n_d at the helium line and `V = (n_d - 1) / (n_F - n_C)`; each channel
# is one wavelength. Where no material has dispersion the channels are traced together.

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
