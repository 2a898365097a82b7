"""A scene laid out for tracing: shapes, the properties of materials that a model uses, and indices by channel."""

from collections import namedtuple
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..optics.dispersion import CHANNEL_WAVELENGTHS, cauchy_index
from ..scene.scene import Background, ChannelMaterials, PointLights, Scene, world_length
from ..scene.setting_words import ModelName
from ..scene.slabs import with_planes
from ..scene.table import BLOCK_TYPES
from .geometry.rays import Number
from .geometry.shape_types import face_materials, repeated, scene_shapes
from .geometry.shapes import Shapes
from .settings import ResolvedSettings
from .shading.image_texture import Pyramid
from .shading.textures import Textures, prepare_pyramids, prepare_textures


class World(eqx.Module):
    """A scene as rays meet it: shapes and their materials in the order of the file, and the lights."""

    shapes: Shapes
    materials: Any  # Of each face the properties that the model uses, one of `MATERIALS`.
    lights: PointLights
    # What small distances are measured in, without derivative: 1 in a scene as large as the course's, so that a scene
    # is traced alike in metres and in millimetres.
    unit: Number
    textures: Textures | None  # None where there are none, or the model knows of none.
    background: Background | None
    channel_ior: Float[Array, "3 shapes"] | None  # In the place of the material's; None where all channels have one.

    @property
    def settings(self) -> ResolvedSettings:
        return self.shapes.settings


def prepare_world(scene: Scene, settings: ResolvedSettings, pyramids: tuple[Pyramid, ...] | None = None) -> World:
    scene = with_planes(scene)
    shapes = scene_shapes(scene, settings)
    has_more = settings.model == "physical"
    if has_more:
        hidden = repeated(jax.lax.stop_gradient(shapes))
        shapes = eqx.tree_at(lambda s: s.hidden, shapes, hidden, is_leaf=lambda leaf: leaf is None)
    if pyramids is None:
        pyramids = prepare_pyramids(scene, settings.edges) if has_more else ()
    columns, fields = jnp.asarray(face_materials(scene), jnp.int32), MATERIALS[settings.model]._fields
    return World(
        shapes,
        MATERIALS[settings.model](*(material_property(scene, name)[..., columns] for name in fields)),
        scene.lights,
        world_length(scene) / 10,
        prepare_textures(scene, pyramids) if has_more else None,
        scene.background if has_more else None,
        channel_indices(scene) if has_more else None,
    )


LINE_CHANNEL = 1  # Green: its index stands for a material with three where one index serves all channels.


def _struct(model: ModelName) -> type[Any]:
    """The properties that the table of blocks has for a model, of the type of material that has one index."""
    rows = BLOCK_TYPES["material"][0].continuous
    return namedtuple(f"{model.title()}Materials", [row.name for row in rows if row.is_used_by(model)])


# Each has its name in this module, for programs are kept in files with the names of what they take and give.
ClassicMaterials, AdditiveMaterials, PhysicalMaterials = map(_struct, ("classic", "additive", "physical"))

MATERIALS: dict[ModelName, type[Any]] = {
    "classic": ClassicMaterials,
    "additive": AdditiveMaterials,
    "physical": PhysicalMaterials,
}
"""For each model the properties that it uses, as in `scene.Materials`: what the table of blocks has for it."""


def material_property(scene: Scene, name: str) -> Float[Array, "*components materials"]:
    """A property of all materials, type by type, as columns count them; of three indices `LINE_CHANNEL`."""
    groups = [getattr(scene, row.group) for row in BLOCK_TYPES["material"]]
    found = []
    for group in [group for group in groups if group.names] or groups[:1]:
        values = getattr(group, name)
        found.append(values[LINE_CHANNEL] if name == "ior" and isinstance(group, ChannelMaterials) else values)
    return found[0] if len(found) == 1 else jnp.concatenate(found, axis=-1)


def channel_indices(scene: Scene) -> Float[Array, "3 shapes"] | None:
    """Each shape's index for each channel, as measured or by Abbe's number; None where no material has dispersion."""
    if not scene.abbe_materials.names and not scene.channel_materials.names:
        return None
    alike = jnp.broadcast_to(scene.materials.ior, (3, len(scene.materials.names)))
    dispersed = scene.abbe_materials
    by_abbe = jnp.stack([cauchy_index(dispersed.ior, dispersed.abbe, length) for length in CHANNEL_WAVELENGTHS])
    every = jnp.concatenate([alike, by_abbe, scene.channel_materials.ior], axis=-1)
    return every[:, jnp.asarray(face_materials(scene), jnp.int32)]
