"""Course model B, of the report on checkpoints 4 to 6: 1/r^2 lights with shadows, mirror, Fresnel, transmission.

All parts are added: no surface scales down what it shows of its own, and nothing is clamped. A hit's normal is turned
to face the ray; where it had to be turned the ray is inside. Rays that a hit sends on start off its surface
(`off_surface`), so that they do not meet it again.
"""

import functools
import operator
from operator import attrgetter
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...optics import reflect, refract
from ...optics.fresnel import schlick_share
from ...util.numerics import dot, per_ray, safe_normalize
from ..geometry.footprints import mean, positive_fractions, total_fraction
from ..geometry.intersection import Nodes, SurfaceInteraction
from ..geometry.rays import Flags, Rays, Vectors, take_column
from ..world import World
from .model import Children, LightSample, Media, Model, Surface, light_fractions, over_lights


def shade(
    si: SurfaceInteraction, rays: Rays, world: World, media: Media, m: Any, nodes: Nodes
) -> tuple[Surface, Children]:
    """Light of its own at each hit, and the rays that it sends on.

    The lights' light, and what is reflected totally, is that at the hit or the mean over `nodes`.
    """
    # The side that the ray comes from, and the light that the surface shows of its own.
    d, cos = rays.d, dot(rays.d, si.n)
    entering = cos < 0
    n = facing(si.n, entering)

    local = local_light(si, nodes, entering, m, world)

    # The mirror ray's weight, and what it leaves for the transmitted ray.
    cos_theta_i = jnp.abs(cos)
    mirror = m.reflectivity + m.fresnel * (schlick_share(cos_theta_i, m.ior) - m.reflectivity)
    reflects = si.valid & (mirror > 0) & world.settings.reflection

    # Total reflection lets nothing through and adds nothing; a footprint may straddle where it begins.
    eta = media.eta
    transmitted, _, total = refract(d, si.n, eta, nodes.spread)
    open_fraction = jnp.where(total, 0, 1).astype(mirror.dtype) if nodes.single else 1 - total_fraction(nodes, eta)
    through = jnp.where(si.valid, (1 - mirror) * m.transmission * open_fraction, 0)
    transmits = si.valid & (m.transmission > 0) & (open_fraction > 0)

    surface = Surface(local, jnp.where(reflects, mirror, 0), through)
    return surface, Children(reflects, transmits, reflect(d, n), transmitted, entering, off=off_surface(n, world))


def off_surface(n: Vectors, world: World) -> Vectors:
    # The report starts rays a thousandth of a unit of length off a surface.
    return 1e-3 * world.unit * n


def local_light(si: SurfaceInteraction, nodes: Nodes, entering: Flags, m: Any, world: World) -> Vectors:
    """Blinn-Phong light of all lights that reach a hit, and ambient light where none does: the mean over the nodes.

        sum_k e_k (diffuse max(n.l_k, 0) + specular (n.h_k)^hardness) / r_k^2,    h_k = (l_k - d) / |l_k - d|

    with `e_k` the light's emissivity and energy, `l_k` the direction to it, at distance `r_k`. (Blinn 1977, "Models of
    light reflection for computer synthesized pictures".)
    """
    p, n, d = nodes.p, facing(nodes.n, entering), nodes.d
    origins = p + off_surface(n, world)

    def one_light(light: LightSample) -> tuple[Vectors, Vectors, Array]:
        cos, above = dot(n, light.direction), positive_fractions(dot(n, light.direction))
        free = light_fractions(origins, si.shape, light.location, entering, world)
        # Diffuse light fades by itself towards where the light sets; a highlight does not.
        irradiance = free * light.energy * (1 / light.squared_distance)
        half = safe_normalize(light.direction - d)
        # The cosine to a power, whose logarithm stays finite: at 1e-6 a highlight is a millionth of its peak, or less.
        lobe = jnp.exp(m.hardness * jnp.log(jnp.maximum(dot(n, half), 1e-6)))
        emissivity = per_ray(light.emissivity, si.t.ndim)
        diffuse, specular = mean(irradiance * jnp.maximum(cos, 0)), mean(irradiance * above * lobe)
        return diffuse * emissivity, specular * emissivity, 1 - free * above

    diffuse, specular, dark = over_lights(one_light, world.lights, p)
    dark = functools.reduce(operator.mul, dark, jnp.ones_like(p[0]))
    local = m.diffuse * jnp.sum(diffuse, 0) + m.specular * jnp.sum(specular, 0) + m.diffuse * m.ambient * mean(dark)
    return jnp.where(si.valid, local, 0)


def facing(n: Vectors, entering: Bool[Array, " *#rays"]) -> Vectors:
    return jnp.where(entering, n, -n)


def media_at(world: World, si: SurfaceInteraction, entering: Flags) -> Media:
    """`eta_t / eta_i` at each hit, between its material and vacuum."""
    ior = take_column(world.materials.ior, si.shape)
    return Media(jnp.where(entering, ior, 1 / ior))


MODEL = Model(shade, attrgetter("transmission"), media_at)
