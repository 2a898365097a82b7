"""Rays level by level: each level is intersected, shaded and sends rays on; a queue runs down and colours come back up.

Rays wait in one array, each at its own place. A chunk of them at a time is intersected and shaded, and the rays that it
sends on are put at the end of the queue. Camera rays come in where fewer rays wait than a chunk. So chunks are full,
however deep the rays' trees are. The course's classic model clamps colours at every surface; so colours are blended
afterwards, from the last chunk to the first, when those of a ray's children are known.
"""

import functools
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Camera
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.geometry.rays import PackedRays, Rays, Vectors, packed, unpacked
from raytrace_jax.tracer.levels.level import MODELS, Scattering, trace_level
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.world import LINE_CHANNEL, World
from raytrace_jax.util.numerics import materialize, only_if, repeat, select

T = TypeVar("T")


def gather(values: T, index: Int[Array, " slots"]) -> T:
    """`values[..., index]` of each leaf, for indices that are in bounds."""
    return jax.tree.map(lambda x: x.at[..., index].get(mode="promise_in_bounds"), values)


def running_count(wanted: Bool[Array, " candidates"]) -> Int[Array, " candidates"]:
    """Inclusive prefix sum of a mask.

    Two triangular matrix products take a fraction of the time of `jnp.cumsum` on the CPU. float32 counts exactly
    up to 2^24, the largest batch by far.
    """
    blocks = jnp.pad(wanted, (0, -wanted.size % 64)).astype(jnp.float32).reshape(-1, 64)
    within = blocks @ jnp.triu(jnp.ones((64, 64), jnp.float32))
    totals = within[:, -1]
    before = totals @ jnp.triu(jnp.ones((len(totals), len(totals)), jnp.float32), 1)
    return (within + before[:, None]).astype(jnp.int32).reshape(-1)[: wanted.size]


def pack_rays(
    kinds: list[tuple[Bool[Array, " rays"], Rays]], number: Int[Array, " rays"]
) -> tuple[PackedRays, Int[Array, "kinds rays"], Int[Array, ""]]:
    """The wanted rays of all kinds, kind after kind; the slot of each candidate, and how many are wanted.

    What is not wanted has the slot after the last one; unused slots at the end hold the first candidate.
    """
    wanted = jnp.stack([wanted for wanted, _ in kinds])
    rank = running_count(wanted.reshape(-1))
    slot = jnp.where(wanted.reshape(-1), rank - 1, wanted.size)
    numbers = jnp.arange(wanted.size, dtype=jnp.int32)
    candidate = jnp.zeros(wanted.size, jnp.int32).at[slot].set(numbers, mode="drop", unique_indices=True)
    candidates = jax.tree.map(lambda *x: jnp.concatenate(x, -1), *(packed(rays, number) for _, rays in kinds))
    return gather(candidates, candidate), slot.reshape(wanted.shape), rank[-1]


class RayRecord(eqx.Module):
    """Traced rays as the way up needs them."""

    scattering: Scattering
    valid: Bool[Array, " rays"]
    depth: Int[Array, " rays"]  # How often their paths have bounced.
    children: Int[Array, "kinds rays"]  # The places in the queue of what they sent on; beyond its rays for none.
    si: Hits | None = None  # Where they hit; None where nobody asks, as the next.
    wanted: Bool[Array, "kinds rays"] | None = None  # What they wanted to send on, also after the last bounce.


class ChildResult(eqx.Module):
    """Radiance returned to the parent ray, with what else the parent is told; fields as in `Outcome`."""

    color: Float[Array, "3 places"]
    complete: Bool[Array, " places"]
    sees_edge: Bool[Array, " places"] | None
    bounce_count: Int[Array, " places"] | None


def combine(settings: ResolvedSettings, results: ChildResult, rays: RayRecord) -> ChildResult:
    own = rays.scattering
    color = own.background
    from_children = [gather(results.color, place) for place in rays.children]
    if own.surface is not None:
        color = jnp.where(rays.valid, MODELS[settings.model].combine(own.surface, *from_children[:2]), color)
    # What is seen past an edge counts for the rest of the footprint.
    if own.coverage is not None and own.subdivided is not None:
        reflected, transmitted, past = from_children
        color = past + own.coverage * (color - past)
        color = jnp.where(own.subdivided, (reflected + transmitted + past) / 3, color)

    def most(mine: Array, all_: Array) -> Array:
        return functools.reduce(jnp.maximum, [gather(all_, place) for place in rays.children], mine)

    complete = functools.reduce(jnp.logical_and, [gather(results.complete, place) for place in rays.children], True)

    sees_edge, bounces = results.sees_edge, results.bounce_count
    if sees_edge is not None:
        assert own.sees_edge is not None
        sees_edge = most(own.sees_edge, sees_edge)
    if bounces is not None:
        bounces = most(jnp.where(rays.valid, rays.depth, 0), bounces)
    return ChildResult(color, jnp.broadcast_to(complete, rays.valid.shape), sees_edge, bounces)


