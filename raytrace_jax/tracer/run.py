"""Pixels in batches: one program for any number of them, of pictures, and of sizes.

A batch's arrays have fixed sizes. How many pixels find room in them is learnt by tracing: what finds no room is traced
again with fewer pixels a batch, and nothing is compiled anew. Within a transformation of JAX nothing can be traced
again: sizes are given, and the rays that find no room are counted.
"""

import math
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, Int

from raytrace_jax.tracer.levels.integrator import RAYS_A_PLACE
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

AnyArray = TypeVar("AnyArray", Array, np.ndarray)

Points = Float[np.ndarray, "2 points"] | Float[Array, "2 points"]
"""Places in a picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 16
"""One call traces at most so many batches on each device: the call itself takes as long as some batches do."""

RAYS = {"point": 1 << 14, "aware": 1 << 15}
"""Rays of a batch on a CPU, by `edges`.

Each batch ends with a dozen chunks that are not full, and begins with an empty queue. A hundred pictures of 20 x 15 on
two devices take .037 s (course by points; .048 s with twice as many rays), and .46 s by areas (1.05 s with half)."""


class Capacity(NamedTuple):
    """The sizes of a batch; static and hashable."""

    rays: int
    pixels: int

    def lacks(self, needed: "Capacity") -> bool:
        return self.rays < needed.rays or self.pixels > needed.pixels


Room = Capacity | None
"""The sizes within a transformation of JAX; None outside of one."""

NEEDS: dict[Hashable, float] = {}
"""Rays that a pixel was last seen to want, its own included, by `scene_key`."""


def scene_key(scene: Any, settings: ResolvedSettings) -> Hashable:
    """Cache key: scenes and settings with equal keys send on about as many rays a pixel."""
    return settings, jax.tree.structure(scene)


def known_need(key: Hashable, settings: ResolvedSettings) -> float:
    """Rays that a pixel was last seen to want; at first a guess."""
    return NEEDS.get(key, 6.0 if settings.edges == "aware" else 4.0)


def capacity_for(need: float, settings: ResolvedSettings) -> Capacity:
    """The sizes of batches of pixels that want so many rays each."""
    rays = RAYS[settings.edges or "aware"] if jax.default_backend() == "cpu" else 1 << 18
    # Not all of the room: other batches of these pixels may want a little more.
    filled = 0.95
    if need > filled * rays:
        return Capacity(4096 * math.ceil(need / filled / 4096), 1)
    return Capacity(rays, min(rays // RAYS_A_PLACE, int(filled * rays / need)))


class Batches(NamedTuple):
    """Batches in the slots of all devices, shared out evenly; empty slots hold the first batch and are not traced."""

    picture: Int[np.ndarray, " slots"]  # Which picture a slot's batch is of.
    points: Float[Array, "slots 2 places"] | Float[np.ndarray, "slots 2 places"]  # Where its pixels look.
    counts: Int[np.ndarray, "devices 2"]  # Batches of each device, in its first slots, and pixels of each batch.
    steps: Float[np.ndarray, "devices 2"]  # How far it is from one pixel to the next, once for each device.


def cut(points: int, most: int) -> tuple[int, int]:
    """The number n of batches, and the size of each, of points of which so many find room in one.

    Batch k has the points k, k + n, k + 2 n, ...: spread over the picture, so that all batches want about as many rays.
    Their columns are multiples of n modulo the width. Where n is large it shares no factor with the number of points,
    and they go through all columns evenly (a discrete Kronecker sequence; Weyl 1916).
    """
    batches = -(-points // most)
    while batches > 8 and math.gcd(batches, points) > 1:
        batches += 1
    return batches, -(-points // batches)


def members(batch: AnyArray, size: int, points: int, batches: int) -> AnyArray:
    """The numbers of the points in some batches; the last point fills those that have one less."""
    numpy: Any = np if isinstance(batch, np.ndarray) else jnp
    return numpy.minimum(numpy.arange(size, dtype=np.int32) * batches + batch[:, None], points - 1)


def together(found: AnyArray, points: int) -> AnyArray:
    """What was found for points that were `cut`, "pictures batches ... size", in their order: "pictures ... points"."""
    spread = found.transpose((0, *range(2, found.ndim), 1))
    return spread.reshape((*spread.shape[:-2], spread.shape[-2] * spread.shape[-1]))[..., :points]


def slots_of(batches: int) -> Int[np.ndarray, " batches"]:
    """The slot of each of some batches: they go to the devices in turn, each of which has `BATCHES` slots."""
    number, devices = np.arange(batches), jax.device_count()
    return number % devices * BATCHES + number // devices


def fill_slots(
    number: Int[np.ndarray, " batches"], points: Points, step: Float[np.ndarray, "2"], room: Capacity
) -> Batches:
    """Batches of some pictures in their slots; `number` counts batches through all pictures."""
    devices, (batches, size) = jax.device_count(), cut(points.shape[1], room.pixels)
    slots, own = BATCHES * devices, slots_of(len(number))
    places = np.zeros((slots, 2, room.rays // RAYS_A_PLACE), points.dtype)
    found = np.asarray(points)[:, members(number % batches, size, points.shape[1], batches)]
    places[own, :, :size] = np.moveaxis(found, 0, 1)
    picture = np.full(slots, number[0] // batches)
    picture[own] = number // batches
    each = (len(number) + devices - 1 - np.arange(devices)) // devices
    counts = np.stack([each, np.full(devices, size)], axis=1).astype(np.int32)
    steps = np.tile(step, (devices, 1)).astype(points.dtype)
    return Batches(picture, places, counts, steps)


def sample_batch(key: Hashable, settings: ResolvedSettings, dtype: np.dtype) -> Batches:
    """A batch of one pixel, as an argument to compile a program with."""
    room = capacity_for(known_need(key, settings), settings)
    return fill_slots(np.zeros(1, int), np.zeros((2, 1), dtype), np.zeros(2), room)


def all_batches(points: Points, step: Float[np.ndarray, "2"], room: Capacity) -> Batches:
    """All batches of one picture in a slot each, on one device, within a transformation of JAX.

    On several CPUs derivatives would be summed, and the program may wait for itself for ever (XLA of JAX 0.10: the
    all-reduces of two devices that begin in another order).
    """
    batches, size = cut(points.shape[1], room.pixels)
    own = points[:, members(jnp.arange(batches, dtype=jnp.int32), size, points.shape[1], batches)]
    places = jnp.pad(jnp.moveaxis(own, 0, 1), ((0, 0), (0, 0), (0, room.rays // RAYS_A_PLACE - size)))
    counts = np.array([[batches, size]], np.int32)
    return Batches(np.zeros(batches, int), places, counts, step.astype(points.dtype)[None])


def in_batches(
    pictures: int,
    points: Points,
    step: Float[np.ndarray, "2"],
    key: Hashable,
    settings: ResolvedSettings,
    program: Callable[[Batches], tuple[tuple[Array, ...], Array]],
    room: Room = None,
) -> tuple[list[Any], Any]:
    """Trace `points` in each of `pictures` scenes (both at least 1).

    Args:
        step: how far it is from one pixel to the next; of no matter to points.
        program: traces batches. Returns arrays with the slots as their first axis and the places of a batch as their
            last, and how many rays each batch wanted.
        room: the sizes of a batch, within a transformation of JAX: one picture in one call, with traced `points`.

    Returns:
        Those arrays, with the pictures as their first axis and the points as their last; and how many rays found no
        room in the batch that wanted most, 0 without `room`.
    """
    total, devices = points.shape[1], jax.device_count()
    if room is not None:
        arrays, wanted = program(all_batches(points, step, room))
        size = cut(total, room.pixels)[1]
        return [together(x[None, ..., :size], total) for x in arrays], jnp.maximum(jnp.max(wanted) - room.rays, 0)

    need, seen = known_need(key, settings), 0.0
    while True:
        room = capacity_for(need, settings)
        if pictures == 1 and total * need > room.rays / 8:
            # Enough for all devices.
            room = room._replace(pixels=min(room.pixels, -(-total // devices)))
        batches, size = cut(total, room.pixels)
        parts = list[list[np.ndarray]]()
        for first in range(0, pictures * batches, BATCHES * devices):
            number = np.arange(first, min(first + BATCHES * devices, pictures * batches))
            arrays, wanted = program(fill_slots(number, points, step, room))
            seen = max(seen, int(np.max(wanted)) / size)
            if np.max(wanted) > room.rays:
                break
            parts.append([np.asarray(x)[slots_of(len(number)), ..., :size] for x in arrays])
        else:
            break
        need = seen
    NEEDS[key] = seen
    found = [np.concatenate(x) for x in zip(*parts, strict=True)]
    return [together(x.reshape(pictures, batches, *x.shape[1:]), total) for x in found], 0


def map_batches(function, common, each, batches: Batches, reversible: bool):
    """`function(common, one, points, pixels, step)` of each batch, stacked; slots that are empty stay zero.

    Batches are shared out evenly over all devices, but for reverse mode.

    Args:
        function: of what it is given and of nothing else that is traced: a value from an earlier program lies on the
            same devices, and JAX refuses such a one where it is closed over.
        reversible: whether reverse mode can go through it. It computes each batch anew, in the memory of one, on one
            device.
    """

    def own_share(common, each, points, counts, steps):
        (count, pixels), step = counts[0], steps[0]

        def one(number):
            return function(common, jax.tree.map(lambda x: x[number], each), points[number], pixels, step)

        def put(number, found):
            return jax.tree.map(lambda all_, new: all_.at[number].set(new), found, one(number))

        if reversible:
            return jax.lax.map(jax.checkpoint(one, prevent_cse=False), jnp.arange(len(points), dtype=jnp.int32))
        nothing = jax.tree.map(lambda x: jnp.zeros((len(points), *x.shape), x.dtype), jax.eval_shape(one, 0))
        return jax.lax.fori_loop(0, count, put, nothing)

    given = common, each, batches.points, batches.counts, batches.steps
    if reversible or jax.device_count() == 1:
        return own_share(*given)
    mesh = jax.make_mesh((jax.device_count(),), ("batches",), axis_types=(jax.sharding.AxisType.Auto,))
    share = PartitionSpec("batches")
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    sharded = jax.shard_map(
        own_share, mesh=mesh, in_specs=(PartitionSpec(), *[share] * 4), out_specs=share, check_vma=False
    )
    return sharded(*given)
