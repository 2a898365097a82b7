"""Course model A: clamped 1/r lights without shadows, mirror, alpha-blended transmission, Schlick on request.

The model clamps colours at every surface, so that what a path contributes is not a product of factors: a surface
first says which rays it needs (`shade`), and blends their colours when these have come back (`combine`).
"""

import functools
import operator
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._numerics import any_nonzero, clamp01, dot
from ..geometry import file_order
from ..intersection import Hits, take
from ..optics import AIR_IOR, reflect, refract, schlick
from ..rays import Rays
from ..scene import Materials, PointLights, Scene
from ..settings import RenderSettings

LEAST_COSINE_SPREAD = 1e-6
"""Over a footprint the cosine towards a light varies at least that much where the terminator is smoothed."""

SQRT_4_3 = (4 / 3) ** 0.5
"""A Gauss-Legendre node of an interval lies that much farther from its middle than the middle of its half does."""


class ShapeMaterials(eqx.Module):
    """The material of each shape in the order of the file; the same fields as `Materials`."""

    ambient: Float[Array, "3 *shapes"]
    diffuse: Float[Array, "3 *shapes"]
    specular: Float[Array, "3 *shapes"]
    alpha: Float[Array, " *shapes"]
    ior: Float[Array, " *shapes"]


class Surface(eqx.Module):
    """What is kept of a hit until the colours of its children are known.

    Args:
        valid: something was hit; all else is black.
        local: ambient and diffuse light, clamped.
        highlight: specular light of the point lights, summed.
        diffuse: scales `local` once more where there is a mirror ray.
        mirror: weight of the reflected ray in the specular step.
        alpha: weight of what shines through.
        reflectance: share of the reflected ray in what shines through; one under total internal reflection.
        shiny: the mirror step applies.
    """

    valid: Bool[Array, " *rays"]
    local: Float[Array, "3 *rays"]
    highlight: Float[Array, "3 *rays"]
    diffuse: Float[Array, "3 *rays"]
    mirror: Float[Array, "3 *rays"]
    alpha: Float[Array, " *rays"]
    reflectance: Float[Array, " *rays"]
    shiny: Bool[Array, " *rays"]


class Children(eqx.Module):
    """The rays that a hit sends on: one origin and path length, a reflected and a transmitted direction.

    `reflect` and `transmit` say which of them are wanted. Under total internal reflection the transmitted ray *is* the
    reflected one and is not traced twice. `shape` is the shape that was hit, `entering` whether it was hit on the side
    that its normal points to, `eta` the ratio of indices there.
    """

    reflect: Bool[Array, " *rays"]
    transmit: Bool[Array, " *rays"]
    reflected: Float[Array, "3 *rays"]
    transmitted: Float[Array, "3 *rays"]
    o: Float[Array, "3 *rays"]
    path_length: Float[Array, " *rays"]
    shape: Int[Array, " *rays"]
    entering: Bool[Array, " *rays"]
    eta: Float[Array, " *rays"]


def shape_materials(scene: Scene) -> ShapeMaterials:
    """The material of every shape, in the order of the file."""
    used = scene.planes.material + scene.spheres.material
    columns = jnp.asarray([used[place] for place in file_order(scene)], jnp.int32)
    m: Materials = scene.materials
    return ShapeMaterials(*(x[..., columns] for x in (m.ambient, m.diffuse, m.specular, m.alpha, m.ior)))


def shade(
    hits: Hits,
    rays: Rays,
    materials: ShapeMaterials,
    lights: PointLights,
    settings: RenderSettings,
    nodes: Sequence[tuple[Hits, Float[Array, "3 *rays"]]] = (),
) -> tuple[Surface, Children]:
    """Steps 1 to 3 and 6 of the course's model at each hit, and the rays that steps 4 and 5 need.

    The point lights' light is that at the hit, or the mean over `nodes`, pairs of a hit and the direction towards it.
    """
    m = take(materials, hits.shape)
    d, n = rays.d, hits.n
    d_dot_n = dot(d, n)
    entering = d_dot_n < 0

    # Step 2: ambient light falls off with the length of the whole path.
    ambient = clamp01(m.ambient / jnp.where(hits.valid, hits.path_length, 1))

    # Steps 3 and 6: point lights, without shadows, falling off with 1/r.
    diffuse_light, specular_light = light_sums(nodes or [(hits, d)], lights)
    local = clamp01(ambient + diffuse_light * m.diffuse)

    # Step 5: refraction, with the course's ratio or the physical one on the way out.
    eta = relative_ior(m.ior, entering, settings)
    transmitted, cos_theta_t, total = refract(d, n, eta)
    reflected = reflect(d, n)

    # Which rays to send on. A transparent surface that reflects totally sends the reflected ray in place of both.
    shiny = hits.valid & any_nonzero(m.specular) & settings.reflection
    transparent = hits.valid & (m.alpha > 0)
    total = total & transparent
    if settings.reflectance == "schlick":
        reflectance = schlick(jnp.where(entering, -d_dot_n, cos_theta_t), m.ior)
        wants_reflected = shiny | transparent
    else:
        reflectance = jnp.zeros_like(m.alpha)
        wants_reflected = shiny | total
    if settings.total_internal_reflection:
        reflectance = jnp.where(total, 1, reflectance)
    else:
        wants_reflected = wants_reflected & ~(total & ~shiny)
        reflectance = jnp.where(total, 0, reflectance)

    surface = Surface(
        valid=hits.valid,
        local=local,
        highlight=specular_light * m.specular,
        diffuse=m.diffuse,
        mirror=m.specular,
        alpha=jnp.where(transparent, m.alpha, 0),
        reflectance=reflectance,
        shiny=shiny,
    )
    children = Children(
        reflect=wants_reflected,
        transmit=transparent & ~total,
        reflected=reflected,
        transmitted=transmitted,
        o=hits.p,
        path_length=hits.path_length,
        shape=hits.shape,
        entering=entering,
        eta=eta,
    )
    return surface, children


