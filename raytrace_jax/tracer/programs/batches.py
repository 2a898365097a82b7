"""Points in batches: one program for any number of them, which are spread over all devices.

The arrays of a batch have fixed sizes, so that no rays are counted beforehand and no program is made anew where points
send on many: what finds no room is traced again with fewer points a batch.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Hashable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.levels.wavefront import Stage
from raytrace_jax.tracer.programs.plan import Plan, Wanted, in_blocks
from raytrace_jax.tracer.programs.tiles import share_out
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

Points = Float[np.ndarray, "2 points"]
"""Where in the picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 32
"""One call traces at most so many batches on each device: the call itself takes as long as some batches do."""

BATCH = 1216
"""Rays of a level that a CPU traces at once, as few as stay in its cache.

Derivatives by four numbers take, for the course's picture by points, 1.05 s with 1216, 1.15 to 1.25 with 320 to 832 and
1.3 with 2432; for its small picture by areas 0.56 s with 1216, 0.60 with 960, 0.69 with 2432 and 0.88 with 4864; for
POV-Ray's checker 0.88, 1.13, 1.0 and 1.1 s."""

FILLED = 0.95
"""Smaller batches are made to take this share of the room: other batches of these points may want a little more."""


class Slots(NamedTuple):
    """Batches in the slots of all devices, shared out evenly; the first one again in those that stay empty.

    Args:
        picture: of which picture each is.
        points: which of that picture's points, the last of them again where they are fewer.
        live: how many they are.
        counts: how many batches each device has, in its first slots.
    """

    picture: Int[np.ndarray, " slots"]
    points: Int[np.ndarray, "slots size"]
    live: Int[np.ndarray, " slots"]
    counts: Int[np.ndarray, " devices"]


class Batch(NamedTuple):
    """Some of a picture's points, by their numbers."""

    picture: int
    points: Int[np.ndarray, " points"]


class Filling(NamedTuple):
    """The plan of a batch, and how many points of those that were traced last find room in it."""

    plan: Plan
    most: int


FILLINGS: dict[Hashable, Filling] = {}
"""The fillings that served last, by the kind of scenes and settings."""


def in_batches(
    pictures: int,
    count: int,
    kind: Hashable,
    settings: ResolvedSettings,
    trace: Callable[[Slots, Plan], tuple[tuple[Array, ...], Wanted]],
) -> Iterator[tuple[Batch, list[np.ndarray]]]:
    """Trace all points of some pictures; yields each batch with what was found, the points on the last axis.

    Args:
        pictures: how many.
        count: how many points each has.
        kind: of scenes and settings whose points are alike.
        settings: what is rendered.
        trace: traces what is in the slots, which are the first axis of its results' arrays, with a plan; it returns as
            well the most rays that a batch wanted at each level.
    """
    filling, slots = filling_of(kind, settings), BATCHES * jax.device_count()
    everything, needed = spread_out(count), 0.0
    left = cut([Batch(picture, everything) for picture in range(pictures)], filling.most)
    while left:
        some, left = left[:slots], left[slots:]
        found, wanted = trace(fill_slots(some, filling.plan.tile_size), filling.plan)
        share = float(np.max(np.asarray(wanted.levels) / filling.plan.stages[0].capacity, initial=0.0))
        most = max(len(batch.points) for batch in some)
        if share > 1:
            filling = with_room(filling.plan, most, share)
            left = cut([*some, *left], filling.most)
            continue
        needed = max(needed, share / most)
        arrays = [np.asarray(all_) for all_ in found]
        for batch, slot in zip(some, slots_of(len(some)), strict=True):
            yield batch, [all_[slot][..., : len(batch.points)] for all_ in arrays]
    size = filling.plan.tile_size
    FILLINGS[kind] = filling._replace(most=max(filling.most, min(size, int(FILLED / needed)) if needed else size))


def filling_of(kind: Hashable, settings: ResolvedSettings) -> Filling:
    """The filling that served last for this kind; at first as many points as there is room for, of pixels a third."""
    rays = BATCH if jax.default_backend() == "cpu" else 1 << 16
    first = rays // 3 if settings.edges == "aware" else rays
    return FILLINGS.get(kind, Filling(Plan(1, rays, (Stage(in_blocks(rays), settings.levels + 1),), 1), first))


