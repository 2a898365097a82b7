"""Rays level by level: each level is intersected, shaded and sends rays on; a queue runs down and colours come back up.

Rays wait in one array, each at its own place. A chunk of them at a time is intersected and shaded, and the rays that it
sends on are put at the end of the queue. Camera rays come in where fewer rays wait than a chunk. So chunks are full,
however deep the rays' trees are. The course's classic model clamps colours at every surface; so colours are blended
afterwards, from the last chunk to the first, when those of a ray's children are known.
"""

import dataclasses
import functools
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..scene.scene import Camera
from ..util.numerics import materialize, only_if, repeat, select
from .geometry.camera import rays_through
from .geometry.intersection import SurfaceInteraction
from .geometry.rays import Count, Flags, Integers, PackedRays, Rays, Vectors, packed, unpacked
from .level import Scattering, trace_level
from .world import LINE_CHANNEL, World

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


def compact(
    kinds: list[tuple[Bool[Array, " rays"], Rays]], number: Int[Array, " rays"]
) -> tuple[PackedRays, Int[Array, "kinds rays"], Count]:
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
    valid: Flags
    depth: Integers  # How often their paths have bounced.
    children: Int[Array, "kinds rays"]  # The places in the queue of what they sent on; beyond its rays for none.
    si: SurfaceInteraction | None = None  # Where they hit; None where nobody asks, as the next.
    wanted: Bool[Array, "kinds rays"] | None = None  # What they wanted to send on, also after the last bounce.


class Outcome(eqx.Module):
    """What rays bring back to their parents, and the camera's rays to their pixels."""

    color: Vectors
    complete: Flags  # Whether all rays of its tree found a place in the queue; what did not is black.
    sees_edge: Flags | None = None  # Whether any ray of its tree sees an edge; None of points.
    bounce_count: Integers | None = None  # The largest after which a ray of its tree still hit something, if asked for.


class PixelOutcome(Outcome):
    traced: Count | None = None  # How many rays there were in all.
    first: SurfaceInteraction | None = None  # The camera ray's own hit; None where it is not asked for.


def combine(results: Outcome, rays: RayRecord) -> Outcome:
    own = rays.scattering
    color = own.background
    from_children = [gather(results.color, place) for place in rays.children]
    if own.surface is not None:
        color = jnp.where(rays.valid, own.surface.combine(*from_children[:2]), color)
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
    return Outcome(color, jnp.broadcast_to(complete, rays.valid.shape), sees_edge, bounces)


class Queue(eqx.Module):
    wave: Count  # The number of the next wave.
    heads: Int[Array, " waves"]  # The place of each wave's first ray, of those that are traced and of the next one.
    starts: Int[Array, " chunks"]  # The place of the first camera ray of each wave's worth that came in together.
    sent: Count  # How many camera rays came in.
    tail: Count  # The place after the last ray; beyond the queue's size if rays found no place.
    rays: PackedRays
    traced: RayRecord


RAYS_A_PLACE = 4  # The queue has room for so many times the camera rays that there are places for.


def write(all_: T, new: T, place: Count) -> T:
    """`all_` with other values from a place of the last axis on."""
    return jax.tree.map(lambda x, y: jax.lax.dynamic_update_slice_in_dim(x, y, place, -1), all_, new)


