"""A level of rays: each is intersected and shaded, and sends rays on."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from ..optics import reflect, refract
from ..scene.setting_words import ModelName
from ..util.numerics import dot, materialize, renormalize, select
from .geometry import footprints
from .geometry.intersection import Nodes, SurfaceInteraction, intersect
from .geometry.rays import NO_SHAPE, Flags, Footprint, Integers, Pairs, Rays, Scalars, take
from .shading import additive, classic, physical
from .shading.model import Children, Model, materials_at
from .visibility.look import look
from .world import World

MODELS: dict[ModelName, Model] = {"classic": classic.MODEL, "additive": additive.MODEL, "physical": physical.MODEL}
"""The models, by the names of `RenderSettings.model`: a new one is a file in `shading` and an entry here."""


Sent = list[tuple[Flags, Rays]]
"""Which are wanted of the reflected, the transmitted and the passing rays, and these rays."""


class Scattering(eqx.Module):
    """The part of a ray's colour that does not come from the rays that it sends on."""

    surface: Any  # What is known of it before its rays come back; None where there is nothing to hit.
    background: Float[Array, "3 *#rays"]
    coverage: Scalars | None = None  # Fraction of each ray's footprint that sees the hit; None of points, as the next.
    subdivided: Flags | None = None  # Whose children are the thirds of their footprint.
    sees_edge: Flags | None = None  # Whose footprint is split or subdivided.


class Level(eqx.Module):
    si: SurfaceInteraction
    scattering: Scattering
    children: Sent


@jax.jit
def trace_level(world: World, rays: Rays, live: Flags, number: Integers) -> Level:
    """Intersect and shade rays; `number` counts those before each of them, from 0 for camera rays.

    It is jitted within the programs that call it. Each rule of a loop, a condition and a derivative around it would
    trace it anew; so JAX keeps its jaxpr, its derivative and its batched form, and makes each of them once.
    """
    if not world.shapes.types:
        si = intersect(world.shapes, rays, live, world.unit)
        return Level(si, Scattering(None, MODELS[world.settings.model].background(world, rays)), [])
    if world.settings.edges != "aware":
        return point_level(world, rays, live)
    return area_level(world, rays, live, number)


def point_level(world: World, rays: Rays, live: Flags) -> Level:
    model = MODELS[world.settings.model]
    si = intersect(world.shapes, rays, live, world.unit)
    media = model.media(world, si, dot(rays.d, si.n) < 0)
    nodes = Nodes(si.p, si.n, rays.d)
    surface, children = model.shade(si, rays, world, media, materials_at(world, si), nodes)
    throughput = None
    if rays.throughput is not None:
        throughput = rays.throughput * stop_gradient(jnp.stack(surface.child_weights()))
    scattering = Scattering(surface, model.background(world, rays))
    return Level(si, scattering, scattered_rays(si, children, throughput, [None, None], world.settings.least_weight))


def area_level(world: World, rays: Rays, live: Flags, number: Integers) -> Level:
    # Levels that the path's remaining bounces do not need are there for passing edges and for subdividing.
    settings = world.settings
    has_levels = settings.levels - number > settings.max_bounces - rays.footprint.depth
    si, near, seen, passes, past, corner = look(world.shapes, rays, live, has_levels, world.unit)
    surface, children, spread = scatter_areas(world, near, si, seen)
    subdivided, second = footprints.wants_subdivision(rays, spread, has_levels & live, settings.samples, corner)

    children = [*children, (passes, past)]
    children = [
        (wanted | subdivided, select(subdivided, part, child))
        for (wanted, child), part in zip(children, footprints.subdivide(rays, second), strict=True)
    ]
    background = MODELS[world.settings.model].background(world, near)
    return Level(si, Scattering(surface, background, seen, subdivided, passes | subdivided), children)


def scatter_areas(world: World, rays: Rays, si: SurfaceInteraction, coverage: Scalars) -> tuple[Any, Sent, Pairs]:
    """Shade footprints, of which `coverage` is what is left, and send them on from where they hit.

    Returns:
        What the model keeps; the reflected and the transmitted rays, as `scattered_rays`; and along both axes of the
        footprint the squares of their spreads, times their throughputs.
    """
    model = MODELS[world.settings.model]
    shape = take(world.shapes, si.shape)

    # How the footprint goes on from the surface, by the index of refraction at its middle.
    media = model.media(world, si, dot(rays.d, si.n) < 0)
    eta = stop_gradient(media.eta)
    p_axes, reflected, transmitted = footprints.transport(
        rays, si, shape, lambda d, n: (reflect(d, n), refract(d, n, eta)[0])
    )
    nodes = materialize(footprints.light_nodes(rays, si, shape, p_axes), si.valid)
    surface, children = model.shade(si, rays, world, media, materials_at(world, si, p_axes), nodes)

    # Which rays are wanted, how much they count, and whose footprint spreads too widely for that.
    depth = rays.footprint.depth
    wanted = jnp.stack([children.reflect, children.transmit]) & (depth < world.settings.max_bounces)
    children = eqx.tree_at(lambda c: (c.reflect, c.transmit), children, tuple(wanted))
    weights = stop_gradient(coverage * jnp.stack(surface.child_weights()))
    throughput = jnp.where(wanted, rays.throughput * weights, 0)
    squares = [footprints.spread_squared(axes) for axes in (reflected, transmitted)]
    spread = throughput[0] * squares[0] + throughput[1] * squares[1]

    nothing, subdivisions = jnp.full_like(rays.footprint.passed, NO_SHAPE), rays.footprint.subdivisions
    onward = [
        Footprint(*footprints.bounded(p_axes, d, world.unit), nothing, depth + 1, subdivisions)
        for d in (reflected, transmitted)
    ]
    return surface, scattered_rays(si, children, throughput, onward, world.settings.least_weight), spread


def scattered_rays(
    si: SurfaceInteraction,
    c: Children,
    throughput: Pairs | None,
    onward: list[Footprint] | list[None],
    least_weight: float,
) -> Sent:
    """The reflected and the transmitted rays of all hits, with those that are wanted and count enough."""
    # A reflected ray stays on the side that it came from, a transmitted one changes sides.
    wanted = jnp.stack([c.reflect, c.transmit])
    if throughput is not None and least_weight > 0:
        wanted = wanted & (throughput >= least_weight)
    p, shape = si.p, si.shape if c.off is None else jnp.full_like(si.shape, NO_SHAPE)
    near, far = (p, p) if c.off is None else (p + c.off, p - c.off)
    found = []
    for k, (o, d, inside) in enumerate(((near, c.reflected, ~c.entering), (far, c.transmitted, c.entering))):
        # Within a ball rounding errors of a direction's length grow fourfold with each reflection, if they are left.
        own = None if throughput is None else throughput[k]
        found.append((wanted[k], Rays(o, renormalize(d), si.path_length, shape, inside, onward[k], own)))
    return found
