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
"""Where in the picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 32
"""One call traces at most so many batches on each device: the call itself takes as long as some batches do."""

import os
RAYS = int(os.environ.get('RA','4096'))
"""Rays of a level that a CPU traces at once, as few as stay in its cache.

Derivatives by four numbers take, for the course's picture by points, 1.05 s with 1216, 1.15 to 1.25 with 320 to 832 and
1.3 with 2432; for its small picture by areas 0.56 s with 1216, 0.60 with 960, 0.69 with 2432 and 0.88 with 4864; for
POV-Ray's checker 0.88, 1.13, 1.0 and 1.1 s."""

FILLED = 0.95
"""Batches are made to take this fraction of the room: other batches of these pixels may want a little more."""


class Capacity(NamedTuple):
    """The sizes of a batch.

    Args:
        rays: how many rays find room; there are places for half as many pixels.
        pixels: of how many pixels all rays find room.
    """

    rays: int
    pixels: int

    def with_room(self, ratio: float) -> "Capacity":
        """A capacity with room, where as many pixels wanted `ratio` times the rays: fewer pixels, or more rays."""
        if self.pixels > 1:
            return self._replace(pixels=max(1, int(FILLED * self.pixels / ratio)))
        return self._replace(rays=in_blocks(self.rays * ratio / FILLED))


CAPACITIES: dict[Hashable, Capacity] = {}
"""The capacities that served last, by `scene_key`."""


def scene_key(scene: Any, settings: ResolvedSettings) -> Hashable:
    """What scenes and settings have in common whose pixels send on about as many rays."""
    return settings, jax.tree.structure(scene)


def known_capacity(key: Hashable, settings: ResolvedSettings) -> Capacity:
    """The capacity that served last; at first one for points, or for pixels that are areas and send on three rays."""
    rays = RAYS if jax.default_backend() == "cpu" else 1 << 16
    return CAPACITIES.get(key, Capacity(rays, rays // (6 if settings.edges == "aware" else 4)))


class Batches(NamedTuple):
    """Batches in the slots of all devices, shared out evenly; empty slots hold the first batch and are not traced.

    Args:
        picture: which picture a slot's batch is of.
        points: where its pixels look; places beyond `live` do not count.
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


def one_batch(capacity: Capacity, dtype: np.dtype) -> Batches:
    """A batch of one pixel, as an argument to compile a program with."""
    return fill_slots(np.zeros(1, int), np.zeros((2, 1, 1), dtype), None, capacity.rays)


def in_batches(
    pictures: int,
    points: Points,
    step: Float[np.ndarray, "2"] | None,
    key: Hashable,
    settings: ResolvedSettings,
    trace: Callable[[Batches, Capacity], tuple[tuple[Array, ...], Array]],
) -> list[np.ndarray]:
    """Trace the same points of some pictures, of either one at least.

    Args:
        pictures: how many pictures.
        points: where to look.
        step: how far it is from one pixel to the next; None of points.
        key: as `scene_key`.
        settings: what is rendered.
        trace: traces batches. Returns arrays with the slots as their first axis and the places of a batch as their
            last, and the largest number of rays that a level of any batch wanted.

    Returns:
        Those arrays, with the pictures as their first axis and the points as their last.
    """
    capacity, total = known_capacity(key, settings), points.shape[1]
    found, done, need = list[np.ndarray](), 0, 0.0
    while done < pictures:
        # Each picture is cut into batches of one size. Its last batch has its last pixel several times.
        each = -(-total // capacity.pixels)
        size = -(-total // each)
        members = np.pad(spread_out(total), (0, each * size - total), mode="edge").reshape(each, size)
        calls = range(done * each, pictures * each, BATCHES * jax.device_count())
        done = pictures
        for first in calls:
            number = np.arange(first, min(first + calls.step, calls.stop))
            picture, pixels = number // each, members[number % each]
            arrays, wanted = trace(fill_slots(picture, points[:, pixels], step, capacity.rays), capacity)
            ratio = float(np.max(wanted)) / capacity.rays
            if ratio > 1:
                # Pictures that are whole stay as they are; the others are traced again.
                capacity, done = capacity._replace(pixels=size).with_room(ratio), int(picture[0])
                break
            need = max(need, ratio / size)
            found = found or [np.empty((pictures, *x.shape[1:-1], total), x.dtype) for x in arrays]
            for all_, some in zip(found, arrays, strict=True):
                rows = np.asarray(some)[slots_of(len(number)), ..., :size]
                all_[picture[:, None], ..., pixels] = np.moveaxis(rows, -1, 1)
    most = min(capacity.rays // 2, int(FILLED / need))
    CAPACITIES[key] = capacity._replace(pixels=max(capacity.pixels, most))
    return found


@functools.lru_cache(maxsize=8)
def spread_out(count: int) -> Int[np.ndarray, " points"]:
    """Numbers of points in an order of which any piece is spread over all of them; multiples of the golden ratio do."""
    return np.argsort(np.argsort(np.arange(count) * ((math.sqrt(5) - 1) / 2) % 1))


def map_batches(trace_batch, common, each, batches: Batches):
    """`trace_batch(common, one, points, pixels, step)` of each batch, stacked; slots that are empty stay zero.

    Args:
        trace_batch: traces one; of what it is given and of nothing else that is traced, as for `share_out`.
        common: what all batches have in common.
        each: what each batch has of its own, with the slots as its first axis.
        batches: where the batches look.
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
        common: what every device gets whole.
        arrays: what is shared out.
    """
    if jax.device_count() == 1:
        return function(common, *arrays)
    mesh = jax.make_mesh((jax.device_count(),), ("batches",), axis_types=(jax.sharding.AxisType.Auto,))
    share = PartitionSpec("batches")
    specs = PartitionSpec(), *(share for _ in arrays)
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=share, check_vma=False)(common, *arrays)
