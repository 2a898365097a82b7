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

from raytrace_jax.tracer.levels.compaction import in_blocks
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
        """Whether it is too small where another one is needed."""
        return self.rays < needed.rays or self.pixels > needed.pixels


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
        return Capacity(64 * in_blocks(need / filled / 64), 1)
    return Capacity(rays, min(rays // RAYS_A_PLACE, int(filled * rays / need)))


class Batches(NamedTuple):
    """Batches in the slots of all devices, shared out evenly; empty slots hold the first batch and are not traced.

    Args:
        picture: which picture a slot's batch is of.
        points: where its pixels look; places beyond the batch's pixels do not count.
        counts: how many batches each device has, in its first slots, and how many pixels each batch.
        steps: how far it is from one pixel to the next, once for each device; zero for points, which have no size.
    """

    picture: Int[np.ndarray, " slots"]
    points: Float[Array, "slots 2 places"] | Float[np.ndarray, "slots 2 places"]
    counts: Int[np.ndarray, "devices 2"]
    steps: Float[np.ndarray, "devices 2"]


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


def together(rows: AnyArray, points: int) -> AnyArray:
    """What was found for points that were `cut`, "batches ... size", in their order: "... points"."""
    spread = rows.transpose((*range(1, rows.ndim), 0))
    return spread.reshape((*spread.shape[:-2], -1))[..., :points]


def fill_slots(
    number: Int[np.ndarray, " batches"], points: Points, step: Float[np.ndarray, "2"] | None, room: Capacity
) -> Batches:
    """Batches of some pictures in their slots, with places for a quarter as many pixels as rays find room.

    Args:
        number: the batches' numbers, counted through all pictures.
    """
    devices, (batches, size) = jax.device_count(), cut(points.shape[1], room.pixels)
    slots, own = BATCHES * devices, slots_of(len(number))
    places = np.zeros((slots, 2, room.rays // RAYS_A_PLACE), points.dtype)
    found = np.asarray(points)[:, members(number % batches, size, points.shape[1], batches)]
    places[own, :, :size] = np.moveaxis(found, 0, 1)
    picture = np.full(slots, number[0] // batches)
    picture[own] = number // batches
    each = (len(number) + devices - 1 - np.arange(devices)) // devices
    counts = np.stack([each, np.full(devices, size)], axis=1).astype(np.int32)
    steps = np.tile(np.zeros(2) if step is None else step, (devices, 1)).astype(points.dtype)
    return Batches(picture, places, counts, steps)


def members(batch: AnyArray, size: int, points: int, batches: int) -> AnyArray:
    """The numbers of the points in some batches; the last point fills those that have one less."""
    numpy: Any = np if isinstance(batch, np.ndarray) else jnp
    return numpy.minimum(numpy.arange(size, dtype=np.int32) * batches + batch[:, None], points - 1)


def slots_of(batches: int) -> Int[np.ndarray, " batches"]:
    """The slot of each of some batches: they go to the devices in turn, each of which has `BATCHES` slots."""
    number, devices = np.arange(batches), jax.device_count()
    return number % devices * BATCHES + number // devices


def sample_batch(key: Hashable, settings: ResolvedSettings, dtype: np.dtype) -> Batches:
    """A batch of one pixel, as an argument to compile a program with."""
    room = capacity_for(known_need(key, settings), settings)
    return fill_slots(np.zeros(1, int), np.zeros((2, 1), dtype), None, room)


def all_batches(points: Points, step: Float[np.ndarray, "2"] | None, room: Capacity) -> Batches:
    """All batches of one picture in a slot each, on one device, within a transformation of JAX.

    On several devices the parts would have to be gathered, and a sum of derivatives taken over them. On CPUs such a
    program may wait for itself for ever (XLA of JAX 0.10: the all-reduces of two devices that begin in another order).
    """
    batches, size = cut(points.shape[1], room.pixels)
    own = points[:, members(jnp.arange(batches, dtype=jnp.int32), size, points.shape[1], batches)]
    places = jnp.pad(jnp.moveaxis(own, 0, 1), ((0, 0), (0, 0), (0, room.rays // RAYS_A_PLACE - size)))
    steps = (np.zeros(2) if step is None else step).astype(points.dtype)[None]
    return Batches(np.zeros(batches, int), places, np.array([[batches, size]], np.int32), steps)


def in_batches(
    pictures: int,
    points: Points,
    step: Float[np.ndarray, "2"] | None,
    key: Hashable,
    settings: ResolvedSettings,
    program: Callable[[Batches], tuple[tuple[Array, ...], Array]],
    room: Capacity | None = None,
) -> tuple[list[Any], Any]:
    """Trace `points` in each of `pictures` scenes (both at least 1).

    Args:
        step: how far it is from one pixel to the next; None of points.
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
        found = [together(all_[..., : cut(total, room.pixels)[1]], total)[None] for all_ in arrays]
        return found, jnp.maximum(jnp.max(wanted) - room.rays, 0)

    need, seen = known_need(key, settings), 0.0
    found, done = list[np.ndarray](), 0
    while done < pictures:
        room = capacity_for(need, settings)
        if pictures == 1 and total * need > room.rays / 8:
            # Enough for all devices.
            room = room._replace(pixels=min(room.pixels, -(-total // devices)))
        batches, size = cut(total, room.pixels)
        begin, end, parts = done, pictures, list[list[np.ndarray]]()
        for first in range(begin * batches, end * batches, BATCHES * devices):
            number = np.arange(first, min(first + BATCHES * devices, end * batches))
            arrays, wanted = program(fill_slots(number, points, step, room))
            most = int(np.max(wanted))
            seen = max(seen, most / size)
            if most > room.rays:
                # Pictures that are whole stay as they are; the others are traced again.
                need, end = seen, first // batches
                break
            parts.append([np.asarray(all_)[slots_of(len(number)), ..., :size] for all_ in arrays])
        for k, all_ in enumerate(zip(*parts, strict=True)):
            rows = np.concatenate(all_)[: (end - begin) * batches]
            rows = rows.reshape(end - begin, batches, *rows.shape[1:])
            if len(found) <= k:
                found.append(np.empty((pictures, *rows.shape[2:-1], total), rows.dtype))
            for picture, own in enumerate(rows, start=begin):
                found[k][picture] = together(own, total)
        done = end
    NEEDS[key] = seen
    return found, 0


def map_batches(function, common, each, batches: Batches, reversible: bool):
    """`function(common, one, points, pixels, step)` of each batch, stacked; slots that are empty stay zero.

    Args:
        function: of what it is given and of nothing else that is traced, as for `share_out`.
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
    return own_share(*given) if reversible else share_out(own_share, *given)


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