class Outcome(eqx.Module):
    color: Vectors
    complete: Bool[Array, " rays"]  # Whether all rays of its tree found a place in the queue; what did not is black.
    sees_edge: Bool[Array, " rays"] | None = None  # Whether any ray of the pixel's tree sees an edge; None of points.
    first: Hits | None = None  # The camera ray's own hit; None where it is not asked for, as the next one.
    bounce_count: Int[Array, " rays"] | None = None  # The largest after which a ray of its tree still hit something.


class Queue(eqx.Module):
    turn: Int[Array, ""]
    heads: Int[Array, " turns"]  # The place of each chunk's first ray, of those that are traced and of the next one.
    starts: Int[Array, " chunks"]  # The place of the first camera ray of each chunk that came in together.
    sent: Int[Array, ""]  # How many camera rays came in.
    tail: Int[Array, ""]  # The place after the last ray; beyond the queue's size if rays found no place.
    rays: PackedRays
    traced: RayRecord


RAYS_A_PLACE = 4  # The queue has room for so many times the camera rays that there are places for.


def chunk_of(places: int) -> int:
    size = places * RAYS_A_PLACE
    # So many stay in a CPU's cache.
    return min(size // 16, 512) if jax.default_backend() == "cpu" else size // 16


def trace_queue(
    world: World,
    camera: Camera,
    points: Float[Array, "2 places"],
    step: Float[Array, "2"],
    count: Int[Array, ""] | int,
    settings: ResolvedSettings,
    *,
    with_hits: bool = False,
    reversible: bool = False,
) -> tuple[Queue, ChildResult]:
    """The queue at the end of tracing camera rays and all that they send on, and what each of its rays brings back.

    Args:
        points: where the pixels look, as `rays_through` has it, and `step`.
        count: how many of them are to be traced, the first ones; what is said of the others has no meaning.
        reversible: whether the loop has a fixed number of turns, as reverse mode wants; else it ends with the rays.
    """
    size, chunk = points.shape[1] * RAYS_A_PLACE, chunk_of(points.shape[1])
    # There is room for all that a last chunk may send on. The last two places stay black: of no child, and of one that
    # finds no place.
    room = size + 3 * chunk
    lost, none = room - 2, room - 1

    def read(all_, head):
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, head, chunk, -1), all_)

    def write(all_, new, place):
        return jax.tree.map(lambda x, y: jax.lax.dynamic_update_slice_in_dim(x, y, place, -1), all_, new)

    def camera_rays(first) -> PackedRays:
        u, v = read(points, first)
        return packed(rays_through(camera, settings, u, v, step), jnp.zeros(chunk, jnp.int32))

    def scatter_chunk(head, tail, some: PackedRays) -> tuple[RayRecord, PackedRays, Array]:
        live = head + jnp.arange(chunk, dtype=jnp.int32) < jnp.minimum(tail, size)
        # Stored at a place of their own: kernels that read from the middle of a queue are several times as slow.
        some = materialize(some, live)
        rays, number = unpacked(some), some.number
        level = materialize(trace_level(world, rays, live, number, settings), live)
        kinds = [(wanted & live & (number < settings.levels), child) for wanted, child in level.children]
        depth = number if rays.beam is None else rays.beam.depth
        places, children, total = jnp.zeros((0, chunk), jnp.int32), some, jnp.zeros_like(tail)
        if kinds:
            children, slot, total = pack_rays(kinds, number + 1)
            places = jnp.where(slot < slot.size, jnp.minimum(tail + slot, lost), none)
        si = level.si if with_hits else None
        all_wanted = jnp.stack([wanted for wanted, _ in level.children]) if with_hits and kinds else None
        record = RayRecord(level.scattering, level.si.valid, depth, places, si, all_wanted)
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], chunk)), record), children, total

    def waits(queue: Queue) -> Int[Array, ""]:
        return jnp.minimum(queue.tail, size) - queue.heads[queue.turn]

    def has_more(queue: Queue) -> Bool[Array, ""]:
        return (queue.sent < count) & (queue.tail < size)

    def take_turn(queue: Queue) -> Queue:
        """Trace the next chunk of rays; camera rays come in where fewer wait. After the last ray nothing changes."""
        lacks, turn, end = has_more(queue) & (waits(queue) < chunk), queue.turn, jnp.minimum(queue.tail, size)
        rays = write(queue.rays, only_if(lacks, camera_rays, jnp.where(lacks, queue.sent, 0)), end)
        starts = queue.starts.at[jnp.where(lacks, queue.sent // chunk, len(queue.starts))].set(end, mode="drop")
        new = jnp.where(lacks, jnp.minimum(chunk, count - queue.sent), 0)

        head, tail = queue.heads[turn], queue.tail + new
        end = jnp.minimum(tail, size)
        traced, children, total = only_if(head < end, scatter_chunk, head, tail, read(rays, head))
        # Where rays are fewer than a chunk, those that they send on are the next one.
        heads = queue.heads.at[turn + 1].set(jnp.minimum(head + chunk, end))
        rays, records = write(rays, children, end), write(queue.traced, traced, head)
        return Queue(turn + 1, heads, starts, queue.sent + new, tail + total, rays, records)

    # Down. What ends the queue is a generation of rays a turn.
    turns = size // chunk + settings.levels + 2
    start = jnp.zeros((), jnp.int32)
    first = jax.eval_shape(camera_rays, start)
    one = jax.eval_shape(scatter_chunk, start, start, first)[0]
    waiting, nothing = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), (first, one))
    heads, starts = jnp.zeros(turns + 1, jnp.int32), jnp.zeros(points.shape[1] // chunk, jnp.int32)
    queue = Queue(start, heads, starts, start, start, waiting, nothing)
    queue = repeat(take_turn, queue, lambda queue: has_more(queue) | (waits(queue) > 0), turns, reversible)

    # Up: each ray blends what its children bring back. Places that are not traced stay black.
    def blend(state):
        turn, results = state
        head, end = queue.heads[turn - 1], queue.heads[turn]
        is_own = head + jnp.arange(chunk, dtype=jnp.int32) < end
        blended = combine(settings, results, read(queue.traced, head))
        return turn - 1, write(results, select(is_own, blended, read(results, head)), head)

    own = nothing.scattering
    sees_edge = None if own.sees_edge is None else jnp.zeros(room, bool)
    bounce_count = jnp.zeros(room, jnp.int32) if with_hits else None
    complete = jnp.arange(room, dtype=jnp.int32) == none
    results = ChildResult(jnp.zeros_like(own.background), complete, sees_edge, bounce_count)
    _, results = repeat(blend, (queue.turn, results), lambda state: state[0] > 0, turns, reversible)
    return queue, results


def trace(
    world: World,
    camera: Camera,
    points: Float[Array, "2 places"],
    step: Float[Array, "2"],
    count: Int[Array, ""] | int,
    settings: ResolvedSettings,
    **options: bool,
) -> Outcome:
    """The outcome of each camera ray, by `trace_queue`; its arguments.

    Where glass has dispersion one channel is traced after the other, which takes three times as long. What is not a
    colour then comes from the green channel; of edges what any channel sees counts.
    """
    chunk = chunk_of(points.shape[1])

    def outcome(world: World) -> Outcome:
        queue, results = trace_queue(world, camera, points, step, count, settings, **options)

        def camera_s(x):
            each = jax.lax.map(lambda start: jax.lax.dynamic_slice_in_dim(x, start, chunk, -1), queue.starts)
            return jnp.moveaxis(each, 0, -2).reshape(*x.shape[:-1], -1)

        found, si = jax.tree.map(camera_s, (results, queue.traced.si))
        complete = found.complete & (jnp.arange(points.shape[1], dtype=jnp.int32) < queue.sent)
        return Outcome(found.color, complete, found.sees_edge, si, found.bounce_count)

    if world.channel_ior is None:
        return outcome(world)

    def of_channel(ior):
        return outcome(eqx.tree_at(lambda w: w.materials.ior, world, ior))

    each = jax.lax.map(jax.checkpoint(of_channel, prevent_cse=False), world.channel_ior)
    color = jnp.stack([each.color[channel, channel] for channel in range(3)])
    first, bounce_count = jax.tree.map(lambda x: x[LINE_CHANNEL], (each.first, each.bounce_count))
    sees_edge = None if each.sees_edge is None else jnp.any(each.sees_edge, axis=0)
    return Outcome(color, jnp.all(each.complete, axis=0), sees_edge, first, bounce_count)