@dataclasses.dataclass(frozen=True, eq=False)
class Wavefront:
    """How a queue of rays is traced: of which scene, from which pixels, and with which sizes.

    Args:
        points: where the pixels look, as `rays_through` has it, and `step`.
        count: how many of them are to be traced, the first ones; what is said of the others has no meaning.
        with_hits: whether records say where rays hit, and how often paths bounced.
    """

    world: World
    camera: Camera
    points: Float[Array, "2 places"]
    step: Float[Array, "2"]
    count: Count | int
    with_hits: bool = False

    @property
    def size(self) -> int:
        """How many rays the queue traces."""
        return self.points.shape[1] * RAYS_A_PLACE

    @property
    def chunk(self) -> int:
        """How many rays a wave has: so many stay in a CPU's cache."""
        return min(self.size // 16, 512) if jax.default_backend() == "cpu" else self.size // 16

    @property
    def room(self) -> int:
        """The length of the queue's arrays: there is room for all that a last wave may send on.

        The last two places stay black: of no child, and, before it, of one that finds no place.
        """
        return self.size + 3 * self.chunk

    def read(self, all_: T, head: Count) -> T:
        """The values of a wave's rays."""
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, head, self.chunk, -1), all_)

    def camera_rays(self, first: Count) -> PackedRays:
        u, v = self.read(self.points, first)
        return packed(rays_through(self.camera, self.world.settings, u, v, self.step), jnp.zeros(self.chunk, jnp.int32))

    def scatter(self, head: Count, tail: Count, some: PackedRays) -> tuple[RayRecord, PackedRays, Count]:
        """Intersect and shade a wave: its record, the rays that it sends on, and how many these are."""
        live = head + jnp.arange(self.chunk, dtype=jnp.int32) < jnp.minimum(tail, self.size)
        # Stored at a place of their own: kernels that read from the middle of a queue are several times as slow.
        some = materialize(some, live)
        rays, number = unpacked(some), some.number
        level = materialize(trace_level(self.world, rays, live, number), live)
        kinds = [(wanted & live & (number < self.world.settings.levels), child) for wanted, child in level.children]
        depth = number if rays.footprint is None else rays.footprint.depth
        places, children, total = jnp.zeros((0, self.chunk), jnp.int32), some, jnp.zeros_like(tail)
        if kinds:
            children, slot, total = compact(kinds, number + 1)
            places = jnp.where(slot < slot.size, jnp.minimum(tail + slot, self.room - 2), self.room - 1)
        si = level.si if self.with_hits else None
        all_wanted = jnp.stack([wanted for wanted, _ in level.children]) if self.with_hits and kinds else None
        record = RayRecord(level.scattering, level.si.valid, depth, places, si, all_wanted)
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], self.chunk)), record), children, total

    def waits(self, queue: Queue) -> Count:
        """How many rays wait."""
        return jnp.minimum(queue.tail, self.size) - queue.heads[queue.wave]

    def has_more(self, queue: Queue) -> Bool[Array, ""]:
        """Whether camera rays may come in."""
        return (queue.sent < self.count) & (queue.tail < self.size)

    def trace_wave(self, queue: Queue) -> Queue:
        """Trace the next wave; camera rays come in where fewer wait. After the last ray nothing changes."""
        lacks, end = self.has_more(queue) & (self.waits(queue) < self.chunk), jnp.minimum(queue.tail, self.size)
        rays = write(queue.rays, only_if(lacks, self.camera_rays, jnp.where(lacks, queue.sent, 0)), end)
        place = jnp.where(lacks, queue.sent // self.chunk, len(queue.starts))
        starts = queue.starts.at[place].set(end, mode="drop")
        new = jnp.where(lacks, jnp.minimum(self.chunk, self.count - queue.sent), 0)

        head, tail = queue.heads[queue.wave], queue.tail + new
        end = jnp.minimum(tail, self.size)
        traced, children, total = only_if(head < end, self.scatter, head, tail, self.read(rays, head))
        # Where rays are fewer than a wave has, those that they send on are the next one.
        heads = queue.heads.at[queue.wave + 1].set(jnp.minimum(head + self.chunk, end))
        rays, records = write(rays, children, end), write(queue.traced, traced, head)
        return Queue(queue.wave + 1, heads, starts, queue.sent + new, tail + total, rays, records)

    def blend(self, queue: Queue, wave: Count, results: Outcome) -> Outcome:
        """The results with those of a wave: each ray blends what its children bring back."""
        head, end = queue.heads[wave], queue.heads[wave + 1]
        is_own = head + jnp.arange(self.chunk, dtype=jnp.int32) < end
        blended = combine(results, self.read(queue.traced, head))
        return write(results, select(is_own, blended, self.read(results, head)), head)


def trace_queue(front: Wavefront, reversible: bool = False) -> tuple[Queue, Outcome]:
    """The queue at the end of tracing camera rays and all that they send on, and what each of its rays brings back.

    Args:
        reversible: whether reverse mode can go through it, as `repeat` has it.
    """
    # Empty: every place has zeros in the shapes of a wave.
    start, room = jnp.zeros((), jnp.int32), front.room
    first = jax.eval_shape(front.camera_rays, start)
    record = jax.eval_shape(front.scatter, start, start, first)[0]
    rays, nothing = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-1], room), x.dtype), (first, record))
    # What ends the queue is a generation of rays a wave.
    waves = front.size // front.chunk + front.world.settings.levels + 2
    heads, starts = jnp.zeros(waves + 1, jnp.int32), jnp.zeros(front.points.shape[1] // front.chunk, jnp.int32)
    queue = Queue(start, heads, starts, start, start, rays, nothing)

    # Down, wave by wave.
    def goes_on(queue: Queue) -> Bool[Array, ""]:
        return front.has_more(queue) | (front.waits(queue) > 0)

    queue = repeat(front.trace_wave, queue, goes_on, waves, reversible)

    # Up, from the last wave to the first. Places that are not traced stay black.
    sees_edge = None if nothing.scattering.sees_edge is None else jnp.zeros(room, bool)
    bounce_count = jnp.zeros(room, jnp.int32) if front.with_hits else None
    complete = jnp.arange(room, dtype=jnp.int32) == room - 1
    results = Outcome(jnp.zeros_like(nothing.scattering.background), complete, sees_edge, bounce_count)

    def blend(state: tuple[Array, Outcome]) -> tuple[Array, Outcome]:
        wave = state[0] - 1
        return wave, front.blend(queue, wave, state[1])

    _, results = repeat(blend, (queue.wave, results), lambda state: state[0] > 0, waves, reversible)
    return queue, results


def trace(front: Wavefront, reversible: bool = False) -> PixelOutcome:
    """The outcome of each camera ray, by `trace_queue`.

    Where glass has dispersion one channel is traced after the other, which takes three times as long. What is not a
    colour then comes from the green channel; of edges what any channel sees counts.
    """

    def outcome(front: Wavefront) -> PixelOutcome:
        queue, results = trace_queue(front, reversible)

        def camera_s(x):
            each = jax.lax.map(lambda start: front.read(x, start), queue.starts)
            return jnp.moveaxis(each, 0, -2).reshape(*x.shape[:-1], -1)

        found, si = jax.tree.map(camera_s, (results, queue.traced.si))
        complete = found.complete & (jnp.arange(front.points.shape[1], dtype=jnp.int32) < queue.sent)
        return PixelOutcome(found.color, complete, found.sees_edge, found.bounce_count, queue.tail, si)

    if front.world.channel_ior is None:
        return outcome(front)

    def of_channel(ior):
        world = eqx.tree_at(lambda world: world.materials.ior, front.world, ior)
        return outcome(dataclasses.replace(front, world=world))

    each = jax.lax.map(jax.checkpoint(of_channel, prevent_cse=False), front.world.channel_ior)
    color = jnp.stack([each.color[channel, channel] for channel in range(3)])
    sees_edge = None if each.sees_edge is None else jnp.any(each.sees_edge, axis=0)
    complete, traced = jnp.all(each.complete, axis=0), jnp.max(each.traced)
    line = jax.tree.map(lambda x: x[LINE_CHANNEL], each)
    return dataclasses.replace(line, color=color, complete=complete, sees_edge=sees_edge, traced=traced)
