"""What surfaces are made of, where rays hit them: of each model the properties that it uses, and nothing else."""

from collections import namedtuple
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import ChannelMaterials, Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.tracer.geometry.layout import shape_materials

LINE_CHANNEL = 1
"""The channel, green, whose index stands for a material with three where one index serves all channels."""


SINGLE_INDEX = BLOCK_TYPES["material"][0]
"""The kind of material that has one index for all channels."""


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
    """A property of all materials, kind by kind, as columns count them; of three indices `LINE_CHANNEL`."""
    groups = [getattr(scene, kind.group) for kind in BLOCK_TYPES["material"]]
    found = []
    for group in [group for group in groups if group.names] or groups[:1]:
        values = getattr(group, name)
        found.append(values[LINE_CHANNEL] if name == "ior" and isinstance(group, ChannelMaterials) else values)
    return found[0] if len(found) == 1 else jnp.concatenate(found, axis=-1)