def with_room(plan: Plan, points: int, share: float) -> Filling:
    """A filling that has room, where points wanted `share` of it: fewer points, or a larger plan for a single point."""
    if points > 1:
        return Filling(plan, max(1, int(FILLED * points / share)))
    (stage,) = plan.stages
    larger = stage._replace(capacity=in_blocks(stage.capacity * share / FILLED))
    return Filling(dataclasses.replace(plan, stages=(larger,)), 1)


@functools.lru_cache(maxsize=8)
def spread_out(count: int) -> Int[np.ndarray, " points"]:
    """Numbers of points in an order of which any piece is spread over all of them; multiples of the golden ratio do."""
    places = np.arange(count) * ((math.sqrt(5) - 1) / 2) % 1
    return np.argsort(np.argsort(places))


def cut(batches: list[Batch], most: int) -> list[Batch]:
    """The batches cut into smaller ones of at most so many points, as even as can be."""
    return [
        Batch(picture, some)
        for picture, points in batches
        if len(points)
        for some in np.array_split(points, -(-len(points) // most))
    ]


def slots_of(batches: int) -> Int[np.ndarray, " batches"]:
    """The slot of each of some batches, which are shared out evenly over the devices, of `BATCHES` slots each."""
    number, devices = np.arange(batches), jax.device_count()
    return number % devices * BATCHES + number // devices


def fill_slots(batches: list[Batch], size: int) -> Slots:
    """Batches in their slots, each filled up to `size` points with its last one."""
    devices = jax.device_count()
    source = np.zeros(BATCHES * devices, int)
    source[slots_of(len(batches))] = np.arange(len(batches))
    picture = np.array([batch.picture for batch in batches])
    points = np.array([np.pad(batch.points, (0, size - len(batch.points)), mode="edge") for batch in batches])
    live = np.array([len(batch.points) for batch in batches], np.int32)
    counts = (len(batches) + devices - 1 - np.arange(devices)) // devices
    return Slots(picture[source], points[source], live[source], counts.astype(np.int32))


def in_front(
    plan: Plan, points: Float[Array, "2 size"], live: Int[Array, ""]
) -> tuple[Float[Array, "2 slots"], Bool[Array, " slots"]]:
    """A batch in the first places of a plan's first level, which has more, and which of these count."""
    places = plan.stages[0].capacity
    return jnp.pad(points, ((0, 0), (0, places - points.shape[1]))), jnp.arange(places, dtype=jnp.int32) < live


def steps_of_devices(step: Float[np.ndarray, "2"] | None, dtype) -> Float[np.ndarray, "devices 2"]:
    """The step from one pixel to the next, once for each device; zero for points, which have none."""
    return np.tile(np.zeros(2) if step is None else step, (jax.device_count(), 1)).astype(dtype)


def map_batches(trace_batch, common, *arrays, counts: Int[Array, " devices"], steps: Float[Array, "devices 2"]):
    """`trace_batch(common, *batch, step)` of each batch in the slots, stacked; slots that are empty stay zero.

    Args:
        trace_batch: traces one; of what it is given and of nothing else that is traced, as for `share_out`.
        common: what all batches have in common.
        arrays: what each batch has of its own, in the slots as its first axis.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: as `steps_of_devices`.
    """

    def trace_some(common, counts, steps, *arrays):
        def batch(number):
            return jax.tree.map(lambda x: x[number], arrays)

        def trace_next(number, found):
            one = trace_batch(common, *batch(number), steps[0])
            return jax.tree.map(lambda all_, new: all_.at[number].set(new), found, one)

        shapes = jax.eval_shape(trace_batch, common, *batch(0), steps[0])
        slots = len(jax.tree.leaves(arrays)[0])
        nothing = jax.tree.map(lambda x: jnp.zeros((slots, *x.shape), x.dtype), shapes)
        return jax.lax.fori_loop(0, counts[0], trace_next, nothing)

    return share_out(trace_some, common, counts, steps, *arrays)
