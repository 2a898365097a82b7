"""A level of rays: each is intersected and shaded, and sends rays on."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...optics import reflect, refract
from ...scene.setting_words import ModelName
from ...util.numerics import dot, materialize, renormalize, select
from ..geometry.intersection import Hits, Nodes, intersect
from ..geometry.rays import NO_SHAPE, Beam, Flags, Footprint, Integers, Pairs, Rays, Scalars, take
from ..resolved_settings import ResolvedSettings
from ..shading import additive, classic, physical
from ..shading.model import Children, Model, materials_at
from ..visibility import footprints
from ..visibility.look import look
from ..world import World

MODELS: dict[ModelName, Model] = {"classic": classic.MODEL, "additive": additive.MODEL, "physical": physical.MODEL}
"""The models, by the names of `RenderSettings.model`: a new one is a file in `shading` and an entry here."""


class Scattering(eqx.Module):
    """The part of a ray's colour that does not come from the rays that it sends on."""

    surface: eqx.Module | None  # What the model keeps for `combine`; None where there is nothing to hit.
    background: Float[Array, "3 *#rays"]
    coverage: Scalars | None = None  # Fraction of each ray's footprint that sees the hit; None of points, as the next.
    subdivided: Flags | None = None  # Whose children are the thirds of their footprint.
    sees_edge: Flags | None = None  # Whose footprint is split or subdivided.


class Level(eqx.Module):
    si: Hits
    scattering: Scattering
    children: list[tuple[Flags, Rays]]  # Which are wanted of the reflected, transmitted and passing rays.


@functools.partial(jax.jit, static_argnames="settings")
def trace_level(world: World, rays: Rays, live: Flags, number: Integers, settings: ResolvedSettings) -> Level:
    """Intersect and shade rays; `number` counts those before each of them, from 0 for camera rays.

    It is jitted within the programs that call it. Each rule of a loop, a condition and a derivative around it would
    trace it anew; so JAX keeps its jaxpr, its derivative and its batched form, and makes each of them once.
    """
    if not world.shapes.types:
        si = intersect(world.shapes, rays, live, world.unit, settings)
        return Level(si, Scattering(None, MODELS[settings.model].background(world, rays)), [])
    if settings.edges != "aware":
        return point_level(world, rays, live, settings)
    return area_level(world, rays, live, number, settings)


def point_level(world: World, rays: Rays, live: Flags, settings: ResolvedSettings) -> Level:
    model = MODELS[settings.model]
    si = intersect(world.shapes, rays, live, world.unit, settings)
    media = model.media(world, si, dot(rays.d, si.n) < 0, settings)
    nodes = Nodes(si.p, si.n, rays.d)
    surface, children = model.shade(si, rays, world, media, materials_at(world, si), settings, nodes)
    throughput = None
    if rays.throughput is not None:
        throughput = rays.throughput * jax.lax.stop_gradient(jnp.stack(model.child_weights(surface)))
    scattering = Scattering(surface, model.background(world, rays))
    return Level(si, scattering, scattered_rays(si, children, throughput, None, settings))


def area_level(world: World, rays: Rays, live: Flags, number: Integers, settings: ResolvedSettings) -> Level:
    # Levels that the path's remaining bounces do not need are there for passing edges and for subdividing.
    has_levels = settings.levels - number > settings.max_bounces - rays.beam.depth
    si, near, seen, passes, past = look(world.shapes, rays, live, has_levels, world.unit, settings)
    surface, children, spread = scatter_areas(world, near, si, seen, settings)
    subdivided, second = footprints.wants_subdivision(rays, spread, has_levels & live, settings)

    children = [*children, (passes, past)]
    children = [
        (wanted | subdivided, select(subdivided, part, child))
        for (wanted, child), part in zip(children, footprints.subdivide(rays, second), strict=True)
    ]
    background = MODELS[settings.model].background(world, near)
    return Level(si, Scattering(surface, background, seen, subdivided, passes | subdivided), children)


def scatter_areas(
    world: World, rays: Rays, si: Hits, coverage: Scalars, settings: ResolvedSettings
) -> tuple[eqx.Module, list[tuple[Flags, Rays]], Pairs]:
    """Shade footprints, of which `coverage` is what is left, and send them on from where they hit.

    Returns:
        What the model keeps; the reflected and the transmitted rays, as `scattered_rays`; and along both axes of the
        footprint the squares of their spreads, times their throughputs.
    """
    model = MODELS[settings.model]
    shape = take(world.shapes, si.shape)

    # How the footprint goes on from the surface, by the index of refraction at its middle.
    media = model.media(world, si, dot(rays.d, si.n) < 0, settings)
    eta = jax.lax.stop_gradient(media.eta)
    p_axes, reflected, transmitted = footprints.transport(
        rays, si, shape, lambda d, n: (reflect(d, n), refract(d, n, eta)[0])
    )
    nodes = materialize(footprints.light_nodes(rays, si, shape, p_axes), si.valid)
    surface, children = model.shade(si, rays, world, media, materials_at(world, si, p_axes), settings, nodes)

    # Which rays are wanted, how much they count, and whose footprint spreads too widely for that.
    beam = rays.beam
    wanted = jnp.stack([children.reflect, children.transmit]) & (beam.depth < settings.max_bounces)
    children = eqx.tree_at(lambda c: (c.reflect, c.transmit), children, tuple(wanted))
    weights = jax.lax.stop_gradient(coverage * jnp.stack(model.child_weights(surface)))
    throughput = jnp.where(wanted, rays.throughput * weights, 0)
    squares = [footprints.spread_squared(axes) for axes in (reflected, transmitted)]
    spread = throughput[0] * squares[0] + throughput[1] * squares[1]

    nothing = jnp.full_like(beam.passed, NO_SHAPE)
    parts = [footprints.bounded(Footprint(p_axes, d), world.unit) for d in (reflected, transmitted)]
    beams = [Beam(part, nothing, beam.depth + 1, beam.subdivisions) for part in parts]
    return surface, scattered_rays(si, children, throughput, beams, settings), spread


def scattered_rays(
    si: Hits, c: Children, throughput: Pairs | None, beams: list[Beam] | None, settings: ResolvedSettings
) -> list[tuple[Flags, Rays]]:
    """The reflected and the transmitted rays of all hits, with those that are wanted and count enough."""
    # A reflected ray stays on the side that it came from, a transmitted one changes sides.
    wanted = jnp.stack([c.reflect, c.transmit])
    if throughput is not None and settings.least_weight > 0:
        wanted = wanted & (throughput >= settings.least_weight)
    p, shape = si.p, si.shape if c.off is None else jnp.full_like(si.shape, NO_SHAPE)
    near, far = (p, p) if c.off is None else (p + c.off, p - c.off)
    found = []
    for k, (o, d, inside) in enumerate(((near, c.reflected, ~c.entering), (far, c.transmitted, c.entering))):
        # Within a ball rounding errors of a direction's length grow fourfold with each reflection, if they are left.
        beam, own = None if beams is None else beams[k], None if throughput is None else throughput[k]
        found.append((wanted[k], Rays(o, renormalize(d), si.path_length, shape, inside, beam, own)))
    return found
