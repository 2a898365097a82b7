"""A scene laid out for tracing."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.extent import world_length
from raytrace_jax.scene.scene import PointLights, Scene
from raytrace_jax.tracer.geometry.clusters import Clusters, make_clusters
from raytrace_jax.tracer.geometry.layout import scene_shapes
from raytrace_jax.tracer.geometry.rays import MOST_SHAPES
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.shading.materials import ShapeMaterials, prepare_materials


class World(eqx.Module):
    """What rays meet: shapes and their materials in the order of the file, and the lights.

    Args:
        clusters: bounds around neighbouring shapes, where there are many; none of a scene whose edges matter.
        unit: the length that small distances are measured in: one in a scene as large as the course's, and so much
            more or less in others that a scene is traced alike in metres and in millimetres. Without derivative.
    """

    shapes: Shapes
    clusters: list[Clusters]
    materials: ShapeMaterials
    lights: PointLights
    unit: Float[Array, ""]


def prepare_world(scene: Scene, settings: RenderSettings) -> World:
    """Lay a scene out for tracing.

    Raises:
        RaytraceError: more shapes than edge-aware tracing can tell apart.
    """
    count = len(scene.shape_order)
    if settings.edges == "aware" and count > MOST_SHAPES:
        raise RaytraceError(
            f"the scene has {count} shapes; edge-aware tracing takes {MOST_SHAPES} at most: leave some out, "
            "or render with edges 'point'."
        )
    shapes = scene_shapes(scene)
    # A footprint also meets what its centre misses: bounds around shapes do not tell.
    clusters = make_clusters(jax.lax.stop_gradient(shapes)) if settings.edges == "point" else []
    return World(shapes, clusters, prepare_materials(scene), scene.lights, world_length(scene) / 10)
