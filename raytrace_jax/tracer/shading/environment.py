"""What rays see that hit nothing: a colour, or a picture all around."""

from jaxtyping import Array, Float

from raytrace_jax.scene.schema import NO_BLOCK
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.shading.environment_texture import environment_at_directions, environment_over_footprints
from raytrace_jax.tracer.shading.model import black
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import per_ray


def background_radiance(world: World, rays: Rays) -> Float[Array, "3 *#rays"]:
    """The background's radiance in the rays' directions, times its texture where it has one; black if there is none."""
    background = world.background
    if background is None:
        return black(world, rays)
    radiance = per_ray(background.radiance, rays.d.ndim - 1)
    if background.texture == NO_BLOCK or world.textures is None:
        return radiance
    _, entry = world.textures.column[background.texture]
    pyramid = world.textures.pyramids[entry]
    if rays.edge_beam is None:
        return radiance * environment_at_directions(pyramid, rays.d)
    return radiance * environment_over_footprints(pyramid, rays.d, rays.beam.footprint.d)
