"""Where pixels see the board through a ball of glass: two refractions, with their derivatives."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.optics.vectors import refract
from raytrace_jax.photo.cameras import Numbers, Size, directions, on_board, viewpoint
from raytrace_jax.util.numerics import TINY

INDEX, CENTER, RADIUS = 0, slice(1, 4), 4
"""Places of a ball's numbers: its index over that of the air, its centre in the board's frame, its radius."""

LOST = 5.0
"""A corner whose ray is lost misses by so many pixels, more than corners that count."""


class Seen(NamedTuple):
    """What rays through a ball meet, in arrays of JAX or, from `photo.sight`, of NumPy.

    Args:
        place: on the board's plane.
        reach: how far from the ball's middle the ray passes, as a share of its radius; above 1 it misses.
        valid: whether the ray enters the ball, leaves it and meets the plane.
    """

    place: Float[Any, "*any 2"]
    reach: Float[Any, " *any"]
    valid: Bool[Any, " *any"]


def see_through(camera: Numbers, ball: Numbers, size: Size, pixels: Float[Array, "*any 2"]) -> Seen:
    """Follow the rays of pixels into the ball, out of it and to the board's plane.

    Args:
        camera: as `photo.cameras` has it.
        ball: its index, centre and radius.
        size: of the picture.
        pixels: fractional ones.

    Returns:
        What each ray meets.
    """
    shape = pixels.shape[:-1]
    o, d = viewpoint(camera)[:, None], directions(camera, size, pixels.reshape(-1, 2)).T
    center, radius = ball[CENTER][:, None], ball[RADIUS]
    # The nearer root; where there is none, that of a ray which touches.
    along = jnp.sum((center - o) * d, axis=0)
    off = jnp.sum((center - o) ** 2, axis=0) - along * along
    hits = (off < radius * radius * (1 - 1e-12)) & (along > 0)
    half = jnp.sqrt(jnp.where(hits, radius * radius - off, radius * radius))
    entry = o + (along - half) * d
    n = (entry - center) / radius
    inner, _, _ = refract(d, n, jnp.broadcast_to(ball[INDEX], along.shape))
    chord = -2 * jnp.sum((entry - center) * inner, axis=0)
    leave = entry + chord * inner
    outer, _, total = refract(inner, (leave - center) / radius, jnp.broadcast_to(1 / ball[INDEX], along.shape))
    place, distance = on_board(leave.T, outer.T)
    reach = jnp.sqrt(jnp.maximum(off, TINY)) / radius
    return Seen(place.reshape(*shape, 2), reach.reshape(shape), (hits & ~total & (distance > 0)).reshape(shape))


def local_map(camera: Numbers, ball: Numbers, size: Size, pixels: Float[Array, "n 2"]) -> Float[Array, "n 2 2"]:
    """How the place on the board moves with the pixel, "place pixel"."""

    def place(pixel):
        return see_through(camera, ball, size, pixel[None]).place[0]

    return jax.vmap(jax.jacfwd(place))(pixels)


def misses(
    camera: Numbers, ball: Numbers, size: Size, pixels: Float[Array, "n 2"], places: Float[Array, "n 2"]
) -> Float[Array, "n 2"]:
    """How far pixels are from where places of the board are seen through the ball, in pixels.

    That is the miss on the board, carried back by the local map, which counts as constant. A pixel whose ray does not
    come through misses by `LOST`, so that no adjustment gains by losing corners.
    """
    found = see_through(camera, ball, size, pixels)
    inverse = jax.lax.stop_gradient(_inverse(local_map(camera, ball, size, pixels)))
    miss = jnp.einsum("nij,nj->ni", inverse, found.place - places)
    return jnp.where(found.valid[:, None], miss, LOST)


def _inverse(matrix: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """The inverse of each matrix; 0 where it has none."""
    (a, b), (c, d) = (matrix[:, 0, 0], matrix[:, 0, 1]), (matrix[:, 1, 0], matrix[:, 1, 1])
    determinant = a * d - b * c
    is_there = jnp.abs(determinant) > TINY
    adjoint = jnp.stack([jnp.stack([d, -b], -1), jnp.stack([-c, a], -1)], -2)
    return jnp.where(is_there[:, None, None], adjoint / jnp.where(is_there, determinant, 1.0)[:, None, None], 0.0)
