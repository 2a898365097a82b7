"""A scene laid out for tracing."""

from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import Background, PointLights, Scene, world_length
from raytrace_jax.tracer.geometry.intersection import Clusters, make_clusters
from raytrace_jax.tracer.geometry.shape_types import repeated, scene_shapes
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.image_texture import Pyramid
from raytrace_jax.tracer.shading.materials import channel_indices, prepare_materials
from raytrace_jax.tracer.shading.textures import Textures, prepare_pyramids, prepare_textures


class World(eqx.Module):
    """A scene as rays meet it: shapes and their materials in the order of the file, and the lights.

    Args:
        materials: of each shape the properties that the model uses, one of `materials.MATERIALS`.
        clusters: bounds around neighbouring shapes, where there are many; none of a scene whose edges matter.
        unit: the length that small distances are measured in: one in a scene as large as the course's, and so much
            more or less in others that a scene is traced alike in metres and in millimetres. Without derivative.
        textures: what lies on shapes and around them; None where there is nothing, or the model knows of none.
        channel_ior: each shape's index for each channel, in the place of that of its material; None where all channels
            have one.
    """

    shapes: Shapes
    clusters: list[Clusters]
    materials: Any
    lights: PointLights
    unit: Float[Array, ""]
    textures: Textures | None
    background: Background | None
    channel_ior: Float[Array, "3 shapes"] | None


def prepare_world(scene: Scene, settings: ResolvedSettings, pyramids: tuple[Pyramid, ...] | None = None) -> World:
    """Lay a scene out for tracing."""
    shapes = scene_shapes(scene)
    # A footprint also meets what its centre misses: bounds around shapes do not tell.
    clusters = make_clusters(jax.lax.stop_gradient(shapes)) if settings.edges != "aware" else []
    has_more = settings.model == "physical"
    if has_more:
        hidden = repeated(jax.lax.stop_gradient(shapes))
        shapes = eqx.tree_at(lambda s: s.hidden, shapes, hidden, is_leaf=lambda leaf: leaf is None)
    if pyramids is None:
        pyramids = prepare_pyramids(scene, settings.edges) if has_more else ()
    return World(
        shapes,
        clusters,
        prepare_materials(scene, settings.model),
        scene.lights,
        world_length(scene) / 10,
        prepare_textures(scene, pyramids) if has_more else None,
        scene.background if has_more else None,
        channel_indices(scene) if has_more else None,
    )
