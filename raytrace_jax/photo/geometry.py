"""A camera and a ball, or a tank, before a board: where pixels see the board, directly and through it.

The frame is the board's: x to the right, y up, z towards who looks at it, in the board's unit of length. Pixels are
OpenCV's: (0, 0) is the middle of the upper left one. Rays are the tracer's, `tracer.geometry.camera`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..optics.vectors import refract
from ..scene.scene import PerspectiveCamera
from ..tracer.geometry.camera import ray
from ..tracer.geometry.sphere import chord
from ..util.numerics import TINY, dot, normalize

LOST = 5.0
"""A corner whose ray is lost misses by so many pixels, more than corners that count."""

Size = tuple[int, int] | Float[Array, "2"]
"""Width and height of a picture, in pixels."""


class Setup(NamedTuple):
    """A camera before a board, and a ball or a tank between them.

    Or an error, a scale, a place in the raveled vector for each number of these. A ball has no thickness, a tank no
    radius.

    Args:
        rotation, translation: rotation vector and translation of the camera as OpenCV has them, into a frame of x to
            the right, y down, z forward.
        fov: its full horizontal angle of view in degrees.
        distortion: k1 and k2 of `scene.lens`.
        principal_offset: how far the principal point is to the right of and below the picture's middle, in widths of
            the picture.
        ior: the index, over that of the air, of the ball or of the liquid in the tank.
        center, radius: the ball's. The centre of a tank is where its thickness is measured, on the outside of its back.
        tilt: the outer normal of the tank's faces is along (tilt, 1).
        thickness: of the tank, along its normal, from the outside of one wall to that of the other.
        wall, wall_ior: thickness and index of each of its walls.
        wedge: how far the outer normal of the tank's back differs from (tilt, 1); 0 where its walls are parallel.
        liquid, depth: index of what ball and board lie in, over that of the air, and how high above the board its
            surface is, which is parallel to it; a depth of 0 is none.
    """

    rotation: Float[Any, "3"]
    translation: Float[Any, "3"]
    fov: Float[Any, ""]
    distortion: Float[Any, "2"]
    principal_offset: Float[Any, "2"]
    ior: Float[Any, ""]
    center: Float[Any, "3"]
    radius: Float[Any, ""]
    tilt: Float[Any, "2"] = np.zeros(2)
    thickness: Float[Any, ""] = 0.0
    wall: Float[Any, ""] = 0.0
    wall_ior: Float[Any, ""] = 0.0
    liquid: Float[Any, ""] = 1.0
    depth: Float[Any, ""] = 0.0
    wedge: Float[Any, "2"] = np.zeros(2)

    @classmethod
    def of(cls, vector: Float[Any, " numbers"]) -> "Setup":
        """The set-up that was raveled into a vector, of JAX or of NumPy."""
        v = vector
        return cls(v[:3], v[3:6], v[6], v[7:9], v[9:11], v[11], v[12:15], v[15], v[16:18], *v[18:23], wedge=v[23:])

    @property
    def vector(self) -> Float[np.ndarray, " numbers"]:
        """All numbers in a row, raveled."""
        return np.hstack(self)

    @property
    def lens(self) -> Float[np.ndarray, "5"]:
        """What does not depend on where the camera stands: angle of view, distortion and principal point."""
        return np.hstack([self.fov, self.distortion, self.principal_offset])

    @property
    def own(self) -> Float[np.ndarray, "11"]:
        """What each photograph has of its own: the camera's pose, the ball's centre or the tank's tilt."""
        return np.hstack([self.rotation, self.translation, self.center, self.tilt])

    @property
    def ball(self) -> Float[np.ndarray, "5"]:
        """The ball's numbers: index, centre and radius."""
        return np.hstack([self.ior, self.center, self.radius])

    @property
    def tank(self) -> Float[np.ndarray, "8"]:
        """The tank's numbers: index, tilt, thickness, walls and wedge."""
        return np.hstack([self.ior, self.tilt, self.thickness, self.walls, self.wedge])

    @property
    def walls(self) -> Float[np.ndarray, "2"]:
        """Thickness and index of each of the tank's walls."""
        return np.hstack([self.wall, self.wall_ior])


AT = Setup.of(np.arange(25))
"""Where each number lies in the raveled vector."""

COUNT = len(AT.vector)
"""How many numbers a set-up has."""


class Seen(NamedTuple):
    """What rays meet, through a ball or a tank or directly, in arrays of JAX or, from `photo.sight`, of NumPy.

    Args:
        place: on the board's plane.
        reach: how far from the ball's centre the ray passes, as a fraction of its radius; above 1 it misses. 0 without
            a ball.
        valid: whether the ray enters, leaves and meets the plane.
    """

    place: Float[Any, "n 2"]
    reach: Float[Any, " n"]
    valid: Bool[Any, " n"]


