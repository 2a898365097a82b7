"""Pixels in batches: one program for any number of them, of pictures, and of sizes.

A batch's queue has a fixed size, and pixels whose rays found no place in it are not complete. Outside of JAX's
transformations these are traced again, fewer a batch, and nothing is compiled anew. Within one nothing can be traced
again: so many pixels share a queue that `rays_per_pixel` of the settings suffice, and incomplete ones are an error or
are counted.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Bool, Float, Int

from ..util.numerics import is_traced, repeat
from .geometry.rays import Count, Number, Step
from .integrator import RAYS_A_PLACE, PixelOutcome
from .settings import ResolvedSettings

T = TypeVar("T")

Points = Float[np.ndarray, "2 points"] | Float[Array, "2 points"]
"""Places in a picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 16
"""One call traces at most so many batches on each device: that amortises the call's overhead."""

QUEUE = {"point": 1 << 14, "aware": 1 << 15}
"""Rays of a batch's queue on a CPU, by `edges`.

Each batch ends with a dozen chunks that are not full, and begins with an empty queue. A hundred pictures of 20 x 15 on
two devices take .037 s (course by points; .048 s with twice as many rays), and .46 s by areas (1.05 s with half)."""

FIRST_SHARE = {"point": 0.5, "aware": 0.8}
"""Share of `ray_budget` that pixels are first given which can be traced again.

The budget suffices for many scenes. Batches that are fuller take less time, and those that are too full cost the rays
of pixels that are not complete."""


class Batches(NamedTuple):
    """Batches in the slots of each device."""

    picture: Int[np.ndarray, "devices slots"]  # Which picture a slot's batch is of.
    points: Float[Array, "devices slots 2 places"] | Float[np.ndarray, "devices slots 2 places"]  # Where pixels look.
    counts: Int[np.ndarray, "devices slots"]  # How many pixels there are; 0 in the slots that are empty, the last ones.
    step: Step  # How far it is from one pixel to the next.


Program = Callable[[Batches], tuple[tuple[Array, ...], Bool[Array, "devices slots places"]]]
"""Traces batches: returns arrays "devices slots ... places", and which pixels are complete."""


def trace_points(
    pictures: int, points: Points, step: Step, settings: ResolvedSettings, program: Program
) -> tuple[list[Any], Any]:
    """Trace points in each of some pictures.

    Args:
        points: traced within a transformation of JAX, where the program is a part of the caller's, of one picture.
        step: how far it is from one pixel to the next, of no matter to points.

    Returns:
        The program's arrays, "pictures ... points", and how many points lacked room for their rays.
    """
    trace = in_one_call if is_traced(points) else in_batches
    return trace(pictures, points, step, settings, program)


def ray_budget(settings: ResolvedSettings, step: Step, points: int | None = None) -> float:
    """How many rays a pixel may want, on the mean of a whole picture, or of some of its points.

    Our own scenes want up to 9 by points. By areas they want 16 at 240 pixels a row, 35 at 64 and 73 at 16: large
    pixels see more edges. Some of the points may be those that want most, up to ten times as many.
    """
    if settings.rays_per_pixel is not None:
        return float(settings.rays_per_pixel)
    mean = 10.0 if settings.edges == "point" else max(20.0, 96 / (1 + 1 / (60 * float(step[0]))))
    return mean if points is None else mean * min(max(round(1 / abs(float(np.prod(step)))) / points, 1), 10)


