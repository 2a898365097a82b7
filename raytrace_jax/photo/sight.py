"""What the pixels of a photograph see of its board, directly and through the ball, for programs outside of JAX."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from ..util.compilation import jit
from .geometry import Camera, Seen, Setup, Tank
from .lens import PictureSize
from .photograph import Place, Places

REACH = 0.94
"""What is seen through the glass counts within this fraction of the outline's radius: the rim is squashed and shows the
room."""

AT_ONCE = 1 << 12
"""The size of compiled programs in rays, which all photographs share. With more, few rays take as long as many."""


class Projection:
    """What pixels see.

    Args:
        setup: camera and ball.
        size: width and height of the photograph.
    """

    def __init__(self, setup: Setup, size: PictureSize):
        self.setup, self.size = setup, size

    def directly(self, pixels: Places) -> Seen:
        """The place on the board's plane that each pixel sees if nothing is in the way, and whether it sees one."""
        return self._by("see", self.setup.beside, pixels)

    def through(self, pixels: Places) -> Seen:
        return self._by("see", self.setup, pixels)

    def where(self, places: Places) -> Places:
        """The pixels in which places of the board are seen directly."""
        pixels = self._project(places)
        for _ in range(6 if self.setup.liquid else 0):  # Nearly where they would be in air: each round is nearer.
            pixels = pixels + self._project(places) - self._project(self.directly(pixels).place)
        return pixels

    def index_slope(self, pixels: Places) -> Places:
        """How far places that pixels see through the glass move in the picture per unit of its index."""
        glass, step = self.setup.glass, 2e-3  # About as much as colours differ.
        ahead, behind = (
            Projection(dataclasses.replace(self.setup, glass=dataclasses.replace(glass, ior=glass.ior + by)), self.size)
            for by in (step, -step)
        )
        moved = (ahead.through(pixels).place - behind.through(pixels).place) / (2 * step)
        return -np.linalg.solve(self._by("local_map", self.setup, pixels), moved[..., None])[..., 0]

    def _project(self, places: Float[np.ndarray, "n k"]) -> Places:
        """The pixels of points, or of places of the board; about, if they lie in a liquid: they seem to be nearer."""
        points = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
        if (liquid := self.setup.liquid) is not None:
            points[:, 2] = liquid.depth + (points[:, 2] - liquid.depth) / liquid.ior
        return self._by("project", self.setup.camera, points)

    def where_through(
        self, places: Places, half: Float[np.ndarray, "2"], reach: float = REACH
    ) -> tuple[Places, Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
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
            slopes = self._by("local_map", self.setup, pixels)
            step = np.linalg.solve(slopes + 1e-12 * np.eye(2), (places - place)[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            pixels = pixels + step * np.minimum(1, 0.1 * radius / np.maximum(length, 1e-12))
        place, counts = see(pixels)
        largest = np.linalg.svd(self._by("local_map", self.setup, pixels), compute_uv=False)[:, 0]
        stretch = 1 / np.maximum(largest, 1e-12)
        return pixels, stretch, counts & (np.linalg.norm(place - places, axis=1) * stretch < 0.01)

    @property
    def viewpoint(self) -> Float[np.ndarray, "3"]:
        return self._pinhole[:3]

    def focal_at(self, center: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, " *any"]:
        """About how many pixels the radius of an outline has for a tangent of 1; off the middle it is drawn out."""
        principal_point, focal = self._pinhole[3:5], self._pinhole[5]
        return np.asarray(focal + np.sum((center - principal_point) ** 2, axis=-1) / focal)

    @property
    def outline(self) -> tuple[Place, float]:
        """Where the ball's centre is seen, and about how large its outline's radius is, in pixels; a tank fills all."""
        ball = self.setup.glass
        if isinstance(ball, Tank):
            return (np.array(self.size) - 1) / 2, max(self.size) / 2
        center = self._project(ball.center[None])[0]
        squared = float(np.sum((self.viewpoint - ball.center) ** 2))
        radius = float(ball.radius)
        return center, radius / np.sqrt(max(squared - radius**2, 1e-9)) * float(self.focal_at(center))

    def center_of(self, center: Place, radius: float) -> Float[np.ndarray, "3"]:
        """The centre of a ball of the set-up's radius that has this outline."""
        tangent = radius / float(self.focal_at(center))
        off = np.append(self.directly(center[None]).place[0], 0.0) - self.viewpoint
        distance = self.setup.glass.radius * np.sqrt(1 + 1 / tangent**2)
        return self.viewpoint + distance * off / np.linalg.norm(off)

    @functools.cached_property
    def _pinhole(self) -> Float[np.ndarray, "6"]:
        """The viewpoint, the principal point and the focal length; in a liquid those from which rays in it come."""
        pinhole = np.array(_pinhole(self.setup.camera, np.asarray(self.size, float)))
        if (liquid := self.setup.liquid) is not None:
            pinhole[2] = liquid.depth + (pinhole[2] - liquid.depth) * liquid.ior
            pinhole[5] *= liquid.ior
        return pinhole

    def _by(self, method: str, of: Camera | Setup, values: np.ndarray) -> Any:
        """The results of a method of camera or set-up for many rows, some at a time, as arrays of NumPy."""
        count, size, results = len(values), np.asarray(self.size, float), []
        for first in range(0, max(count, 1), AT_ONCE):
            part = values[first : first + AT_ONCE]
            rows = np.pad(np.asarray(part, float), ((0, AT_ONCE - len(part)), (0, 0)))
            results.append(_run(of, size, rows, method=method))
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *results)


@jit(static_argnames="method")
def _run(of: Camera | Setup, size: Float[Array, "2"], rows: Float[Array, "n k"], method: str):
    return getattr(of, method)(size, rows)


@jit
def _pinhole(camera: Camera, size: Float[Array, "2"]):
    return jnp.hstack([camera.of_scene.viewpoint, camera.principal_point(size), camera.focal_length(size)])
