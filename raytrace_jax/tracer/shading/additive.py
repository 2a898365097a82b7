"""Course model B, of the report on checkpoints 4 to 6: 1/r^2 lights with shadows, mirror, Fresnel, transmission.

All parts are added: no surface scales down what it shows of its own, and nothing is clamped. A hit's normal is turned
to face the ray; where it had to be turned the ray is inside. Rays that a hit sends on start off its surface
(`off_surface`), so that they do not meet it again.
"""

import functools
import operator
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...optics import reflect, refract
from ...optics.fresnel import schlick_share
from ...util.numerics import dot, per_ray, safe_normalize
from ..geometry.intersection import Hits, Nodes
from ..geometry.rays import Flags, Rays, Scalars, Vectors, take_column
from ..resolved_settings import ResolvedSettings
from ..world import World
from .model import Children, LightSample, Media, Model, black, light_fractions, over_lights
from .quadrature import mean, positive_fractions, total_fraction


class Surface(eqx.Module):
    local: Vectors  # Ambient light, diffuse light and highlights.
    mirror: Scalars
    through: Scalars


def shade(
    hits: Hits, rays: Rays, world: World, media: Media, m: Any, settings: ResolvedSettings, nodes: Nodes
) -> tuple[Surface, Children]:
    """Light of its own at each hit, and the rays that it sends on.

    The lights' light, and what is reflected totally, is that at the hit or the mean over `nodes`.
    """
    # The side that the ray comes from, and the light that the surface shows of its own.
    d, cos = rays.d, dot(rays.d, hits.n)
    entering = cos < 0
    n = facing(hits.n, entering)

    local = local_light(hits, nodes, entering, m, world, settings)

    # The mirror ray's weight, and what it leaves for the transmitted ray.
    cos_theta_i = jnp.abs(cos)
    mirror = m.reflectivity + m.fresnel * (schlick_share(cos_theta_i, m.ior) - m.reflectivity)
    reflects = hits.valid & (mirror > 0) & settings.reflection

    # Total reflection lets nothing through and adds nothing; a footprint may straddle where it begins.
    eta = media.eta
    transmitted, _, total = refract(d, hits.n, eta, nodes.spread)
    open_fraction = jnp.where(total, 0, 1).astype(mirror.dtype) if nodes.single else 1 - total_fraction(nodes, eta)
    through = jnp.where(hits.valid, (1 - mirror) * m.transmission * open_fraction, 0)
    transmits = hits.valid & (m.transmission > 0) & (open_fraction > 0)

    surface = Surface(local, jnp.where(reflects, mirror, 0), through)
    return surface, Children(reflects, transmits, reflect(d, n), transmitted, entering, off=off_surface(n, world))


def off_surface(n: Vectors, world: World) -> Vectors:
    # The report starts rays a thousandth of a unit of length off a surface.
    return 1e-3 * world.unit * n


def local_light(hits: Hits, nodes: Nodes, entering: Flags, m: Any, world: World, settings: ResolvedSettings) -> Vectors:
    """Blinn-Phong light of all lights that reach a hit, and ambient light where none does: the mean over the nodes.

        sum_k e_k (diffuse max(n.l_k, 0) + specular (n.h_k)^hardness) / r_k^2,    h_k = (l_k - d) / |l_k - d|

    with `e_k` the light's emissivity and energy, `l_k` the direction to it, at distance `r_k`. (Blinn 1977, "Models of
    light reflection for computer synthesized pictures".)
    """
    p, n, d = nodes.p, facing(nodes.n, entering), nodes.d
    origins = p + off_surface(n, world)

    def one_light(light: LightSample) -> tuple[Vectors, Vectors, Array]:
        cos, above = dot(n, light.direction), positive_fractions(dot(n, light.direction))
        free = light_fractions(origins, hits.shape, light.location, entering, world, settings)
        # Diffuse light fades by itself towards where the light sets; a highlight does not.
        irradiance = free * light.energy * (1 / light.squared_distance)
        half = safe_normalize(light.direction - d)
        # The cosine to a power, whose logarithm stays finite: at 1e-6 a highlight is a millionth of its peak, or less.
        lobe = jnp.exp(m.hardness * jnp.log(jnp.maximum(dot(n, half), 1e-6)))
        emissivity = per_ray(light.emissivity, hits.t.ndim)
        diffuse, specular = mean(irradiance * jnp.maximum(cos, 0)), mean(irradiance * above * lobe)
        return diffuse * emissivity, specular * emissivity, 1 - free * above

    diffuse, specular, dark = over_lights(one_light, world.lights, p)
    dark = functools.reduce(operator.mul, dark, jnp.ones_like(p[0]))
    local = m.diffuse * jnp.sum(diffuse, 0) + m.specular * jnp.sum(specular, 0) + m.diffuse * m.ambient * mean(dark)
    return jnp.where(hits.valid, local, 0)


def facing(n: Vectors, entering: Bool[Array, " *#rays"]) -> Vectors:
    return jnp.where(entering, n, -n)


def media_at(world: World, hits: Hits, entering: Flags, settings: ResolvedSettings) -> Media:
    """`eta_t / eta_i` at each hit, between its material and vacuum."""
    ior = take_column(world.materials.ior, hits.shape)
    return Media(jnp.where(entering, ior, 1 / ior))


def combine(surface: Surface, reflected: Vectors, transmitted: Vectors) -> Vectors:
    return surface.local + surface.mirror * reflected + surface.through * transmitted


def child_weights(surface: Surface) -> tuple[Scalars, Scalars]:
    return surface.mirror, surface.through


MODEL = Model(shade, combine, child_weights, attrgetter("transmission"), media_at, black)
