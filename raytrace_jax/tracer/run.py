"""Pixels in batches: one program for any number of them, of pictures, and of sizes.

A batch's arrays have fixed sizes. How many pixels find room in them is learnt by tracing: what finds no room is traced
again with fewer pixels a batch, so that nothing is counted beforehand and nothing is compiled anew.
"""

import functools
import math
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, Int

from raytrace_jax.tracer.levels.compaction import in_blocks
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

Points = Float[np.ndarray, "2 points"]
"""Places in a picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 32
"""One call traces at most so many batches on each device: the call itself takes as long as some batches do."""

RAYS = 8192
"""Rays of a batch on a CPU; with derivatives half as many, so that they stay in its cache.

Pictures by points, 640 x 480, take .49 s (course) and .70 s (`pov_ball`) with 4096, .38 and .55 s with 8192 and 16384;
derivatives by four numbers of areas, 160 x 120, 1.37 and 1.66 s with 4096, 1.87 and 2.32 s with 8192."""

FILLED = 0.95
"""Batches are made to take this fraction of the room: other batches of these pixels may want a little more."""


class Capacity(NamedTuple):
    """The sizes of a batch."""

    rays: int
    pixels: int


NEEDS: dict[Hashable, float] = {}
"""Rays that a pixel was last seen to want, its own included, by `scene_key`."""


def scene_key(scene: Any, settings: ResolvedSettings) -> Hashable:
    """Cache key: scenes and settings with equal keys send on about as many rays a pixel."""
    return settings, jax.tree.structure(scene)


def known_need(key: Hashable, settings: ResolvedSettings) -> float:
    """Rays that a pixel was last seen to want; at first a guess for points, or for areas that see edges."""
    return NEEDS.get(key, 6.0 if settings.edges == "aware" else 4.0)


def capacity_for(need: float, derivatives: bool = False) -> Capacity:
    """The sizes of batches of pixels that want so many rays each."""
    rays = (RAYS if jax.default_backend() == "cpu" else 1 << 18) // (2 if derivatives else 1)
    if need > FILLED * rays:
        return Capacity(16 * in_blocks(need / FILLED / 16), 1)
    return Capacity(rays, min(rays // 2, int(FILLED * rays / need)))


class Batches(NamedTuple):
    """Batches in the slots of all devices, shared out evenly; empty slots hold the first batch and are not traced.

    Args:
        picture: which picture a slot's batch is of.
        points: where its pixels look; places beyond the batch's pixels do not count.
        counts: how many batches each device has, in its first slots, and how many pixels each batch.
        steps: how far it is from one pixel to the next, once for each device; zero for points, which have no size.
    """

    picture: Int[np.ndarray, " slots"]
    points: Float[np.ndarray, "slots 2 places"]
    counts: Int[np.ndarray, "devices 2"]
    steps: Float[np.ndarray, "devices 2"]


def fill_slots(
    picture: Int[np.ndarray, " batches"],
    points: Float[np.ndarray, "2 batches pixels"],
    step: Float[np.ndarray, "2"] | None,
    rays: int,
) -> Batches:
    """Batches in their slots, with places for half as many pixels as rays find room."""
    devices, (_, batches, pixels) = jax.device_count(), points.shape
    source = np.zeros(BATCHES * devices, int)
    source[slots_of(batches)] = np.arange(batches)
    places = np.zeros((len(source), 2, rays // 2), points.dtype)
    places[slots_of(batches), :, :pixels] = points.swapaxes(0, 1)
    each = (batches + devices - 1 - np.arange(devices)) // devices
    counts = np.stack([each, np.full(devices, pixels)], axis=1).astype(np.int32)
    steps = np.tile(np.zeros(2) if step is None else step, (devices, 1)).astype(points.dtype)
    return Batches(picture[source], places, counts, steps)


def slots_of(batches: int) -> Int[np.ndarray, " batches"]:
    """The slot of each of some batches: they go to the devices in turn, each of which has `BATCHES` slots."""
    number, devices = np.arange(batches), jax.device_count()
    return number % devices * BATCHES + number // devices


def one_batch(key: Hashable, settings: ResolvedSettings, dtype: np.dtype, derivatives: bool = False) -> Batches:
    """A batch of one pixel, as an argument to compile a program with."""
    rays = capacity_for(known_need(key, settings), derivatives).rays
    return fill_slots(np.zeros(1, int), np.zeros((2, 1, 1), dtype), None, rays)


def in_batches(
    pictures: int,
    points: Points,
    step: Float[np.ndarray, "2"] | None,
    key: Hashable,
    settings: ResolvedSettings,
    trace: Callable[[Batches], tuple[tuple[Array, ...], Array]],
    derivatives: bool = False,
) -> list[np.ndarray]:
    """Trace the same points of some pictures, of either one at least.

    Args:
        step: how far it is from one pixel to the next; None of points.
        trace: traces batches. Returns arrays with the slots as their first axis and the places of a batch as their
            last, and how many rays each batch wanted.

    Returns:
        Those arrays, with the pictures as their first axis and the points as their last.
    """
    (order, places), total = spread_out(points.shape[1]), points.shape[1]
    need, seen = known_need(key, settings), 0.0
    found, done = list[np.ndarray](), 0
    while done < pictures:
        capacity = capacity_for(need, derivatives)
        # Each picture is cut into batches of one size. Its last batch has its last pixel several times.
        each = -(-total // capacity.pixels)
        size = -(-total // each)
        members = np.pad(order, (0, each * size - total), mode="edge").reshape(each, size)
        spread, parts = np.take(points, members, axis=1), list[list[np.ndarray]]()
        begin, end = done, pictures
        for first in range(begin * each, end * each, BATCHES * jax.device_count()):
            number = np.arange(first, min(first + BATCHES * jax.device_count(), end * each))
            batches = fill_slots(number // each, spread[:, number % each], step, capacity.rays)
            arrays, wanted = trace(batches)
            most = int(np.max(wanted))
            seen = max(seen, most / size)
            if most > capacity.rays:
                # Pictures that are whole stay as they are; the others are traced again.
                need, end = seen, first // each
                break
            parts.append([np.asarray(all_)[slots_of(len(number)), ..., :size] for all_ in arrays])
        # Back into the order of the points.
        for k, all_ in enumerate(zip(*parts, strict=True)):
            rows = np.concatenate(all_)[: (end - begin) * each]
            rows = np.moveaxis(rows.reshape(end - begin, each, *rows.shape[1:]), 1, -2)
            if len(found) <= k:
                found.append(np.empty((pictures, *rows.shape[1:-2], total), rows.dtype))
            np.take(rows.reshape(*rows.shape[:-2], each * size), places, axis=-1, out=found[k][begin:end], mode="clip")
        done = end
    NEEDS[key] = seen
    return found


@functools.lru_cache(maxsize=8)
def spread_out(count: int) -> tuple[Int[np.ndarray, " points"], Int[np.ndarray, " points"]]:
    """Numbers of points in an order of which any piece is spread over all of them, and the place of each point in it.

    Multiples of the golden ratio have such an order.
    """
    places = np.argsort(np.arange(count) * ((math.sqrt(5) - 1) / 2) % 1)
    return np.argsort(places), places


def map_batches(trace_batch, common, each, batches: Batches):
    """`trace_batch(common, one, points, pixels, step)` of each batch, stacked; slots that are empty stay zero.

    Args:
        trace_batch: traces one; of what it is given and of nothing else that is traced, as for `share_out`.
    """

    def trace_some(common, each, points, counts, steps):
        (count, pixels), step = counts[0], steps[0]

        def one(number):
            return trace_batch(common, jax.tree.map(lambda x: x[number], each), points[number], pixels, step)

        def trace_next(number, found):
            return jax.tree.map(lambda all_, new: all_.at[number].set(new), found, one(number))

        nothing = jax.tree.map(lambda x: jnp.zeros((len(points), *x.shape), x.dtype), jax.eval_shape(one, 0))
        return jax.lax.fori_loop(0, count, trace_next, nothing)

    return share_out(trace_some, common, each, batches.points, batches.counts, batches.steps)


def share_out(function, common, *arrays):
    """`function(common, *arrays)` with the arrays' first axes shared out evenly over all devices, each with its share.

    Args:
        function: of what it is given and of nothing else that is traced: a value from an earlier program lies on the
            same devices, and JAX refuses such a one where it is closed over.
    """
    if jax.device_count() == 1:
        return function(common, *arrays)
    mesh = jax.make_mesh((jax.device_count(),), ("batches",), axis_types=(jax.sharding.AxisType.Auto,))
    share = PartitionSpec("batches")
    specs = PartitionSpec(), *(share for _ in arrays)
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=share, check_vma=False)(common, *arrays)
