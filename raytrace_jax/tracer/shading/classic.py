"""Course model A: clamped 1/r lights without shadows, mirror, alpha-blended transmission, Schlick on request.

The model clamps colours at every surface, so that what a path contributes is no product of factors.
"""

import functools
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ...optics import AIR_IOR, reflect, refract
from ...optics.fresnel import schlick_share
from ...scene.scene import PointLights
from ...util.numerics import any_nonzero, clamp01, dot, materialize
from ..geometry.footprints import mean, positive_fractions, total_fraction
from ..geometry.intersection import Nodes, SurfaceInteraction
from ..geometry.rays import Flags, Rays, Scalars, Vectors, take_column
from ..world import World
from .model import Children, LightSample, Media, Model, over_lights


class ClampedSurface(eqx.Module):
    local: Vectors  # Ambient and diffuse light, clamped.
    highlight: Vectors  # Specular light of the point lights, summed.
    diffuse: Vectors  # Scales `local` once more where there is a mirror ray.
    mirror: Vectors  # Weight of the reflected ray in the specular step.
    alpha: Scalars  # Weight of what shines through.
    reflectance: Scalars  # Fraction of the reflected ray in what shines through; one under total internal reflection.
    shiny: Flags  # The mirror step applies.

    def combine(self, reflected: Vectors, transmitted: Vectors) -> Vectors:
        """Steps 4 to 6."""
        mirrored = clamp01(self.diffuse * self.local + self.mirror * reflected)
        color = jnp.where(self.shiny, mirrored, self.local)

        through = transmitted + self.reflectance * (reflected - transmitted)
        color = clamp01(color + self.alpha * (through - color))

        # All highlights are added before the one clamp: for lights and colours >= 0 that is clamping after each.
        return clamp01(color + self.highlight)

    def child_weights(self) -> tuple[Scalars, Scalars]:
        mirror = jnp.where(self.shiny, functools.reduce(jnp.maximum, self.mirror), 0)
        reflected = mirror + self.alpha * (self.reflectance - mirror)
        return reflected, self.alpha * (1 - self.reflectance)


def shade(
    si: SurfaceInteraction, rays: Rays, world: World, media: Media, m: Any, nodes: Nodes
) -> tuple[ClampedSurface, Children]:
    """Steps 1 to 3 and 6 of the course's model at each hit, and the rays that steps 4 and 5 need.

    The point lights' light is that at the hit, or the mean over `nodes`; no shape casts a shadow.
    """
    d, n, settings = rays.d, si.n, world.settings
    d_dot_n = dot(d, n)
    entering = d_dot_n < 0

    # Step 2: ambient light falls off with the length of the whole path.
    ambient = clamp01(m.ambient / jnp.where(si.valid, si.path_length, 1))

    # Steps 3 and 6: point lights, without shadows, falling off with 1/r.
    diffuse_light, specular_light = light_sums(nodes, si.valid, world.lights)
    local = clamp01(ambient + diffuse_light * m.diffuse)

    # Step 5: refraction.
    eta = media.eta
    transmitted, cos_theta_t, total = refract(d, n, eta, nodes.spread)

    # Which rays to send on. A transparent surface that reflects totally sends the reflected ray in place of both.
    # What the switches of the settings leave out is taken away afterwards.
    shiny = si.valid & any_nonzero(m.specular) & settings.reflection
    transparent = si.valid & (m.alpha > 0)
    total = total & transparent
    wants_transmitted = transparent & ~total
    if settings.reflectance == "schlick":
        reflectance = schlick_share(jnp.where(entering, -d_dot_n, cos_theta_t), m.ior)
        wants_reflected = shiny | transparent
    else:
        reflectance = jnp.zeros_like(m.alpha)
        wants_reflected = shiny | total
    if settings.total_internal_reflection:
        reflectance = jnp.where(total, 1, reflectance)
    else:
        wants_reflected = wants_reflected & ~(total & ~shiny)
        reflectance = jnp.where(total, 0, reflectance)
    if not nodes.single and settings.reflectance == "none" and settings.total_internal_reflection:
        # Without a Fresnel weight the picture jumps at the critical angle, which a footprint may straddle.
        reflectance = jnp.where(transparent, total_fraction(nodes, eta), 0)
        wants_reflected = shiny | (reflectance > 0)
        wants_transmitted = transparent & (reflectance < 1)

    alpha = jnp.where(transparent, m.alpha, 0)
    surface = ClampedSurface(local, specular_light * m.specular, m.diffuse, m.specular, alpha, reflectance, shiny)
    return surface, Children(wants_reflected, wants_transmitted, reflect(d, n), transmitted, entering)


def media_at(world: World, si: SurfaceInteraction, entering: Flags) -> Media:
    """`eta_t / eta_i` at each hit; on the way out by the course's convention or the physical one."""
    ior = take_column(world.materials.ior, si.shape)
    leaving = AIR_IOR / ior if world.settings.eta == "physical" else 1 / (AIR_IOR * ior)
    return Media(jnp.where(entering, ior / AIR_IOR, leaving))


MODEL = Model(shade, attrgetter("alpha"), media_at)


def light_sums(nodes: Nodes, valid: Flags, lights: PointLights) -> tuple[Vectors, Vectors]:
    """Light that reaches each hit, weighted for the diffuse and for the specular colour: the mean over the nodes.

    The specular weight is `(R.V)^32`, an even power of a cosine that nothing keeps positive: the far side of the
    reflection lights up as well. That is the course's model.
    """
    view_cos = dot(nodes.d, nodes.n)

    def one_light(light: LightSample):
        inverse_r = light.inverse_distance
        cos = dot(nodes.n, light.toward) * inverse_r
        # R.V with R = reflect(L, n) and V = -d, without building R; its 32nd power.
        lobe = (2 * cos * view_cos - dot(light.toward, nodes.d) * inverse_r) ** 32
        lit = jnp.where((cos > 0) & (cos < 1), 1, 0).astype(cos.dtype)
        # Unlike diffuse light a highlight does not fade towards where the light sets: a footprint sees it in part.
        fraction = lit if nodes.single else positive_fractions(cos)
        return mean(lit * inverse_r * cos), mean(fraction * inverse_r * lobe)

    # Much to compute anew for each channel.
    diffuse, specular = materialize(over_lights(one_light, lights, nodes.p), valid)
    emissivity = lights.emissivity[:, :, None]
    return jnp.sum(emissivity * diffuse, 1), jnp.sum(emissivity * specular, 1)
