"""What the pixels of a photograph see of its board, directly and through the ball, for programs outside of JAX."""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from raytrace_jax.photo.geometry import (
    Seen,
    Setup,
    camera_of,
    focal_length,
    local_map,
    on_board,
    pixel_rays,
    principal_point,
    project,
    see_through,
)
from raytrace_jax.util.compilation import jit

REACH = 0.94
"""What is seen through the glass counts within this fraction of the outline's radius: the rim is squashed and shows the
room."""

AT_ONCE = (1 << 12, 1 << 15)
"""Sizes of compiled programs in rays, for few pixels and for many: all photographs share these two."""

PixelPlaces = Float[np.ndarray, "n 2"]


class Sight:
    """What pixels see.

    Args:
        setup: camera and ball.
        size: width and height of the photograph.
    """

    def __init__(self, setup: Setup, size: tuple[int, int]):
        self.setup, self.size, self._vector = setup, size, np.asarray(setup.vector, float)

    def directly(self, pixels: PixelPlaces) -> tuple[PixelPlaces, Bool[np.ndarray, " n"]]:
        """The place on the board's plane that each pixel sees if nothing is in the way, and whether it sees one."""
        place, sees = self._in_parts(_directly, pixels)
        return place, sees

    def through(self, pixels: PixelPlaces) -> Seen:
        """What each pixel sees through the ball."""
        return Seen(*self._in_parts(_through, pixels))

    def where(self, places: Float[np.ndarray, "n 2"]) -> PixelPlaces:
        """The pixels in which places of the board are seen directly."""
        flat = np.concatenate([places, np.zeros_like(places[:, :1])], axis=1)
        return self._in_parts(_where, flat)[0]

    def where_through(
        self, places: Float[np.ndarray, "n 2"], half: Float[np.ndarray, "2"], reach: float = REACH
    ) -> tuple[PixelPlaces, Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """The pixels in which places of the board are seen through the ball, by Newton's method from a grid of rays.

        Nothing counts as seen beyond half the board's width and height, and beyond `reach` outline radii.

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
            (slopes,) = self._in_parts(_slopes, pixels)
            step = np.linalg.solve(slopes + 1e-12 * np.eye(2), (places - place)[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            pixels = pixels + step * np.minimum(1, 0.1 * radius / np.maximum(length, 1e-12))
        place, counts = see(pixels)
        stretch = 1 / np.maximum(np.linalg.svd(self._in_parts(_slopes, pixels)[0], compute_uv=False)[:, 0], 1e-12)
        return pixels, stretch, counts & (np.linalg.norm(place - places, axis=1) * stretch < 0.01)

    @property
    def viewpoint(self) -> Float[np.ndarray, "3"]:
        """Where the camera is."""
        return self._pinhole[:3]

    def focal_at(self, center: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, " *any"]:
        """About how many pixels the radius of an outline has for a tangent of 1; off the middle it is drawn out."""
        principal_point, focal = self._pinhole[3:5], self._pinhole[5]
        return np.asarray(focal + np.sum((center - principal_point) ** 2, axis=-1) / focal)

    @property
    def outline(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Where the ball's centre is seen, and about how large its outline's radius is, in pixels."""
        center = self._in_parts(_where, self.setup.center[None])[0][0]
        squared = float(np.sum((self.viewpoint - self.setup.center) ** 2))
        radius = float(self.setup.radius)
        return center, radius / np.sqrt(max(squared - radius**2, 1e-9)) * float(self.focal_at(center))

    def center_of(self, center: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "3"]:
        """The centre of a ball of the set-up's radius that has this outline."""
        tangent = radius / float(self.focal_at(center))
        off = np.append(self.directly(center[None])[0][0], 0.0) - self.viewpoint
        distance = self.setup.radius * np.sqrt(1 + 1 / tangent**2)
        return self.viewpoint + distance * off / np.linalg.norm(off)

    @functools.cached_property
    def _pinhole(self) -> Float[np.ndarray, "6"]:
        """The viewpoint, the principal point and the focal length."""
        return np.asarray(_pinhole(self._vector, np.asarray(self.size, float)))

    def _in_parts(self, program, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Run a compiled program on many rows, some at a time."""
        count, size, found = len(values), np.asarray(self.size, float), []
        at_once = AT_ONCE[count > AT_ONCE[0]]
        for first in range(0, max(count, 1), at_once):
            part = values[first : first + at_once]
            rows = np.pad(np.asarray(part, float), ((0, at_once - len(part)), (0, 0)))
            found.append([np.asarray(one)[: len(part)] for one in program(self._vector, size, rows)])
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@jit
def _directly(vector: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    place, distance = on_board(*pixel_rays(Setup.of(vector), size, pixels))
    return place, distance > 0


@jit
def _through(vector: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    return tuple(see_through(Setup.of(vector), size, pixels))


@jit
def _slopes(vector: Float[Array, " numbers"], size: Float[Array, "2"], pixels: Float[Array, "n 2"]):
    return (local_map(Setup.of(vector), size, pixels),)


@jit
def _where(vector: Float[Array, " numbers"], size: Float[Array, "2"], points: Float[Array, "n 3"]):
    return (project(Setup.of(vector), size, points),)


@jit
def _pinhole(vector: Float[Array, " numbers"], size: Float[Array, "2"]):
    setup = Setup.of(vector)
    return jnp.concatenate([camera_of(setup).viewpoint, principal_point(setup, size), focal_length(setup, size)[None]])
