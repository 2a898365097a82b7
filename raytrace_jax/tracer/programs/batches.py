"""Points in batches: one program for any number of them, which are spread over all devices."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.programs.plan import Plan
from raytrace_jax.tracer.programs.tiles import share_out

Points = Float[np.ndarray, "2 points"]
"""Where in the picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCHES = 32
"""So many batches at most are one call, for each device: a call takes as long as some batches do."""

ROOM = 1.5
"""Room for more rays than were counted, as a factor: the same points of a moved scene need no other program. Of the
README's fit a search wants 1.25 times what its start does; with 1.3 to 1.6 it takes 2.6 s, with 2.5 4.1 s, and
compiling anew 3."""


class Slots(NamedTuple):
    """How batches are laid into the slots of all devices.

    Args:
        source: the batch in each slot; the first one in those that stay empty.
        slot: of each batch.
        counts: how many batches each device has, in its first slots.
    """

    source: Int[np.ndarray, " slots"]
    slot: Int[np.ndarray, " batches"]
    counts: Int[np.ndarray, " devices"]


def make_slots(batches: int) -> Slots:
    """So many batches shared out evenly over the devices, of `BATCHES` slots each."""
    devices = jax.device_count()
    number = np.arange(batches)
    slot = number % devices * BATCHES + number // devices
    source = np.zeros(BATCHES * devices, int)
    source[slot] = number
    counts = (batches + devices - 1 - np.arange(devices)) // devices
    return Slots(source, slot, counts.astype(np.int32))


def spread_out(count: int, size: int) -> Int[np.ndarray, "batches size"]:
    """The points in each batch, so that each is spread over all of them; the last places of some have others again."""
    batches = -(-count // size)
    return np.arange(batches * size).reshape(size, batches).T % max(count, 1)


def in_front(plan: Plan, batch: Float[Array, "2 points"]) -> tuple[Float[Array, "2 slots"], Bool[Array, " slots"]]:
    """A batch in the first slots of a plan's first level, and which slots these are.

    A level has as many slots as the fullest one.
    """
    slots, size = plan.stages[0].capacity, batch.shape[1]
    return jnp.pad(batch, ((0, 0), (0, slots - size))), jnp.arange(slots, dtype=jnp.int32) < size


def steps_of_devices(step: Float[np.ndarray, "2"] | None, dtype) -> Float[np.ndarray, "devices 2"]:
    """For each device how far it is from one pixel to the next; without a step, of points, zero."""
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