def relative_ior(
    ior: Float[Array, " *rays"], entering: Bool[Array, " *rays"], settings: RenderSettings
) -> Float[Array, " *rays"]:
    """`eta_t / eta_i` at a surface; on the way out by the course's convention or the physical one."""
    leaving = AIR_IOR / ior if settings.eta == "physical" else 1 / (AIR_IOR * ior)
    return jnp.where(entering, ior / AIR_IOR, leaving)


def light_sums(
    nodes: Sequence[tuple[Hits, Float[Array, "3 *rays"]]], lights: PointLights
) -> tuple[Float[Array, "3 *rays"], Float[Array, "3 *rays"]]:
    """Light that reaches each hit, weighted for the diffuse and for the specular colour: the mean over the nodes.

    The specular weight is `(R.V)^32`, an even power of a cosine that nothing keeps positive: the far side of the
    reflection lights up as well. That is the course's model.
    """

    def one_light(k: int):
        rays = [toward_light(hits, d, column(lights.location, k, hits.t.ndim)) for hits, d in nodes]
        shares = lit_shares([cos for cos, _, _ in rays])
        diffuse = mean([jnp.where((cos > 0) & (cos < 1), inverse_r, 0) * cos for cos, inverse_r, _ in rays])
        specular = mean([share * inverse_r * lobe for share, (_, inverse_r, lobe) in zip(shares, rays, strict=True)])
        emissivity = column(lights.emissivity, k, diffuse.ndim)
        return diffuse * emissivity, specular * emissivity

    def add(a, b):
        return a[0] + b[0], a[1] + b[1]

    none = jnp.zeros_like(nodes[0][0].p)
    return functools.reduce(add, (one_light(k) for k in range(len(lights.names))), (none, none))


def toward_light(
    hits: Hits, d: Float[Array, "3 *rays"], location: Float[Array, "3 *ones"]
) -> tuple[Float[Array, " *rays"], ...]:
    """Cosine of a light's direction and the normal, the falloff 1/r, and the highlight's lobe `(R.V)^32`."""
    to_light = location - hits.p
    squared = dot(to_light, to_light)
    inverse_r = 1 / jnp.sqrt(jnp.where(squared > 0, squared, 1))
    cos = dot(hits.n, to_light) * inverse_r
    # R.V with R = reflect(L, n) and V = -d, without building R.
    lobe = 2 * cos * dot(d, hits.n) - dot(to_light, d) * inverse_r
    for _ in range(5):
        lobe = lobe * lobe
    return cos, inverse_r, lobe


def lit_shares(cosines: Sequence[Float[Array, " *rays"]]) -> list[Float[Array, " *rays"]]:
    """The share of each node's part of a footprint that faces the light; of a single point whether it does.

    A highlight, unlike diffuse light, does not fade towards the terminator: it is cut off there. The cosine varies
    linearly over a footprint; each of its four nodes stands for a quarter, whose middle is nearer to the middle of the
    whole than the node is.
    """
    if len(cosines) == 1:
        (cos,) = cosines
        return [jnp.where((cos > 0) & (cos < 1), 1, 0).astype(cos.dtype)]
    middle = mean(cosines)
    spread = functools.reduce(jnp.maximum, cosines) - functools.reduce(jnp.minimum, cosines)
    spread = jnp.maximum(jax.lax.stop_gradient(spread), LEAST_COSINE_SPREAD)
    return [clamp01(0.5 + (cos - middle + middle * SQRT_4_3) / spread) for cos in cosines]


def mean(values: Sequence[Float[Array, "*axes"]]) -> Float[Array, "*axes"]:
    """The mean of arrays; a single one as it is."""
    total = functools.reduce(operator.add, values)
    return total / len(values) if len(values) > 1 else total


def column(vectors: Float[Array, "3 entries"], k: int, ray_axes: int) -> Float[Array, "3 *ones"]:
    """Entry k of a struct of arrays, shaped to broadcast over rays."""
    return vectors[:, k].reshape((3,) + (1,) * ray_axes)


def combine(
    surface: Surface, reflected: Float[Array, "3 *rays"], transmitted: Float[Array, "3 *rays"]
) -> Float[Array, "3 *rays"]:
    """Steps 4 to 6: the colour of each hit, given the colours of the rays that it sent on (black for none)."""
    mirrored = clamp01(surface.diffuse * surface.local + surface.mirror * reflected)
    color = jnp.where(surface.shiny, mirrored, surface.local)

    through = transmitted + surface.reflectance * (reflected - transmitted)
    color = clamp01(color + surface.alpha * (through - color))

    # All highlights are added before the one clamp: for lights and colours >= 0 that is clamping after each.
    return jnp.where(surface.valid, clamp01(color + surface.highlight), 0)


def child_weights(surface: Surface) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"]]:
    """About how much the reflected and the transmitted ray of each hit count in its colour: for the largest channel."""
    mirror = jnp.where(surface.shiny, functools.reduce(jnp.maximum, surface.mirror), 0)
    reflected = mirror + surface.alpha * (surface.reflectance - mirror)
    return reflected, surface.alpha * (1 - surface.reflectance)
