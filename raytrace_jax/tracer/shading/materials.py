"""What surfaces are made of, where rays hit them: of each model the properties that it uses, and nothing else."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.scene import ChannelMaterials, Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.geometry.layout import shape_materials

LINE_CHANNEL = 1
"""Where there is one index for all channels and a material has three, it is the green one."""


class ClassicMaterials(eqx.Module):
    """The properties that the classic model uses, as in `scene.Materials`."""

    ambient: Float[Array, "3 *shapes"]
    diffuse: Float[Array, "3 *shapes"]
    specular: Float[Array, "3 *shapes"]
    alpha: Float[Array, " *shapes"]
    ior: Float[Array, " *shapes"]


class AdditiveMaterials(eqx.Module):
    """The properties that the additive model uses, as in `scene.Materials`."""

    ambient: Float[Array, "3 *shapes"]
    diffuse: Float[Array, "3 *shapes"]
    specular: Float[Array, "3 *shapes"]
    ior: Float[Array, " *shapes"]
    hardness: Float[Array, " *shapes"]
    reflectivity: Float[Array, " *shapes"]
    fresnel: Float[Array, " *shapes"]
    transmission: Float[Array, " *shapes"]


class PhysicalMaterials(eqx.Module):
    """The properties that the physical model uses, as in `scene.Materials`."""

    diffuse: Float[Array, "3 *shapes"]
    ior: Float[Array, " *shapes"]
    reflectivity: Float[Array, " *shapes"]
    transmission: Float[Array, " *shapes"]
    emission: Float[Array, "3 *shapes"]
    absorption: Float[Array, "3 *shapes"]


MATERIALS: dict[ModelName, type[Any]] = {
    "classic": ClassicMaterials,
    "additive": AdditiveMaterials,
    "physical": PhysicalMaterials,
}
"""For each model the properties that it uses."""


def prepare_materials(scene: Scene, model: ModelName) -> Any:
    """The material of every shape, in the order of the file, as the model's struct."""
    columns = jnp.asarray(shape_materials(scene), jnp.int32)
    struct = MATERIALS[model]
    fields = [field.name for field in dataclasses.fields(struct)]
    return struct(**{name: material_property(scene, name)[..., columns] for name in fields})


def material_property(scene: Scene, name: str) -> Float[Array, "*components materials"]:
    """A property of all materials, kind by kind, as columns count them; of three indices `LINE_CHANNEL`."""
    groups = [getattr(scene, kind.group) for kind in BLOCK_KINDS["material"]]
    found = []
    for group in [group for group in groups if group.names] or groups[:1]:
        values = getattr(group, name)
        found.append(values[LINE_CHANNEL] if name == "ior" and isinstance(group, ChannelMaterials) else values)
    return found[0] if len(found) == 1 else jnp.concatenate(found, axis=-1)
