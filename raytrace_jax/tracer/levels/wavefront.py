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
from jaxtyping import Array, Bool, Float, Int, Shaped

from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import Rays, pack_bits, unpack_rays
from raytrace_jax.tracer.levels.compaction import Packing, gather, in_chunks, pack, unpack
from raytrace_jax.tracer.levels.level import Level, trace_level
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.materials import LINE_CHANNEL
from raytrace_jax.tracer.shading.models import MODELS
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import materialize


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
        sees_edge: whether any ray of the pixel's tree sees an edge; None of points.
    """

    color: Float[Array, "3 rays"]
    first: Hits
    bounce_count: Int[Array, " rays"]
    wanted: Int[Array, " levels"]
    sees_edge: Bool[Array, " rays"] | None = None


class Brought(NamedTuple):
    """What rays bring back to the rays that sent them; the fields mean what they do in `Trace`."""

    color: Float[Array, "3 slots"]
    bounce_count: Int[Array, " slots"]
    sees_edge: Bool[Array, " slots"] | None


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
        footprint = None if rays.edge_beam is None else rays.beam.footprint
        return rays.o, rays.d, rays.path_length, footprint, rays.pixel_weight

    o, d, path_length, footprint, weight = jax.tree.map(pick, *(continuous(rays) for _, rays in kinds))
    numbers = jax.tree.map(pick, *(pack_bits(rays) for _, rays in kinds))
    return unpack_rays(o, d, path_length, footprint, weight, numbers), packing


def trace(
    world: World, rays: Rays, live: Bool[Array, " rays"], stages: tuple[Stage, ...], settings: ResolvedSettings
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
        # Where one size serves many levels most have few rays, and chunks without a live ray cost nothing: 25 levels of
        # POV-Ray's checker by points take two thirds of the time; runs of 3 to 6 levels gain nothing. A GPU has more
        # use for many rays at once than for fewer.
        is_one_run = settings.edges == "aware" and len(stages) == 1
        is_deep = stage.levels > 8 and jax.default_backend() == "cpu"
        whole_level = in_chunks if is_one_run or is_deep else at_once

        def step(carry, number, capacity=capacity, is_last=is_last, whole_level=whole_level):
            rays, live = carry
            level = whole_level(functools.partial(trace_level, world, number=number, settings=settings), rays, live)
            bounce = number if rays.edge_beam is None else rays.beam.bounce
            if is_last:
                return carry, (level, None, bounce)
            children, packing = pack_rays(level.children, capacity)
            return (children, packing.live), (level, packing, bounce)

        # A loop over levels of one size is one program, however many they are. It keeps what the way up needs.
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
    below = Brought(jnp.zeros_like(rays.o), jnp.zeros_like(rays.origin_shape), None)
    if settings.edges == "aware":
        below = below._replace(sees_edge=jnp.zeros_like(live))
    wanted = []
    for stage, kept in reversed(down):

        def blend(below, kept):
            return blend_level(settings, below, *kept), None

        # How many rays each level wanted, and as many slots below as the packing that sent the rays there has.
        level, packing, _ = kept
        if packing is None:
            none = jnp.zeros(1, jnp.int32)
            wanted = [sum((jnp.sum(kind, dtype=jnp.int32) for kind, _ in level.children), none)]
        else:
            wanted.insert(0, jnp.atleast_1d(packing.count))
            below = jax.tree.map(functools.partial(pad_slots, slots=packing.candidate.shape[-1]), below)
        if stage.levels > 1:
            below, _ = jax.lax.scan(blend, below, kept, reverse=True)
        else:
            below, _ = blend(below, kept)
    # What the camera's rays hit is the first level's, which may be the first of a loop.
    stage, (level, _, _) = down[0]
    first = level.hits if stage.levels == 1 else jax.tree.map(lambda x: x[0], level.hits)
    wanted = jnp.concatenate(wanted)[: settings.levels]
    return Trace(below.color, first, below.bounce_count, wanted, below.sees_edge)


def at_once(function, rays: Rays, live: Bool[Array, " rays"]) -> Level:
    """`function(rays, live)` for all rays in one piece; takes the place of `in_chunks`."""
    return materialize(function(rays, live), live)


def pad_slots(values: Shaped[Array, "*components slots"], slots: int) -> Shaped[Array, "*components more"]:
    """Values with zeros in further slots."""
    return jnp.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, slots - values.shape[-1])])


def blend_level(settings: ResolvedSettings, below: Brought, level: Level, packing: Packing | None, bounce) -> Brought:
    """What one level's rays bring back, from what the next level's do."""
    black = jnp.zeros_like(level.hits.p)
    kinds = [black] * 3 if packing is None else unpack(below.color, packing)
    blended = jnp.broadcast_to(level.background, level.hits.p.shape)
    if level.surface is not None:
        combined = MODELS[settings.model].combine(level.surface, kinds[0], kinds[1])
        blended = jnp.where(level.hits.valid, combined, blended)
    if level.coverage is not None:
        blended = kinds[2] + level.coverage * (blended - kinds[2])
        assert level.subdivided is not None
        blended = jnp.where(level.subdivided, (kinds[0] + kinds[1] + kinds[2]) / 3, blended)

    def most(own: Shaped[Array, " rays"], values: Shaped[Array, " slots"]) -> Shaped[Array, " rays"]:
        """The largest of a ray's own value and its children's."""
        children = [] if packing is None else [kind[0] for kind in unpack(values[None], packing)]
        return functools.reduce(jnp.maximum, children, own)

    bounce_count = most(jnp.where(level.hits.valid, bounce, 0), below.bounce_count)
    sees_edge = None
    if below.sees_edge is not None:
        own = jnp.zeros_like(level.hits.valid) if level.sees_edge is None else level.sees_edge
        sees_edge = most(own, below.sees_edge)
    return Brought(blended, bounce_count, sees_edge)


def trace_channels(
    world: World, rays: Rays, live: Bool[Array, " rays"], stages: tuple[Stage, ...], settings: ResolvedSettings
) -> Trace:
    """`trace`, and where glass has dispersion one channel after the other, which takes three times as long.

    What is not a colour comes from the green channel. Only of rays and edges what any channel wants or sees counts.
    """
    if world.channel_ior is None:
        return trace(world, rays, live, stages, settings)

    def trace_one(ior):
        one = eqx.tree_at(lambda w: w.materials.ior, world, ior)
        return trace(one, rays, live, stages, settings)

    each = jax.lax.map(jax.checkpoint(trace_one, prevent_cse=False), world.channel_ior)
    color = jnp.stack([each.color[channel, channel] for channel in range(3)])
    first, bounce_count = jax.tree.map(lambda x: x[LINE_CHANNEL], (each.first, each.bounce_count))
    wanted, sees_edge = jax.tree.map(lambda x: jnp.max(x, axis=0), (each.wanted, each.sees_edge))
    return Trace(color, first, bounce_count, wanted, sees_edge)
