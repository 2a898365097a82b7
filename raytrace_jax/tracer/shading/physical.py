"""The physical model: exact Fresnel, media with absorption, mirrors, emission, and shadowed light on matt surfaces.

Radiance is linear: nothing is clamped, nothing falls off along a ray but by absorption, and weights multiply:

    emission + transmission (R reflected + (1 - R) refracted)
             + (1 - transmission) (reflectivity reflected + diffuse / pi * sum of I cos / r^2)

with R by Fresnel's equations for unpolarised light, all of it times the absorption on the way to the surface. Radiance
is not scaled by the squared index on refraction: from outside of all glass it cancels.

Of all glass shapes around a point that of the least volume decides what is there, so that a bubble lies in its ball.
Priorities by size (Schmidt and Budge 2002, "Simple nested dielectrics in ray traced images") need no list of what a
path has entered: they say what is on either side of any surface, for any ray alike.
"""

import functools
import math
from operator import attrgetter
from typing import Any

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from ...optics import reflect, refract
from ...optics.fresnel import reflected_share
from ...scene.scene import least_distance
from ...scene.schema import NO_BLOCK
from ...util.numerics import dot, materialize, per_ray
from ..geometry.footprints import mean
from ..geometry.intersection import Nodes, SurfaceInteraction
from ..geometry.rays import NO_SHAPE, Flags, Integers, Pairs, Rays, Scalars, Vectors, take_column
from ..geometry.shape_types import SHAPE_TYPES, fold_shapes
from ..geometry.shapes import Faces, ShapeType
from ..geometry.solid import belongs, is_inside
from ..world import World
from .image_texture import environment_colors
from .model import Children, LightSample, Media, Model, Surface, black, light_fractions, over_lights


class AbsorbedSurface(Surface):
    transmittance: Vectors  # What the way to the hit lets through.

    def combine(self, reflected: Vectors, transmitted: Vectors) -> Vectors:
        return self.transmittance * super().combine(reflected, transmitted)

    def child_weights(self) -> tuple[Scalars, Scalars]:
        left = functools.reduce(jnp.maximum, self.transmittance)
        return left * self.mirror, left * self.through


def shade(
    si: SurfaceInteraction, rays: Rays, world: World, media: Media, m: Any, nodes: Nodes
) -> tuple[AbsorbedSurface, Children]:
    """Light of its own at each hit, and the rays that it sends on; Fresnel's weight is the mean over `nodes`."""
    d, n = rays.d, si.n
    entering = dot(d, n) < 0

    # How the light is divided, and where it goes on.
    transmitted, _, total = refract(d, n, media.eta, nodes.spread)
    cos = jnp.abs(dot(nodes.d, nodes.n))
    # Each node stands for half the range.
    spread = None if nodes.spread is None else jnp.broadcast_to(nodes.spread / 2, cos.shape)
    reflectance = mean(reflected_share(cos, media.eta, spread))
    opaque = 1 - m.transmission
    mirror = jnp.where(si.valid, m.transmission * reflectance + opaque * m.reflectivity, 0)
    through = jnp.where(si.valid & ~total, m.transmission * (1 - reflectance), 0)

    assert media.transmittance is not None, "this model has media"
    local = m.emission + opaque * m.diffuse * lambert_light(si, nodes, entering, world)
    surface = AbsorbedSurface(jnp.where(si.valid, local, 0), mirror, through, media.transmittance)
    return surface, Children(mirror > 0, through > 0, reflect(d, n), transmitted, entering)


def lambert_light(si: SurfaceInteraction, nodes: Nodes, entering: Flags, world: World) -> Vectors:
    """The light of all lights that a white matt surface shows: `I cos / (pi r^2)`, the mean over the nodes.

    What stands in the way of a light lets through as much as it transmits: glass does not block.
    """
    p, n = nodes.p, jnp.where(entering, nodes.n, -nodes.n)
    # A little off the surface, lest rounding decides on which side of it the way to a light begins.
    origins = p + least_distance(world.unit) * n
    transmission = world.materials.transmission

    def one_light(light: LightSample) -> Scalars:
        cos = jnp.maximum(dot(n, light.toward) * light.inverse_distance, 0)
        fraction = light_fractions(origins, si.shape, light.location, entering, world, transmission)
        return mean(fraction * cos * (1 / light.squared_distance))

    irradiance = materialize(over_lights(one_light, world.lights, p), si.valid)
    emissivity = world.lights.emissivity.reshape(*world.lights.emissivity.shape, *(1,) * si.t.ndim)
    return jnp.sum(emissivity * irradiance, 1) / math.pi


def media_at(world: World, si: SurfaceInteraction, entering: Flags) -> Media:
    """The media in front of each hit and behind it; a surface that is not glass parts nothing.

    Light falls by `exp(-absorption t)` on the way through one (Beer-Lambert); where there is no hit all of it is left.
    """
    (outside, inside), (_, size) = innermost(world, si)
    columns = world.materials.transmission, stop_gradient(world.shapes.size)
    transmission, own = (take_column(column, si.shape) for column in columns)
    first = (own < size) | ((own == size) & (si.shape < inside))
    within = jnp.where(stop_gradient(transmission > 0) & (first | (inside == NO_SHAPE)), si.shape, inside)
    front, back = jnp.where(entering, outside, within), jnp.where(entering, within, outside)
    t = jnp.where(si.valid, si.t, 0)
    absorption = take_column(world.materials.absorption, jnp.maximum(front, 0))
    left = jnp.exp(-jnp.where(front == NO_SHAPE, 0, absorption) * t)
    return Media(index_of(world, back) / index_of(world, front), front, jnp.where(si.valid, left, 1))


def innermost(world: World, si: SurfaceInteraction) -> tuple[Int[Array, "2 *rays"], Pairs]:
    """The smallest glass shape on the outer and the inner side of each hit, and its size; what is hit is left out.

    Each side is asked half the least distance of a hit off the surface: surfaces that coincide are crossed together.
    """
    shapes, transmission, p, n = stop_gradient((world.shapes, world.materials.transmission, si.p, si.n))
    off = least_distance(world.unit) / 2 * n
    p = jnp.stack([p + off, p - off], axis=1)

    def ask(shape_type: ShapeType, faces: Faces, index):
        holds = is_inside(p, faces) & (transmission[index] > 0) & ~belongs(si.shape, index, shape_type.face_count)
        return holds, faces[0].size, index

    def smaller(best, found):
        (best_size, best_index), (holds, size, index) = best, found
        closer = holds & ((size < best_size) | ((size == best_size) & ((index < best_index) | (best_index < 0))))
        return jnp.where(closer, size, best_size), jnp.where(closer, index, best_index)

    sides = p.shape[1:]
    nothing = jnp.full(sides, jnp.inf, p.dtype), jnp.full(sides, NO_SHAPE, si.shape.dtype)
    hollow = [name for name, shape_type in SHAPE_TYPES.items() if not shape_type.has_inside]
    size, index = fold_shapes(shapes, ask, smaller, nothing, leave_out=hollow)
    return index, size


def index_of(world: World, medium: Integers) -> Scalars:
    return jnp.where(medium == NO_SHAPE, 1.0, take_column(world.materials.ior, jnp.maximum(medium, 0)))


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
    axes = None if rays.footprint is None else rays.footprint.d
    return radiance * environment_colors(pyramid, rays.d, axes)


MODEL = Model(shade, attrgetter("transmission"), media_at, background_radiance)
