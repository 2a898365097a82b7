"""What surfaces are made of where rays hit them, textures and all."""

from typing import Any

from jaxtyping import Array, Float

from raytrace_jax.tracer.geometry.gather import take
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.shading.textures import texture_colors
from raytrace_jax.tracer.world import World


def materials_at(world: World, hits: Hits, footprint: Float[Array, "2 3 *rays"] | None = None) -> Any:
    """The material at each hit: every look-up goes through here. A texture scales emission and diffuse colour.

    Args:
        world: the scene.
        hits: where surfaces are hit.
        footprint: derivatives of the hit point along the axes of the area that each hit stands for; None for points.
    """
    material = take(world.materials, hits.shape)
    if world.textures is None:
        return material
    color = texture_colors(world.textures, world.shapes, hits, footprint)
    return material._replace(emission=material.emission * color, diffuse=material.diffuse * color)
