"""A batch of camera rays and all that they send on, traced as a queue: down with the rays, up with the colours.

Rays wait in one array, each at its own place. A chunk of them at a time is intersected and shaded, and the rays that it
sends on are put at the end of the queue. So chunks are full, however deep the rays' trees are. The course's classic
model clamps colours at every surface; so colours are blended afterwards, from the last chunk to the first, when those
of a ray's children are known.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import Rays, pack_bits, unpack_rays
from raytrace_jax.tracer.levels.compaction import Packing, gather, pack
from raytrace_jax.tracer.levels.level import Level, trace_level
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.materials import LINE_CHANNEL
from raytrace_jax.tracer.shading.models import MODELS
from raytrace_jax.tracer.world import World
from raytrace_jax.util.numerics import materialize, select


class Trace(eqx.Module):
    """What is traced of each camera ray.

    Args:
        color: the ray's colour, scene-linear RGB.
        wanted: how many rays there were in all; those that found no place in the queue are black.
        sees_edge: whether any ray of the pixel's tree sees an edge; None of points.
        first: the camera ray's own hit; None where it is not asked for, as the next one.
        bounce_count: the largest number of bounces after which a ray of the pixel's tree still hit something.
    """

    color: Float[Array, "3 rays"]
    wanted: Int[Array, ""]
    sees_edge: Bool[Array, " rays"] | None = None
    first: Hits | None = None
    bounce_count: Int[Array, " rays"] | None = None


class Traced(eqx.Module):
    """What the way up needs of a ray that was traced.

    Args:
        surface, background, coverage, subdivided, sees_edge: as `Level` has them.
        valid: whether it hit something.
        bounce: how often its path has bounced.
        children: the places in the queue of the rays that it sent on, kind by kind; one that stays black for none.
        hits: where it hit; None where nobody asks.
    """

    surface: eqx.Module | None
    background: Float[Array, "3 rays"]
    coverage: Float[Array, " rays"] | None
    subdivided: Bool[Array, " rays"] | None
    sees_edge: Bool[Array, " rays"] | None
    valid: Bool[Array, " rays"]
    bounce: Int[Array, " rays"]
    children: Int[Array, "kinds rays"]
    hits: Hits | None = None

    @classmethod
    def of(cls, level: Level, bounce: Array, children: Int[Array, "kinds rays"], with_hits: bool = False) -> "Traced":
        """What is kept of rays that were intersected and shaded."""
        hits = level.hits
        found = (
            *(level.surface, level.background, level.coverage, level.subdivided, level.sees_edge),
            *(hits.valid, bounce, children),
            hits if with_hits else None,
        )
        return cls(*jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], hits.valid.size)), found))


class Queue(eqx.Module):
    """The rays of a batch.

    Args:
        turn: how many chunks are traced.
        heads: the place of each chunk's first ray, of those that are traced and of the next one.
        tail: the place after the last ray; beyond the queue's size if rays found no place.
        rays: all of them, as `packed`.
        number: how many rays are before each of them in its path, which also passes edges.
        traced: of each that is traced.
    """

    turn: Int[Array, ""]
    heads: Int[Array, " turns"]
    tail: Int[Array, ""]
    rays: tuple
    number: Int[Array, " places"]
    traced: Traced


def packed(rays: Rays) -> tuple:
    """Rays as a tree of few arrays: what is continuous about them, and what is discrete in few numbers."""
    footprint = None if rays.edge_beam is None else rays.beam.footprint
    return (rays.o, rays.d, rays.path_length, footprint, rays.pixel_weight), pack_bits(rays)


def unpacked(queue: tuple) -> Rays:
    """The rays that `packed` has packed."""
    (o, d, path_length, footprint, weight), numbers = queue
    return unpack_rays(o, d, path_length, footprint, weight, numbers)


def pack_rays(kinds: list[tuple[Bool[Array, " rays"], Rays]], capacity: int) -> tuple[tuple, Packing]:
    """The wanted rays of all kinds, as `packed`, kind after kind."""
    packing = pack(jnp.stack([wanted for wanted, _ in kinds]), capacity)
    parent = packing.candidate % kinds[0][0].size

    def pick(*values):
        # What all kinds have in common is gathered by parent, once.
        if all(value is values[0] for value in values):
            return gather(values[0], parent)
        return gather(jnp.concatenate(values, axis=-1), packing.candidate)

    return jax.tree.map(pick, *(packed(rays) for _, rays in kinds)), packing


def trace(
    world: World,
    rays: Rays,
    count: Int[Array, ""],
    settings: ResolvedSettings,
    *,
    with_hits: bool = False,
    reversible: bool = False,
) -> Trace:
    """Trace camera rays and everything that they send on. The queue has places for twice as many rays as are given.

    Args:
        world: the scene.
        rays: camera rays.
        count: how many of them are to be traced, the first ones; what is said of the others has no meaning.
        settings: the model's settings.
        with_hits: whether `first` and `bounce_count` are wanted.
        reversible: whether the loop has a fixed number of turns, as reverse mode wants; else it ends with the rays.
    """
    # A sixteenth at a time stays in a CPU's cache, and wastes little where a generation of rays ends within a chunk.
    size = 2 * rays.path_length.shape[-1]
    chunk = size // 16

    def read(all_, head):
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, head, chunk, -1), all_)

    def write(all_, new, place):
        return jax.tree.map(lambda x, y: jax.lax.dynamic_update_slice_in_dim(x, y, place, -1), all_, new)

    def trace_chunk(head, tail, some: Rays, number) -> tuple[Traced, tuple, Array]:
        """Of one chunk what was traced, the rays that it sends on with their numbers, and how many these are."""
        live = head + jnp.arange(chunk, dtype=jnp.int32) < jnp.minimum(tail, size)
        # Stored at a place of their own: kernels that read from the middle of a queue are several times as slow.
        some, number = materialize((some, number), live)
        level = trace_level(world, some, live, number, settings)
        level = materialize(level, live)
        kinds = [(wanted & live & (number < settings.levels), child) for wanted, child in level.children]
        bounce = number if some.edge_beam is None else some.beam.bounce
        places, (children, new), total = jnp.zeros((0, chunk), jnp.int32), (packed(some), number), jnp.zeros_like(tail)
        if kinds:
            children, packing = pack_rays(kinds, chunk * len(kinds))
            # A child that finds no place is black, as the place after the last one is.
            places = jnp.minimum(jnp.where(packing.slot < packing.candidate.size, tail + packing.slot, size), size)
            new, total = gather(number, packing.candidate % chunk) + 1, packing.count
        return Traced.of(level, bounce, places, with_hits), (children, new), total

    def step(queue: Queue) -> Queue:
        turn, tail = queue.turn, queue.tail
        head = queue.heads[turn]
        one = jax.checkpoint(trace_chunk) if reversible else trace_chunk
        traced, children, total = one(head, tail, unpacked(read(queue.rays, head)), read(queue.number, head))
        # Where rays are fewer than a chunk, those that they send on are the next one.
        heads = queue.heads.at[turn + 1].set(jnp.minimum(head + chunk, jnp.minimum(tail, size)))
        all_, number = write((queue.rays, queue.number), children, jnp.minimum(tail, size))
        return Queue(turn + 1, heads, tail + total, all_, number, write(queue.traced, traced, head))

    # Down: the queue holds the camera's rays, and room for all that a last chunk may send on. Each generation of rays
    # may end within a chunk.
    room, turns = size + 3 * chunk, size // chunk + settings.levels + 1
    waiting = jax.tree.map(lambda x: _padded(x, room), packed(rays))
    start, number = jnp.zeros((), jnp.int32), jnp.zeros(room, jnp.int32)
    one = jax.eval_shape(trace_chunk, start, start, unpacked(read(waiting, start)), read(number, start))[0]
    nothing = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), one)
    heads = jnp.zeros(turns + 1, jnp.int32)
    queue = Queue(start, heads, jnp.asarray(count, jnp.int32), waiting, number, nothing)
    if reversible:
        queue, _ = jax.lax.scan(lambda queue, _: (step(queue), None), queue, length=turns)
    else:
        queue = jax.lax.while_loop(lambda q: q.heads[q.turn] < jnp.minimum(q.tail, size), step, queue)

    # Up: each ray blends what its children brought back. Places that are not traced stay black.
    def blend(turn, brought):
        turn = queue.turn - 1 - turn
        head, end = queue.heads[turn], queue.heads[turn + 1]
        is_own = head + jnp.arange(chunk, dtype=jnp.int32) < end
        blended = blend_chunk(settings, brought, read(queue.traced, head))
        return write(brought, select(is_own, blended, read(brought, head)), head)

    brought = Brought.nothing(room, nothing, with_hits)
    if reversible:
        brought, _ = jax.lax.scan(lambda b, turn: (blend(turn, b), None), brought, jnp.arange(turns, dtype=jnp.int32))
    else:
        brought = jax.lax.fori_loop(0, queue.turn, blend, brought)
    found, hits = jax.tree.map(lambda x: x[..., : rays.path_length.shape[-1]], (brought, queue.traced.hits))
    return Trace(found.color, queue.tail, found.sees_edge, hits, found.bounce_count)


class Brought(eqx.Module):
    """What rays bring back to the rays that sent them; the fields mean what they do in `Trace`."""

    color: Float[Array, "3 places"]
    sees_edge: Bool[Array, " places"] | None
    bounce_count: Int[Array, " places"] | None

    @classmethod
    def nothing(cls, places: int, traced: Traced, with_hits: bool) -> "Brought":
        """Nothing in so many places."""
        sees_edge = None if traced.sees_edge is None else jnp.zeros(places, bool)
        return cls(jnp.zeros_like(traced.background), sees_edge, jnp.zeros(places, jnp.int32) if with_hits else None)


def _padded(x: Array, places: int) -> Array:
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, places - x.shape[-1])])


def blend_chunk(settings: ResolvedSettings, brought: Brought, own: Traced) -> Brought:
    """What a chunk's rays bring back, from what all later ones did."""
    black = jnp.zeros_like(own.background)
    kinds = [gather(brought.color, place) for place in own.children] or [black] * 3
    blended = own.background
    if own.surface is not None:
        combined = MODELS[settings.model].combine(own.surface, kinds[0], kinds[1])
        blended = jnp.where(own.valid, combined, blended)
    if own.coverage is not None:
        blended = kinds[2] + own.coverage * (blended - kinds[2])
        assert own.subdivided is not None
        blended = jnp.where(own.subdivided, (kinds[0] + kinds[1] + kinds[2]) / 3, blended)

    def most(mine: Array, all_: Array) -> Array:
        """The largest of a ray's own value and its children's."""
        return functools.reduce(jnp.maximum, [gather(all_, place) for place in own.children], mine)

    sees_edge, bounces = brought.sees_edge, brought.bounce_count
    if sees_edge is not None:
        assert own.sees_edge is not None
        sees_edge = most(own.sees_edge, sees_edge)
    if bounces is not None:
        bounces = most(jnp.where(own.valid, own.bounce, 0), bounces)
    return Brought(blended, sees_edge, bounces)


def trace_channels(
    world: World, rays: Rays, count: Int[Array, ""], settings: ResolvedSettings, **options: bool
) -> Trace:
    """`trace`, and where glass has dispersion one channel after the other, which takes three times as long.

    What is not a colour comes from the green channel. Only of rays and edges what any channel wants or sees counts.
    """
    if world.channel_ior is None:
        return trace(world, rays, count, settings, **options)

    def trace_one(ior):
        one = eqx.tree_at(lambda w: w.materials.ior, world, ior)
        return trace(one, rays, count, settings, **options)

    each = jax.lax.map(jax.checkpoint(trace_one, prevent_cse=False), world.channel_ior)
    color = jnp.stack([each.color[channel, channel] for channel in range(3)])
    first, bounce_count = jax.tree.map(lambda x: x[LINE_CHANNEL], (each.first, each.bounce_count))
    wanted, sees_edge = jax.tree.map(lambda x: jnp.max(x, axis=0), (each.wanted, each.sees_edge))
    return Trace(color, wanted, sees_edge, first, bounce_count)