def rotation_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The rotation by the length of a vector about it (Rodrigues); its derivative at 0 is finite."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    squared = vector @ vector
    is_small = squared < 1e-12
    angle = jnp.sqrt(jnp.where(is_small, 1.0, squared))
    sine = jnp.where(is_small, 1 - squared / 6, jnp.sin(angle) / angle)
    cosine = jnp.where(is_small, 0.5 - squared / 24, (1 - jnp.cos(angle)) / (angle * angle))
    return jnp.eye(3, dtype=vector.dtype) + sine * cross + cosine * (cross @ cross)


def focal_length(setup: Setup, size: Size) -> Float[Array, ""]:
    """The focal length in pixels of a picture of this width and height."""
    return size[0] / (2 * jnp.tan(jnp.deg2rad(setup.fov) / 2))


def principal_point(setup: Setup, size: Size) -> Float[Array, "2"]:
    """The principal point, in pixels."""
    return (jnp.asarray(size, float) - 1) / 2 + setup.principal_offset * size[0]


def project(setup: Setup, size: Size, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """The pixels in which points are seen, which lie in front of the camera; the inverse of `pixel_rays`."""
    seen = points @ rotation_matrix(setup.rotation).T + setup.translation
    x = seen[:, :2] / jnp.maximum(seen[:, 2:], TINY)
    squared = jnp.sum(x * x, axis=-1, keepdims=True)
    k1, k2 = setup.distortion
    return focal_length(setup, size) * (1 + k1 * squared + k2 * squared * squared) * x + principal_point(setup, size)


def camera_of(setup: Setup) -> PerspectiveCamera:
    """The tracer's camera, with a picture of one pixel that is as wide as the photograph, and as high as wide.

    It looks at a point as far away as the board's middle is now; to a derivative that distance is a constant.
    """
    axes = rotation_matrix(setup.rotation)
    viewpoint = -axes.T @ setup.translation
    distance = jax.lax.stop_gradient(jnp.sqrt(jnp.maximum(jnp.sum(setup.translation**2), TINY)))
    return PerspectiveCamera(
        name="photograph",
        pixeldim=(1, 1),
        viewpoint=viewpoint,
        lookat=viewpoint + distance * axes[2],
        up=-axes[1],
        fov=setup.fov,
        center=setup.principal_offset,
        distortion=setup.distortion,
    )


def pixel_rays(
    setup: Setup, size: Size, pixels: Float[Array, "n 2"]
) -> tuple[Float[Array, "3 n"], Float[Array, "3 n"]]:
    """Origins and unit directions of the rays of pixels."""
    right, down = ((pixels - (jnp.asarray(size, float) - 1) / 2) / size[0]).T
    origin, direction = ray(camera_of(setup), 0.5 + right, 0.5 - down)
    return origin, normalize(direction)


def see_directly(setup: Setup, size: Size, pixels: Float[Array, "n 2"]) -> Seen:
    """Where pixels see the board's plane if nothing but liquid is in the way."""
    return follow_directly(setup, *pixel_rays(setup, size, pixels))


def follow_directly(setup: Setup, o: Float[Array, "3 n"], d: Float[Array, "3 n"]) -> Seen:
    """Follow rays to the board's plane."""
    place, distance = on_board(*_into_liquid(setup, o, d))
    return Seen(place, jnp.zeros_like(distance), distance > 0)


def _into_liquid(
    setup: Setup, o: Float[Array, "3 n"], d: Float[Array, "3 n"]
) -> tuple[Float[Array, "3 n"], Float[Array, "3 n"]]:
    """The rays from the liquid's surface on, or as they were if there is none."""
    normal, is_there = jnp.zeros_like(d).at[2].set(1.0), setup.depth > 0
    ratio = jnp.broadcast_to(jnp.where(is_there, setup.liquid, 1.0), d.shape[1:])
    entry = o + (setup.depth - o[2]) / jnp.where(d[2] < -1e-12, d[2], -1.0) * d
    return jnp.where(is_there, entry, o), jnp.where(is_there, refract(d, normal, ratio)[0], d)


def on_board(
    origin: Float[Array, "3 n"], direction: Float[Array, "3 n"]
) -> tuple[Float[Array, "n 2"], Float[Array, " n"]]:
    """Where rays meet the board's plane, and how far along them: -1 where they never do."""
    falls = direction[2] < -1e-12
    distance = jnp.where(falls, origin[2] / jnp.where(falls, -direction[2], 1.0), -1.0)
    return (origin + distance * direction)[:2].T, distance


def see_through(setup: Setup, size: Size, pixels: Float[Array, "n 2"]) -> Seen:
    """Follow the rays of pixels through the ball or the tank to the board's plane."""
    return follow_through(setup, *pixel_rays(setup, size, pixels))


def follow_through(setup: Setup, o: Float[Array, "3 n"], d: Float[Array, "3 n"]) -> Seen:
    """Follow rays through the ball or the tank to the board's plane."""
    return jax.lax.cond(setup.thickness > 0, _through_tank, _through_ball, setup, o, d)


def _through_tank(setup: Setup, o: Float[Array, "3 n"], d: Float[Array, "3 n"]) -> Seen:
    """Refract the rays at both faces of the front wall and of the back wall, by Snell's law.

    Both faces of a wall are parallel. Where the walls are, too, each layer only shifts the rays aside, and where the
    tank stands does not matter. Behind a wedge the rays are turned by about (n - 1) times its angle, so that its place
    matters a little.
    """
    front, back = (
        normalize(jnp.append(by, jnp.ones_like(setup.ior)))[:, None] for by in (setup.tilt, setup.tilt + setup.wedge)
    )
    wall_ior = jnp.where(setup.wall > 0, setup.wall_ior, setup.ior)
    faces = (
        jnp.stack([setup.thickness, setup.thickness - setup.wall, setup.wall, jnp.zeros_like(setup.wall)]),
        jnp.stack([front, front, back, back]),
        jnp.stack([wall_ior, setup.ior / wall_ior, wall_ior / setup.ior, 1 / wall_ior]),
    )

    def meet(ray, face):
        (o, d, valid), (height, normal, ratio) = ray, face
        falls = -dot(d, normal)
        o = o + dot(o - setup.center[:, None] - height * normal, normal) / jnp.maximum(falls, 1e-9) * d
        d, _, total = refract(d, jnp.broadcast_to(normal, d.shape), jnp.broadcast_to(ratio, falls.shape))
        return (o, d, valid & (falls > 1e-9) & ~total), None

    # A loop: four copies of it take four times as long to compile.
    (o, d, valid), _ = jax.lax.scan(meet, (o, d, jnp.ones(d.shape[1:], bool)), faces)
    # A tank that is taken to stand at the board, and is tilted, reaches behind it: its rays are followed back.
    place, distance = on_board(o, d)
    return Seen(place, jnp.zeros_like(distance), valid & (d[2] < -1e-12))


def _through_ball(setup: Setup, o: Float[Array, "3 n"], d: Float[Array, "3 n"]) -> Seen:
    """Follow the rays into the liquid, if there is any, into the ball and out of it."""
    o, d = _into_liquid(setup, o, d)
    center, radius = setup.center[:, None], setup.radius
    ior = jnp.broadcast_to(setup.ior / jnp.where(setup.depth > 0, setup.liquid, 1.0), o.shape[1:])
    passing = chord(o, d, center, radius)
    hits = (passing.discriminant > 1e-12 * radius * radius) & (passing.along > 0)
    # A ray that misses is followed from where it passes nearest, so that all is finite.
    entry = o + (passing.along - passing.half) * d
    inner, _, _ = refract(d, (entry - center) / radius, ior)
    leave = entry + 2 * chord(entry, inner, center, radius).along * inner
    outer, _, total = refract(inner, (leave - center) / radius, 1 / ior)
    place, distance = on_board(leave, outer)
    reach = jnp.sqrt(jnp.maximum(dot(passing.across, passing.across), TINY)) / radius
    return Seen(place, reach, hits & ~total & (distance > 0))


def local_map(
    setup: Setup, size: Size, pixels: Float[Array, "n 2"], see: Callable[..., Seen] = see_through
) -> Float[Array, "n 2 2"]:
    """The derivative of the place that is seen through ball or tank, or directly, by the pixel, "place pixel"."""
    # A step of all pixels moves each one's place alone: one trace for all.
    return jax.jacfwd(lambda step: see(setup, size, pixels + step).place)(jnp.zeros(2, pixels.dtype))


def misses(
    setup: Setup,
    size: Size,
    pixels: Float[Array, "n 2"],
    places: Float[Array, "n 2"],
    see: Callable[..., Seen] = see_through,
) -> Float[Array, "n 2"]:
    """How far pixels are from where places of the board are seen through ball or tank, or directly, in pixels.

    That is the miss on the board, carried back by the local map, which counts as constant. A pixel whose ray does not
    come through misses by `LOST`, so that no adjustment gains by losing corners.
    """
    found = see(setup, size, pixels)
    inverse = jax.lax.stop_gradient(inverse_of(local_map(setup, size, pixels, see)))
    miss = jnp.einsum("nij,nj->ni", inverse, found.place - places)
    return jnp.where(found.valid[:, None], miss, LOST)


def inverse_of(matrix: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """The inverse of each matrix; 0 where it has none."""
    (a, b), (c, d) = (matrix[:, 0, 0], matrix[:, 0, 1]), (matrix[:, 1, 0], matrix[:, 1, 1])
    determinant = a * d - b * c
    is_there = jnp.abs(determinant) > TINY
    adjoint = jnp.stack([jnp.stack([d, -b], -1), jnp.stack([-c, a], -1)], -2)
    return jnp.where(is_there[:, None, None], adjoint / jnp.where(is_there, determinant, 1.0)[:, None, None], 0.0)
