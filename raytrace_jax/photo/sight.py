"""What the pixels of a photograph see of its board, directly and through the ball, for programs outside of JAX."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from raytrace_jax.photo.bundle import BALL
from raytrace_jax.photo.cameras import COUNT, directions, focal_length, on_board, principal_point, project, viewpoint
from raytrace_jax.photo.through_glass import CENTER, RADIUS, Seen, local_map, see_through
from raytrace_jax.util.compilation import jit

AT_ONCE = (1 << 12, 1 << 15)
"""Sizes of compiled programs in rays, for few pixels and for many: all photographs share these two."""

PixelPlaces = Float[np.ndarray, "n 2"]


class Sight:
    """A camera and a ball, and what pixels see.

    Args:
        numbers: the camera's and the ball's, as `photo.bundle` has them.
        size: width and height of the photograph.
    """

    def __init__(self, numbers: Float[np.ndarray, " numbers"], size: tuple[int, int]):
        self.numbers, self.size = np.asarray(numbers, float), size

    def directly(self, pixels: PixelPlaces) -> tuple[PixelPlaces, Bool[np.ndarray, " n"]]:
        """The place on the board's plane that each pixel sees if nothing is in the way, and whether it sees one."""
        place, sees = self._in_parts(_directly, pixels)
        return place, sees

    def through(self, pixels: PixelPlaces) -> Seen:
        """What each pixel sees through the ball."""
        return Seen(*self._in_parts(_through, pixels))

    def slopes(self, pixels: PixelPlaces) -> Float[np.ndarray, "n 2 2"]:
        """How the place that is seen through the ball moves with the pixel, "place pixel"."""
        return self._in_parts(_slopes, pixels)[0]

    def where(self, places: Float[np.ndarray, "n 2"]) -> PixelPlaces:
        """The pixels in which places of the board are seen directly."""
        flat = np.concatenate([places, np.zeros_like(places[:, :1])], axis=1)
        return self._in_parts(_where, flat)[0]

    def where_through(
        self, places: Float[np.ndarray, "n 2"], reach: float, half: Float[np.ndarray, "2"]
    ) -> tuple[PixelPlaces, Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """The pixels in which places of the board are seen through the ball, by Newton's method from a grid of rays.

        Args:
            places: on the board's plane.
            reach: nothing counts as seen beyond this share of the outline's radius.
            half: half the board's width and height; beyond it nothing counts either.

        Returns:
            The pixels, how large a step of one unit on the board is there at least, in pixels, and which places are
            seen.
        """

        def see(pixels):
            seen = self.through(pixels)
            return seen.place, seen.valid & (seen.reach < reach) & np.all(np.abs(seen.place) < half, axis=1)

        # 160 rays a side over the outline: Newton's method starts from the one that passes nearest to the place.
        center, radius = self.outline
        axis = np.linspace(-1, 1, 160)
        grid = center + radius * np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        place, counts = see(grid)
        pixels = grid[KDTree(np.where(counts[:, None], place, 1e9)).query(places)[1]]
        for _ in range(6):
            place, _ = see(pixels)
            step = np.linalg.solve(self.slopes(pixels) + 1e-12 * np.eye(2), (places - place)[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            pixels = pixels + step * np.minimum(1, 0.1 * radius / np.maximum(length, 1e-12))
        place, counts = see(pixels)
        stretch = 1 / np.maximum(np.linalg.svd(self.slopes(pixels), compute_uv=False)[:, 0], 1e-12)
        return pixels, stretch, counts & (np.linalg.norm(place - places, axis=1) * stretch < 0.01)

    @property
    def viewpoint(self) -> Float[np.ndarray, "3"]:
        """Where the camera is."""
        return np.asarray(viewpoint(jnp.asarray(self.numbers[:COUNT])))

    def toward(self, pixel: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3"]:
        """The unit direction in which a pixel looks."""
        place, _ = self.directly(pixel[None])
        off = np.append(place[0], 0.0) - self.viewpoint
        return off / np.linalg.norm(off)

    @property
    def principal_point(self) -> Float[np.ndarray, "2"]:
        """The principal point, in pixels."""
        return np.asarray(principal_point(jnp.asarray(self.numbers[:COUNT]), self.size))

    @property
    def outline(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Where the ball's middle is seen, and about how large its outline's radius is, in pixels."""
        ball = self.numbers[BALL]
        center = self._in_parts(_where, ball[None, CENTER])[0][0]
        squared = float(np.sum((self.viewpoint - ball[CENTER]) ** 2))
        tangent = ball[RADIUS] / np.sqrt(max(squared - ball[RADIUS] ** 2, 1e-9))
        return center, float(tangent * self.focal_at(center))

    def focal_at(self, center: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, " *any"]:
        """About how many pixels the radius of an outline has for a tangent of 1; off the middle it is drawn out."""
        focal = float(focal_length(jnp.asarray(self.numbers), self.size))
        return np.asarray(focal + np.sum((center - self.principal_point) ** 2, axis=-1) / focal)

    def _in_parts(self, program, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Run a compiled program on many rows, some at a time."""
        count, size, found = len(values), np.asarray(self.size, float), []
        at_once = AT_ONCE[count > AT_ONCE[0]]
        for first in range(0, max(count, 1), at_once):
            part = values[first : first + at_once]
            rows = np.pad(np.asarray(part, float), ((0, at_once - len(part)), (0, 0)))
            found.append([np.asarray(one)[: len(part)] for one in program(self.numbers, size, rows)])
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@jit
def _directly(numbers: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    camera = numbers[:COUNT]
    toward = directions(camera, size, pixels)
    place, distance = on_board(jnp.broadcast_to(viewpoint(camera), toward.shape), toward)
    return place, distance > 0


@jit
def _through(numbers: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    return tuple(see_through(numbers[:COUNT], numbers[BALL], size, pixels))


@jit
def _slopes(numbers: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    return (local_map(numbers[:COUNT], numbers[BALL], size, pixels),)


@jit
def _where(numbers: Float[Array, " numbers"], size: Float[Array, "2"], points: Float[Array, "n 3"]):
    return (project(numbers[:COUNT], size, points),)
