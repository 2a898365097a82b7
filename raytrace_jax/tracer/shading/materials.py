"""What surfaces are made of, where rays hit them."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.gather import take
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.layout import shape_materials


class ShapeMaterials(eqx.Module):
    """The material of each shape in the order of the file; the same fields as `Materials`, but for the names."""

    ambient: Float[Array, "3 *shapes"]
    diffuse: Float[Array, "3 *shapes"]
    specular: Float[Array, "3 *shapes"]
    alpha: Float[Array, " *shapes"]
    ior: Float[Array, " *shapes"]
    hardness: Float[Array, " *shapes"]
    reflectivity: Float[Array, " *shapes"]
    fresnel: Float[Array, " *shapes"]
    transmission: Float[Array, " *shapes"]


def prepare_materials(scene: Scene) -> ShapeMaterials:
    """The material of every shape, in the order of the file."""
    columns = jnp.asarray(shape_materials(scene), jnp.int32)
    fields = [field.name for field in dataclasses.fields(ShapeMaterials)]
    return ShapeMaterials(**{name: getattr(scene.materials, name)[..., columns] for name in fields})


def materials_at(
    materials: ShapeMaterials, hits: Hits, footprint: Float[Array, "2 3 *rays"] | None = None
) -> ShapeMaterials:
    """The material at each hit: every look-up goes through here, so that one that varies over a surface has its place.

    Args:
        materials: those of all shapes.
        hits: where surfaces are hit.
        footprint: derivatives of the hit point along the axes of the area that each hit stands for; None for points.
    """
    return take(materials, hits.shape)
