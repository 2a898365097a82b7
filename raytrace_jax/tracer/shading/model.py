"""A shading model: what it takes of a hit, and what it gives to the tracer."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import Axes, Flags, Integers, Rays, Scalars, Vectors, take
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.textures import texture_colors
from raytrace_jax.tracer.world import World


class Children(eqx.Module):
    """The rays that a hit sends on: the directions of a reflected and a transmitted one, and which of them are wanted.

    Args:
        entering: whether it was hit on the side that its normal points to.
        off: the way by which they start off the surface, and know no shape as their origin; None if they start on it.
    """

    reflect: Flags
    transmit: Flags
    reflected: Vectors
    transmitted: Vectors
    entering: Flags
    off: Vectors | None = None


class Media(NamedTuple):
    """The media on both sides of a hit.

    Args:
        eta: `eta_t / eta_i`, the index behind the surface over that in front of it.
        front: the shape whose medium the ray ran through, or `NO_SHAPE`; None where the model has no media.
        transmittance: the fraction of radiance that it lets through; None as above.
    """

    eta: Scalars
    front: Integers | None = None
    transmittance: Vectors | None = None


class Model(NamedTuple):
    """A model of what light does at surfaces and between them; its rules for paths are `settings.MODEL_RULES`.

    Args:
        shade: what a surface shows of its own, and the rays that it sends on: from hits, rays, the world, the media and
            the material at each hit, settings, and quadrature nodes in each footprint (none for points), to what
            `combine` needs and `Children`.
        combine: the colour of each hit from that and the colours of the rays that it sent on (black for none).
        child_weights: about how much the reflected and the transmitted ray count in that colour.
        transparency: of materials, how much of what shines through counts; not 0 where they are transparent.
        media: those at each hit: from the world, hits, whether the ray enters, and settings.
        background: what rays that hit nothing see: from the world and rays to colours, "3 *#rays".
    """

    shade: Callable[..., tuple[Any, Children]]
    combine: Callable[[Any, Array, Array], Vectors]
    child_weights: Callable[[Any], tuple[Array, Array]]
    transparency: Callable[[Any], Scalars]
    media: Callable[[World, Hits, Flags, ResolvedSettings], Media]
    background: Callable[[World, Rays], Float[Array, "3 *#rays"]]


def black(world: World, rays: Rays) -> Float[Array, "3 *ones"]:
    """The background of the course's models: nothing is there."""
    return jnp.zeros((3,) + (1,) * (rays.d.ndim - 1), rays.d.dtype)


def materials_at(world: World, hits: Hits, footprint: Axes | None = None) -> Any:
    """The material at each hit, with emission and diffuse colour scaled by a texture; `footprint` as it wants it."""
    material = take(world.materials, hits.shape)
    if world.textures is None:
        return material
    color = texture_colors(world.textures, world.shapes, hits, footprint)
    return material._replace(emission=material.emission * color, diffuse=material.diffuse * color)
