"""One level of rays: intersected, shaded, and the rays that it sends on; for points, and for areas."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.optics import reflect, refract
from raytrace_jax.tracer.geometry.intersection import Hits, intersect
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Beam, Footprint, Rays, take
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.model import Children, materials_at
from raytrace_jax.tracer.shading.models import MODELS
from raytrace_jax.tracer.visibility.footprints import (
    bounded,
    light_nodes,
    spread_squared,
    subdivide,
    transport,
    wants_subdivision,
)
from raytrace_jax.tracer.visibility.look import look
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import dot, renormalize, select


class Level(eqx.Module):
    """One level of rays after intersection and shading.

    Args:
        hits: where they hit.
        surface: what the model keeps until the children's colours are known; None where there is nothing to hit.
        background: what those see that hit nothing.
        children: the rays that are sent on, kind by kind (reflected, transmitted, past an edge), with those wanted.
        coverage: share of each ray's footprint that sees the hit; None in point-sampled tracing.
        subdivided: whose children are not these three but the thirds of their footprint; None as above.
        sees_edge: whose footprint is split or subdivided; None as above.
    """

    hits: Hits
    surface: eqx.Module | None
    background: Float[Array, "3 *#rays"]
    children: list[tuple[Bool[Array, " rays"], Rays]]
    coverage: Float[Array, " rays"] | None = None
    subdivided: Bool[Array, " rays"] | None = None
    sees_edge: Bool[Array, " rays"] | None = None


@functools.partial(jax.jit, static_argnames="settings")
def trace_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], number: Int[Array, " rays"], settings: ResolvedSettings
) -> Level:
    """Intersect and shade rays; `number` counts those before each of them, from 0 for camera rays.

    It is jitted within the programs that call it. Each rule of a loop, a condition and a derivative around it would
    trace it anew; so JAX keeps its jaxpr, its derivative and its batched form, and makes each of them once.
    """
    if not world.shapes.types:
        hits = intersect(world.shapes, rays, live, world.unit, settings)
        return Level(hits, None, MODELS[settings.model].background(world, rays), [])
    if settings.edges != "aware":
        return trace_points(world, rays, live, settings)
    return trace_areas(world, rays, live, number, settings)


def trace_points(world: World, rays: Rays, live: Bool[Array, " rays"], settings: ResolvedSettings) -> Level:
    """A level of rays that are points of the picture."""
    model = MODELS[settings.model]
    hits = intersect(world.shapes, rays, live, world.unit, settings, world.clusters)
    surface, children = model.shade(hits, rays, world, materials_at(world, hits), settings)
    weights = None
    if rays.pixel_weight is not None:
        weights = rays.weight * jax.lax.stop_gradient(jnp.stack(model.child_weights(surface)))
    return Level(hits, surface, model.background(world, rays), scattered_rays(children, weights, None, settings))


def trace_areas(
    world: World, rays: Rays, live: Bool[Array, " rays"], number: Int[Array, " rays"], settings: ResolvedSettings
) -> Level:
    """A level of rays that stand for areas: what each footprint sees first, and how its parts go on."""
    # Levels that the path's remaining bounces do not need are there for passing edges and for subdividing.
    bounces_left = settings.bounces - rays.beam.bounce
    has_levels = settings.levels - number > bounces_left
    view = look(world.shapes, rays, live, has_levels, world.unit, settings)
    surface, kinds, spread = scatter_areas(world, view.rays, view.hits, view.coverage, settings)
    subdivided, second = wants_subdivision(rays, spread, has_levels & live, settings)

    kinds = [*kinds, (view.passes, view.past)]
    kinds = [
        (wanted | subdivided, select(subdivided, part, child))
        for (wanted, child), part in zip(kinds, subdivide(rays, second), strict=True)
    ]
    background = MODELS[settings.model].background(world, view.rays)
    return Level(view.hits, surface, background, kinds, view.coverage, subdivided, view.passes | subdivided)


def scatter_areas(
    world: World, rays: Rays, hits: Hits, coverage: Float[Array, " rays"], settings: ResolvedSettings
) -> tuple[eqx.Module, list[tuple[Bool[Array, " rays"], Rays]], Float[Array, "2 rays"]]:
    """How footprints are lit and go on from where they hit.

    Args:
        world: the scene.
        rays: the rays, with footprints.
        hits: where they hit.
        coverage: share of the footprint they came with that this one is.
        settings: the model's settings.

    Returns:
        What the model keeps; the reflected and the transmitted rays, as `scattered_rays`; and along both axes of the
        footprint the squares of their spreads, times their weights.
    """
    model = MODELS[settings.model]
    shape = take(world.shapes, hits.shape)

    # How the footprint goes on from the surface, by the index of refraction at its middle.
    entering = dot(rays.d, hits.n) < 0
    eta = jax.lax.stop_gradient(model.relative_ior(world, hits, entering, settings))
    p_axes, reflected, transmitted = transport(rays, hits, shape, lambda d, n: (reflect(d, n), refract(d, n, eta)[0]))
    nodes = light_nodes(rays, hits, shape, p_axes)
    material = materials_at(world, hits, p_axes)
    surface, children = model.shade(hits, rays, world, material, settings, nodes)

    # Which rays are wanted, how much they count, and whose footprint spreads too widely for that.
    weights = jax.lax.stop_gradient(coverage * jnp.stack(model.child_weights(surface)))
    wanted = jnp.stack([children.reflect, children.transmit]) & (rays.beam.bounce < settings.bounces)
    children = eqx.tree_at(lambda c: (c.reflect, c.transmit), children, tuple(wanted))
    weights = jnp.where(wanted, rays.weight * weights, 0)
    spread = weights[0] * spread_squared(reflected) + weights[1] * spread_squared(transmitted)

    beam = rays.beam
    nothing = jnp.full_like(beam.passed, NO_SHAPE)
    footprints = [bounded(Footprint(p_axes, d), world.unit) for d in (reflected, transmitted)]
    beams = [Beam(footprint, nothing, beam.bounce + 1, beam.subdivisions) for footprint in footprints]
    return surface, scattered_rays(children, weights, beams, settings), spread


def scattered_rays(
    children: Children,
    weights: Float[Array, "2 rays"] | None,
    beams: list[Beam] | None,
    settings: ResolvedSettings,
) -> list[tuple[Bool[Array, " rays"], Rays]]:
    """The reflected and the transmitted rays of all hits, with those that are wanted and count enough."""
    # A reflected ray stays on the side that it came from, a transmitted one changes sides.
    c, kinds = children, []
    for kind, (wanted, o, d, inside) in enumerate(
        (
            (c.reflect, c.reflected_o, c.reflected, ~c.entering),
            (c.transmit, c.transmitted_o, c.transmitted, c.entering),
        )
    ):
        weight = None if weights is None else weights[kind]
        if weight is not None and settings.weight_limit > 0:
            wanted = wanted & (weight >= settings.weight_limit)
        # Within a ball rounding errors of a direction's length grow fourfold with each reflection, if they are left.
        d = renormalize(d)
        kinds.append((wanted, Rays(o, d, c.path_length, c.shape, inside, beams[kind] if beams else None, weight)))
    return kinds