def refuse_overflow(found: PixelOutcome, count: Count, settings: ResolvedSettings) -> Number:
    """One, or an error while the program runs: some of the first `count` pixels are not complete, and `throw` is on.

    It is a factor of a batch's colours, and so of their derivatives. An error of the whole picture would be lost with
    it where only derivatives are in use, or reverse mode would trace the picture once more for it.
    """
    one = jnp.ones((), found.color.dtype)
    if not settings.throw or settings.rays_per_pixel is None:
        return one
    # What is missing is not known, for trees that are not complete may grow: the share of those that are is a hint.
    factors = 2.0 ** np.arange(1, 4)
    said = [
        f"rays of a picture found no room, {settings.rays_per_pixel:g} for each of its pixels: state RenderSettings("
        f"rays_per_pixel={np.ceil(factor * settings.rays_per_pixel):g}) or more, or count such pixels by throw=False "
        "and film.overflow."
        for factor in factors
    ]
    wanted, done = jnp.asarray(count, jnp.float32), jnp.sum(found.complete, dtype=jnp.float32)
    index = jnp.searchsorted(np.float32(factors[:-1]), np.float32(1.2) * wanted / jnp.maximum(done, 1))
    return eqx.branched_error_if(one, done < wanted, index, said)


def batch_sizes(rays_per_pixel: float, settings: ResolvedSettings) -> tuple[int, int]:
    """The rays of a batch's queue, and how many pixels of so many rays each share it."""
    queue = QUEUE[settings.edges or "aware"] if jax.default_backend() == "cpu" else 1 << 18
    queue = max(queue, 4096 * math.ceil(rays_per_pixel / 4096))
    return queue, max(1, min(queue // RAYS_A_PLACE, int(queue / rays_per_pixel)))


def spread(points: int, most: int) -> int:
    """The number n of batches of at most so many points; batch k has the points k, k + n, k + 2 n, ...

    They are spread over the picture, so that all batches want about as many rays. Their columns are multiples of n
    modulo the width. Where n is large it shares no factor with the number of points, and they go through all columns
    evenly (a discrete Kronecker sequence; Weyl 1916).
    """
    batches = -(-points // most)
    while batches > 8 and math.gcd(batches, points) > 1:
        batches += 1
    return batches


def in_batches(
    pictures: int, points: Points, step: Step, settings: ResolvedSettings, program: Program
) -> tuple[list[np.ndarray], int]:
    """As `trace_points`, outside of JAX's transformations: until no point lacks room."""
    total, devices = points.shape[1], jax.device_count()
    rays = FIRST_SHARE[settings.edges or "aware"] * ray_budget(settings, step)
    left, found = [np.arange(total)] * pictures, list[np.ndarray]()
    while any(map(len, left)):
        queue, most = batch_sizes(rays, settings)
        if pictures == 1 and len(left[0]) * rays > queue / 8:  # Enough for all devices.
            most = min(most, -(-len(left[0]) // devices))
        batches = [
            (picture, numbers[k::n])
            for picture, numbers in enumerate(left)
            if (n := spread(len(numbers), most))
            for k in range(n)
        ]
        again, slots = [[np.zeros(0, int)] for _ in left], BATCHES * devices
        for some in (batches[first : first + slots] for first in range(0, len(batches), slots)):
            arrays, complete = jax.tree.map(np.asarray, program(fill_slots(some, points, step, queue)))
            if not found:
                found = [np.zeros((pictures, *x.shape[2:-1], total), x.dtype) for x in arrays]
            # Batches go to the devices in turn.
            for place, (picture, numbers) in enumerate(some):
                slot = place % devices, place // devices
                done = complete[slot][: len(numbers)]
                for all_, x in zip(found, arrays, strict=True):
                    all_[picture][..., numbers[done]] = x[slot][..., : len(numbers)][..., done]
                if not done.all():
                    again[picture].append(numbers[~done])
                    # At most a quarter as many; of one pixel the queue is larger then.
                    more = min(1.1 * len(numbers) / max(np.sum(done), 1), 4)
                    rays = max(rays, more * queue / len(numbers))
        left = [np.sort(np.concatenate(numbers)) for numbers in again]
    return found, 0


def fill_slots(batches: list[tuple[int, np.ndarray]], points: Points, step: Step, queue: int) -> Batches:
    """Batches in the slots of all devices: of which picture they are, and which of the points they have."""
    devices = jax.device_count()
    picture, counts = np.full((2, devices, BATCHES), [[[batches[0][0]]], [[0]]])
    places = np.zeros((devices, BATCHES, 2, queue // RAYS_A_PLACE), points.dtype)
    for place, (own, numbers) in enumerate(batches):
        slot = place % devices, place // devices
        picture[slot], counts[slot], places[slot][:, : len(numbers)] = own, len(numbers), points[:, numbers]
    return Batches(picture, places, counts.astype(np.int32), step.astype(points.dtype))


def in_one_call(
    pictures: int, points: Points, step: Step, settings: ResolvedSettings, program: Program
) -> tuple[list[Array], Count]:
    """As `trace_points`, within a transformation of JAX, of one picture: all batches at once, on one device.

    On several CPUs derivatives would be summed, and the program may wait for itself for ever (XLA of JAX 0.10: the
    all-reduces of two devices that begin in another order).
    """
    total = points.shape[1]
    queue, most = batch_sizes(ray_budget(settings, step, total), settings)
    if total < most:  # A small picture needs no large queue.
        queue, most = max(256, 1 << math.ceil(math.log2(queue / most * total))), total
    n = spread(total, most)
    size = -(-total // n)
    numbers = jnp.arange(size, dtype=jnp.int32) * n + jnp.arange(n, dtype=jnp.int32)[:, None]
    own = jnp.moveaxis(points[:, jnp.minimum(numbers, total - 1)], 0, 1)
    places = jnp.pad(own, ((0, 0), (0, 0), (0, queue // RAYS_A_PLACE - size)))[None]
    counts = np.array([[len(range(k, total, n)) for k in range(n)]], np.int32)
    arrays, complete = program(Batches(np.zeros((1, n), int), places, counts, step.astype(points.dtype)))

    def in_order(x: Array) -> Array:
        """Batches "1 batches ... places" as "1 ... points"."""
        return jnp.moveaxis(x[..., :size], 1, -1).reshape(*x.shape[:1], *x.shape[2:-1], -1)[..., :total]

    return [in_order(x) for x in arrays], total - jnp.sum(complete, dtype=jnp.int32)


def map_batches(function: Callable[..., T], common: Any, each: Any, batches: Batches, reversible: bool) -> T:
    """`function(common, one, points, pixels, step)` of each batch, stacked; slots that are empty stay zero.

    Args:
        function: of what it is given and of nothing else that is traced: a value from an earlier program lies on the
            same devices, and JAX refuses such a one where it is closed over. In reverse mode it is computed anew.
        reversible: whether reverse mode can go through it.
    """

    def own_share(common, each, points, counts, step):
        each, points, counts = jax.tree.map(lambda x: x[0], (each, points, counts))

        def one(number):
            own = jax.tree.map(lambda x: x[number], each)
            return jax.checkpoint(function)(common, own, points[number], counts[number], step)

        def put(state):
            number, found = state
            return number + 1, jax.tree.map(lambda all_, new: all_.at[number].set(new), found, one(number))

        start = jnp.zeros((), jnp.int32)
        nothing = jax.tree.map(lambda x: jnp.zeros((len(points), *x.shape), x.dtype), jax.eval_shape(one, start))
        used = jnp.sum(counts > 0, dtype=jnp.int32)
        _, found = repeat(put, (start, nothing), lambda state: state[0] < used, len(points), reversible)
        return jax.tree.map(lambda x: x[None], found)

    given, devices = (common, each, batches.points, batches.counts, batches.step), len(batches.counts)
    if devices == 1:
        return own_share(*given)
    mesh = jax.make_mesh((devices,), ("batches",), axis_types=(jax.sharding.AxisType.Auto,))
    whole, share = PartitionSpec(), PartitionSpec("batches")
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    sharded = jax.shard_map(
        own_share, mesh=mesh, in_specs=(whole, share, share, share, whole), out_specs=share, check_vma=False
    )
    return sharded(*given)
