"""A level of rays in chunks, of which those without a live ray cost nothing.

Levels of one run have as many slots each as the fullest one, with their live rays at the front. Of edge-aware pictures
in one run half of the slots are empty, and of deep trees most: it pays to skip them.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.levels.compaction import BLOCK

T = TypeVar("T")

CHUNK, OTHER_CHUNK = 256, 1024
"""Rays in a chunk at most: on a CPU as few as stay in its cache. Of POV-Ray's checker, 320 x 240, with the pixels that
see an edge listed, a picture takes 0.82 s with 256, 1.15 with 512 and 1.0 with 1024, its derivative by four numbers
6.2, 8.7 and 8.7 s; 128 are slower on the course's scene."""


def chunk_size() -> int:
    """Rays in a chunk at most, on the device that is used."""
    return CHUNK if jax.default_backend() == "cpu" else OTHER_CHUNK


def in_chunks(function: Callable[[Rays, Bool[Array, " rays"]], T], rays: Rays, live: Bool[Array, " slots"]) -> T:
    """`function(rays, live)`, a chunk at a time; zeros for chunks without live rays.

    In reverse mode a chunk is computed anew from its rays: its values are many, and reading them back takes longer.

    Args:
        function: from rays to a pytree of arrays, each with the rays, or 1, as its last axis.
        rays: as many as there are slots.
        live: which of them count.
    """
    slots = live.shape[0]
    count = -(-slots // chunk_size())
    size = BLOCK * -(-slots // (count * BLOCK))

    def split(x: Array) -> Array:
        padded = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, count * size - slots)])
        return jnp.moveaxis(padded.reshape(*x.shape[:-1], count, size), -2, 0)

    def join(x: Array) -> Array:
        moved = jnp.moveaxis(x, 0, -2)
        return moved.reshape(*moved.shape[:-2], count * size)[..., :slots]

    def whole(chunk: tuple[Rays, Bool[Array, " rays"]]) -> T:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], size)), function(*chunk))

    def nothing(chunk: tuple[Rays, Bool[Array, " rays"]]) -> T:
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(whole, chunk))

    def step(_, chunk: tuple[Rays, Bool[Array, " rays"]]):
        return None, jax.lax.cond(jnp.any(chunk[1]), whole, nothing, chunk)

    _, found = jax.lax.scan(jax.checkpoint(step, prevent_cse=False), None, jax.tree.map(split, (rays, live)))
    return jax.tree.map(join, found)
