"""The physical model: exact Fresnel, media with absorption, mirrors, emission, and shadowed light on matt surfaces.

Radiance is linear: nothing is clamped, nothing falls off along a ray but by absorption, and weights multiply:

    emission + transmission (R reflected + (1 - R) refracted)
             + (1 - transmission) (reflectivity reflected + diffuse / pi * sum of I cos / r^2)

with R by Fresnel's equations for unpolarised light, all of it times the absorption on the way to the surface. Radiance
is not scaled by the squared index on refraction: from outside of all glass it cancels.
"""

import functools
import math
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.optics import reflect, refract
from raytrace_jax.optics.fresnel import reflected_share
from raytrace_jax.tracer.geometry.intersection import Hits, Nodes, least_distance
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.environment import background_radiance
from raytrace_jax.tracer.shading.lights import light_samples
from raytrace_jax.tracer.shading.media import media_at, ratio, transmittance
from raytrace_jax.tracer.shading.model import Children, Model
from raytrace_jax.tracer.shading.quadrature import mean, nodes_of
from raytrace_jax.tracer.shading.shadows import light_shares
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import dot, materialize, per_ray


class Surface(eqx.Module):
    """What is kept of a hit until the colours of its children are known.

    Args:
        local: emission and diffuse light.
        mirror: weight of the reflected ray.
        through: weight of the transmitted ray.
        transmittance: what the way to the hit lets through.
    """

    local: Float[Array, "3 *rays"]
    mirror: Float[Array, " *rays"]
    through: Float[Array, " *rays"]
    transmittance: Float[Array, "3 *rays"]


def shade(
    hits: Hits,
    rays: Rays,
    world: World,
    m: Any,
    settings: ResolvedSettings,
    nodes: Nodes | None = None,
) -> tuple[Surface, Children]:
    """Light of its own at each hit, and the rays that it sends on; Fresnel's weight is the mean over `nodes`."""
    d, n = rays.d, hits.n
    entering = dot(d, n) < 0

    # What the ray came through, and what is behind the surface.
    media = media_at(world, hits, entering)
    eta = ratio(world, media)
    left = transmittance(world, media.front, hits)

    # How the light is shared out, and where it goes on.
    transmitted, _, total = refract(d, n, eta, nodes and nodes.spread)
    at = nodes_of(hits, d, nodes)
    reflectance = mean(reflected_share(jnp.minimum(jnp.abs(dot(at.d, at.n)), 1), eta))
    opaque = 1 - m.transmission
    mirror = jnp.where(hits.valid, m.transmission * reflectance + opaque * m.reflectivity, 0)
    through = jnp.where(hits.valid & ~total, m.transmission * (1 - reflectance), 0)

    local = m.emission + opaque * m.diffuse * lambert_light(hits, at, entering, world, settings)
    surface = Surface(jnp.where(hits.valid, local, 0), mirror, through, left)
    children = Children(
        reflect=mirror > 0,
        transmit=through > 0,
        reflected=reflect(d, n),
        transmitted=transmitted,
        reflected_o=hits.p,
        transmitted_o=hits.p,
        path_length=hits.path_length,
        shape=hits.shape,
        entering=entering,
    )
    return surface, children


def lambert_light(
    hits: Hits, nodes: Nodes, entering: Bool[Array, " *rays"], world: World, settings: ResolvedSettings
) -> Float[Array, "3 *rays"]:
    """What a white matt surface shows of all lights that reach it: `I cos / (pi r^2)`, the mean over the nodes.

    What stands in the way of a light lets through as much as it transmits: glass does not block.
    """
    p, n = nodes.p, jnp.where(entering, nodes.n, -nodes.n)
    # A little off the surface, lest rounding decides on which side of it the way to a light begins.
    origins = p + least_distance(world.unit) * n
    transmission = world.materials.transmission
    total = jnp.zeros_like(hits.p)
    for light in light_samples(world.lights, p):
        cos = jnp.maximum(dot(n, light.toward) * light.inverse_distance, 0)
        share = light_shares(origins, hits.shape, light.location, entering, world, settings, transmission)
        irradiance = materialize(mean(share * cos / light.squared_distance), hits.valid)
        total += irradiance * per_ray(light.emissivity, hits.t.ndim) / math.pi
    return total


def relative_ior(
    world: World, hits: Hits, entering: Bool[Array, " *rays"], settings: ResolvedSettings
) -> Float[Array, " *rays"]:
    """`eta_t / eta_i` at each hit, of the media on its sides."""
    return ratio(world, media_at(world, hits, entering))


def combine(
    surface: Surface, reflected: Float[Array, "3 *rays"], transmitted: Float[Array, "3 *rays"]
) -> Float[Array, "3 *rays"]:
    """The colour of each hit, given the colours of the rays that it sent on (black for none)."""
    return surface.transmittance * (surface.local + surface.mirror * reflected + surface.through * transmitted)


def child_weights(surface: Surface) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"]]:
    """How much the reflected and the transmitted ray of each hit count in its colour: in the largest channel."""
    left = functools.reduce(jnp.maximum, surface.transmittance)
    return left * surface.mirror, left * surface.through


def medium(
    world: World, hits: Hits, entering: Bool[Array, " *rays"]
) -> tuple[Int[Array, " *rays"], Float[Array, "3 *rays"]]:
    """The medium that each ray runs through to its hit, and what it lets through."""
    front = media_at(world, hits, entering).front
    return front, transmittance(world, front, hits)


MODEL = Model(shade, combine, child_weights, attrgetter("transmission"), relative_ior, background_radiance, medium)
