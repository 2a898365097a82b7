"""A batch of camera rays traced level by level to a fixed depth: down with the rays, up with the colours.

At each level all live rays are intersected and shaded, and the rays that they send on are packed into the arrays of
the next level, whose size is fixed by the plan. The course's classic model clamps colours at every surface; so the
colours are blended afterwards, from the deepest level up.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from raytrace_jax.optics import reflect, refract
from raytrace_jax.scene.scene import PointLights, Scene
from raytrace_jax.tracer.compaction import Packing, gather, pack, unpack
from raytrace_jax.tracer.geometry.intersection import Hits, intersect, take
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Beam, Footprint, Rays, from_labels, labels
from raytrace_jax.tracer.geometry.shapes import Shapes, scene_shapes
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.shading import MODELS
from raytrace_jax.tracer.shading.surfaces import Children, ShapeMaterials, shape_materials
from raytrace_jax.tracer.visibility.footprints import (
    light_nodes,
    spread_squared,
    subdivide,
    transport,
    wants_subdivision,
)
from raytrace_jax.tracer.visibility.look import look
from raytrace_jax.util.numerics import dot, materialize, select


class World(eqx.Module):
    """What rays meet, laid out for tracing: shapes and their materials in the order of the file, and the lights."""

    shapes: Shapes
    materials: ShapeMaterials
    lights: PointLights


class Stage(NamedTuple):
    """Some levels in a row that hold the same number of rays."""

    capacity: int
    levels: int


class Trace(eqx.Module):
    """What a wavefront returns for each camera ray.

    Args:
        color: the ray's colour, scene-linear RGB.
        first: the camera ray's own hit.
        bounce_count: the largest number of bounces after which a ray of the pixel's tree still hit something.
        wanted: for every level after the first, how many rays were to be traced there.
    """

    color: Float[Array, "3 rays"]
    first: Hits
    bounce_count: Int[Array, " rays"]
    wanted: Int[Array, " levels"]


def prepare_world(scene: Scene) -> World:
    """Lay a scene out for tracing."""
    return World(scene_shapes(scene), shape_materials(scene), scene.lights)


class Level(eqx.Module):
    """One level of rays after intersection and shading.

    Args:
        hits: where they hit.
        surface: what the model keeps until the children's colours are known.
        coverage: share of each ray's footprint that sees the hit; None in point-sampled tracing.
        children: the rays that are sent on, kind by kind (reflected, transmitted, past an edge), with those wanted.
        subdivided: whose children are not these three but the thirds of their footprint; None as above.
    """

    hits: Hits
    surface: eqx.Module
    coverage: Float[Array, " rays"] | None
    children: list[tuple[Bool[Array, " rays"], Rays]]
    subdivided: Bool[Array, " rays"] | None = None


def trace_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], number: Int[Array, ""], settings: RenderSettings
) -> Level:
    """Intersect and shade one level of rays; `number` counts the levels, from 0 for camera rays."""
    model = MODELS[settings.model]
    if not world.shapes.is_sphere:  # An empty scene is black; there is no material to look up.
        hits = intersect(world.shapes, rays, live, settings)
        return Level(hits, model.nothing(hits), None, [])
    if settings.edges == "point":
        hits = intersect(world.shapes, rays, live, settings)
        surface, children = model.shade(hits, rays, world.shapes, world.materials, world.lights, settings)
        return Level(hits, surface, None, scattered_rays(children, None, None))

    # Levels that the path's remaining bounces do not need are there for passing edges and for subdividing.
    bounces_left = settings.bounces - rays.beam.bounce
    has_levels = settings.levels - number > bounces_left
    view = look(world.shapes, rays, live, has_levels, settings)
    shape = take(world.shapes, view.hits.shape)
    ior = take(world.materials, view.hits.shape).ior
    eta = jax.lax.stop_gradient(model.relative_ior(ior, dot(view.rays.d, view.hits.n) < 0, settings))
    o, reflected, transmitted = transport(
        view.rays, view.hits, shape, lambda d, n: (reflect(d, n), refract(d, n, eta)[0])
    )
    nodes = light_nodes(view.rays, view.hits, shape, o)
    surface, children = model.shade(view.hits, view.rays, world.shapes, world.materials, world.lights, settings, nodes)

    weights = jax.lax.stop_gradient(view.coverage * jnp.stack(model.child_weights(surface)))
    wanted = jnp.stack([children.reflect, children.transmit]) & (bounces_left > 0)
    children = eqx.tree_at(lambda c: (c.reflect, c.transmit), children, tuple(wanted))
    weights = jnp.where(wanted, rays.beam.weight * weights, 0)
    spread = weights[0] * spread_squared(reflected) + weights[1] * spread_squared(transmitted)
    subdivided, second = wants_subdivision(rays, spread, has_levels & live, settings)

    beam = view.rays.beam
    nothing = jnp.full_like(beam.passed, NO_SHAPE)
    beams = [
        Beam(Footprint(o, d), nothing, beam.bounce + 1, beam.subdivisions, weight)
        for d, weight in zip((reflected, transmitted), weights, strict=True)
    ]
    kinds = [*scattered_rays(children, *beams), (view.passes, view.past)]
    kinds = [
        (wanted | subdivided, select(subdivided, part, child))
        for (wanted, child), part in zip(kinds, subdivide(rays, second), strict=True)
    ]
    return Level(view.hits, surface, view.coverage, kinds, subdivided)


def scattered_rays(
    children: Children, reflected: Beam | None, transmitted: Beam | None
) -> list[tuple[Bool[Array, " rays"], Rays]]:
    """The reflected and the transmitted rays of all hits, with those that are wanted."""
    # A reflected ray stays on the side that it came from, a transmitted one changes sides.
    c = children
    return [
        (c.reflect, Rays(c.reflected_o, c.reflected, c.path_length, c.shape, ~c.entering, reflected)),
        (c.transmit, Rays(c.transmitted_o, c.transmitted, c.path_length, c.shape, c.entering, transmitted)),
    ]


def pack_rays(kinds: list[tuple[Bool[Array, " rays"], Rays]], capacity: int) -> tuple[Rays, Packing]:
    """The wanted rays of all kinds as the rays of the next level, kind after kind."""
    packing = pack(jnp.stack([wanted for wanted, _ in kinds]), capacity)
    parent = packing.candidate % kinds[0][0].shape[0]

    def pick(*values):
        # What all kinds have in common is gathered by parent, once.
        if all(value is values[0] for value in values):
            return gather(values[0], parent)
        return gather(jnp.concatenate(values, axis=-1), packing.candidate)

    def continuous(rays: Rays):
        beam = None if rays.edge_beam is None else (rays.beam.footprint, rays.beam.weight)
        return rays.o, rays.d, rays.path_length, beam

    o, d, path_length, beam = jax.tree.map(pick, *(continuous(rays) for _, rays in kinds))
    numbers = jax.tree.map(pick, *(labels(rays) for _, rays in kinds))
    return from_labels(o, d, path_length, beam, numbers), packing


def trace(
    world: World, rays: Rays, live: Bool[Array, " rays"], stages: tuple[Stage, ...], settings: RenderSettings
) -> Trace:
    """Trace camera rays and everything that they send on.

    Args:
        world: the scene.
        rays: one batch of camera rays, as many as the first stage holds.
        live: which of them count; the others are black.
        stages: the levels' capacities; together at most `settings.levels` levels after the first. Rays that find no
            room are black; compare `wanted` with the capacities to know.
        settings: the model's settings.
    """
    # Down: each level's children are the next level's rays. Levels of one stage are one program, run repeatedly.
    down = []
    number = 0
    for stage, following in zip(stages, (*stages[1:], None), strict=True):
        numbers = np.arange(number, number + stage.levels, dtype=np.int32)
        capacity = stage.capacity if stage.levels > 1 or following is None else following.capacity

        is_last = following is None and stage.levels == 1

        def step(carry, number, capacity=capacity, is_last=is_last):
            rays, live = carry
            level = materialize(trace_level(world, rays, live, number, settings), live)
            bounce = number if rays.edge_beam is None else rays.beam.bounce
            if is_last:
                return carry, (level, None, bounce)
            children, packing = pack_rays(level.children, capacity)
            return (children, packing.live), (level, packing, bounce)

        carry = rays, live
        if stage.levels > 1:
            carry, kept = jax.lax.scan(step, carry, jnp.asarray(numbers))
        else:
            carry, kept = step(carry, jnp.asarray(numbers[0]))
        number += stage.levels
        # The rays of a level lie at the front of its arrays: fewer slots are a shorter piece of them.
        slots = capacity if following is None else following.capacity
        rays, live = jax.tree.map(lambda x, slots=slots: x[..., :slots], carry)
        down.append((stage, kept))

    # Up: each surface blends what its children brought back.
    color, bounce_count = jnp.zeros_like(rays.o), jnp.zeros_like(rays.origin_shape)
    wanted = []
    for stage, kept in reversed(down):

        def blend(below, kept):
            return blend_level(settings, *below, *kept), None

        level, packing, _ = kept
        if packing is None:
            none = jnp.zeros(1, jnp.int32)
            wanted = [sum((jnp.sum(kind, dtype=jnp.int32) for kind, _ in level.children), none)]
        else:
            wanted.insert(0, jnp.atleast_1d(packing.count))
            slots = packing.candidate.shape[-1]
            color, bounce_count = pad_slots(color, slots), pad_slots(bounce_count, slots)
        below = color, bounce_count
        if stage.levels > 1:
            (color, bounce_count), _ = jax.lax.scan(blend, below, kept, reverse=True)
        else:
            (color, bounce_count), _ = blend(below, kept)
    stage, (level, _, _) = down[0]
    first = level.hits if stage.levels == 1 else jax.tree.map(lambda x: x[0], level.hits)
    return Trace(color, first, bounce_count, jnp.concatenate(wanted)[: settings.levels])


def pad_slots(values: Num[Array, "*components slots"], slots: int) -> Num[Array, "*components more"]:
    """Values with zeros in further slots."""
    return jnp.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, slots - values.shape[-1])])


def blend_level(settings: RenderSettings, color, bounce_count, level: Level, packing: Packing | None, bounce):
    """Colours and bounce counts of one level's rays from those of the next level's."""
    black = jnp.zeros_like(level.hits.p)
    kinds = [black] * 3 if packing is None else unpack(color, packing)
    blended = MODELS[settings.model].combine(level.surface, kinds[0], kinds[1])
    if level.coverage is not None:
        blended = kinds[2] + level.coverage * (blended - kinds[2])
        assert level.subdivided is not None
        blended = jnp.where(level.subdivided, (kinds[0] + kinds[1] + kinds[2]) / 3, blended)
    deeper = [] if packing is None else [kind[0] for kind in unpack(bounce_count[None], packing)]
    return blended, functools.reduce(jnp.maximum, deeper, jnp.where(level.hits.valid, bounce, 0))
