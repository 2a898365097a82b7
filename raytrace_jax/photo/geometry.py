"""A camera and a ball, or a tank, before a board: where pixels see the board, directly and through it.

The frame is the board's: x to the right, y up, z towards who looks at it, in the board's unit of length. Pixels are
OpenCV's: (0, 0) is the middle of the upper left one. Rays are the tracer's, `tracer.geometry.camera`.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..optics.vectors import refract
from ..scene.scene import PerspectiveCamera
from ..tracer.geometry.camera import ray
from ..util.numerics import TINY, dot, normalize, safe_sqrt

Scalar = Float[Any, ""]
"""One number, of NumPy or of JAX."""

Pair = Float[Any, "2"]
Triple = Float[Any, "3"]

Points = Float[Array, "n 2"]
"""Pixels, or places on the board's plane."""

LOST = 5.0
"""Pixels by which a corner whose ray is lost counts as missed: more than any corner that counts."""

LENS = [*range(6, 11)]
"""Where the numbers of the lens, angle of view, distortion and principal point, lie in each raveled set-up."""

Numbers = Float[np.ndarray, " numbers"]
"""All numbers of a set-up, raveled."""

Size = tuple[int, int] | Float[Array, "2"]
"""Width and height of a picture, in pixels."""

Rays = Float[Array, "3 n"]


class Number(NamedTuple):
    """What one number of a set-up is.

    Args:
        name: its word for people.
        scale: about how far an adjustment may move it; 0 holds it, unless it was measured.
        is_own: whether each photograph has its own, in place of one that all have in common.
        is_result: whether it is a result for people, beside those of the camera.
    """

    name: str
    scale: float = 0.0
    is_own: bool = False
    is_result: bool = True


def number(*names: str, **said: Any) -> Any:
    """A field of one or several numbers with these names, of which `said` is true as in `Number`; 0 if not given."""
    shape = np.shape(names) if names[1:] else ()

    def converted(value: Any) -> Any:
        return value if isinstance(value, jax.Array) else np.full(shape, value, float)

    metadata = {"numbers": [Number(name, **said) for name in names]}
    return eqx.field(default=0.0, converter=converted, metadata=metadata)


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


class Camera(eqx.Module):
    """A camera before a board.

    Args:
        rotation, translation: rotation vector and translation of the camera as OpenCV has them, into a frame of x to
            the right, y down, z forward. The scale of the translation is in distances of the board.
        fov: its full horizontal angle of view in degrees.
        distortion: k1 and k2 of `scene.lens`.
        principal_offset: how far the principal point is to the right of and below the picture's middle, in widths of
            the picture.
    """

    rotation: Triple = number("turn.x", "turn.y", "turn.z", scale=0.02, is_own=True)
    translation: Triple = number("shift.x", "shift.y", "shift.z", scale=0.02, is_own=True)
    fov: Scalar = number("fov", scale=1.0)
    distortion: Pair = number("k1", "k2", scale=0.02)
    principal_offset: Pair = number("principal_point.x", "principal_point.y", scale=0.01)

    def focal_length(self, size: Size) -> Float[Array, ""]:
        """The focal length in pixels of a picture of this width and height."""
        return size[0] / (2 * jnp.tan(jnp.deg2rad(self.fov) / 2))

    def principal_point(self, size: Size) -> Float[Array, "2"]:
        """The principal point, in pixels."""
        return (jnp.asarray(size, float) - 1) / 2 + self.principal_offset * size[0]

    def project(self, size: Size, points: Float[Array, "n 3"]) -> Points:
        """The pixels in which points are seen, which lie in front of the camera; the inverse of `rays`."""
        seen = points @ rotation_matrix(self.rotation).T + self.translation
        x = seen[:, :2] / jnp.maximum(seen[:, 2:], TINY)
        squared = jnp.sum(x * x, axis=-1, keepdims=True)
        k1, k2 = self.distortion
        return self.focal_length(size) * (1 + k1 * squared + k2 * squared * squared) * x + self.principal_point(size)

    @property
    def of_scene(self) -> PerspectiveCamera:
        """The tracer's camera, with a picture of one pixel that is as wide as the photograph, and as high as wide.

        It looks at a point as far away as the board's middle is now; to a derivative that distance is a constant.
        """
        axes = rotation_matrix(self.rotation)
        viewpoint = -axes.T @ self.translation
        distance = jax.lax.stop_gradient(jnp.sqrt(jnp.maximum(jnp.sum(self.translation**2), TINY)))
        return PerspectiveCamera(
            name="photograph",
            pixeldim=(1, 1),
            viewpoint=viewpoint,
            lookat=viewpoint + distance * axes[2],
            up=-axes[1],
            fov=self.fov,
            center=self.principal_offset,
            distortion=self.distortion,
        )

    def rays(self, size: Size, pixels: Points) -> tuple[Rays, Rays]:
        """Origins and unit directions of the rays of pixels."""
        right, down = ((pixels - (jnp.asarray(size, float) - 1) / 2) / size[0]).T
        origin, direction = ray(self.of_scene, 0.5 + right, 0.5 - down)
        return origin, normalize(direction)


class Liquid(eqx.Module):
    """A liquid in which ball and board lie.

    Args:
        ior: its index, over that of the air.
        depth: how high above the board its surface is, which is parallel to it.
    """

    ior: Scalar = number("liquid")
    depth: Scalar = number("depth")

    def enter(self, o: Rays, d: Rays) -> tuple[Rays, Rays]:
        """The rays from the liquid's surface on."""
        normal, ratio = jnp.zeros_like(d).at[2].set(1.0), jnp.broadcast_to(self.ior, d.shape[1:])
        entry = o + (self.depth - o[2]) / jnp.where(d[2] < -1e-12, d[2], -1.0) * d
        return entry, refract(d, normal, ratio)[0]


class Ball(eqx.Module):
    """A ball before a board.

    Args:
        ior: its index, over that of the air.
        center, radius: where it is, and how large; the scale of the centre is in radii.
    """

    ior: Scalar = number("index", scale=0.05)
    center: Triple = number("center.x", "center.y", "center.z", scale=0.1, is_own=True)
    radius: Scalar = number("radius")

    def follow(self, o: Rays, d: Rays, outside: Any) -> Seen:
        """Follow rays, in what has the index `outside`, into the ball, out of it and to the board's plane."""
        center, radius = self.center[:, None], self.radius
        ior = jnp.broadcast_to(self.ior / outside, o.shape[1:])
        along = -dot(o - center, d)
        nearest = o + along * d - center
        squared = dot(nearest, nearest)
        discriminant = radius * radius - squared
        hits = (discriminant > 1e-12 * radius * radius) & (along > 0)
        # A ray that misses is followed from where it passes nearest, so that all is finite.
        entry = o + (along - safe_sqrt(discriminant)) * d
        inner, _, _ = refract(d, (entry - center) / radius, ior)
        leave = entry - 2 * dot(entry - center, inner) * inner
        outer, _, total = refract(inner, (leave - center) / radius, 1 / ior)
        place, distance = on_board(leave, outer)
        reach = jnp.sqrt(jnp.maximum(squared, TINY)) / radius
        return Seen(place, reach, hits & ~total & (distance > 0))


class Tank(eqx.Module):
    """A tank of a liquid before a board.

    Args:
        ior: the index of the liquid, over that of the air.
        center: where the thickness is measured, on the outside of its back.
        tilt: the outer normal of the tank's faces is along (tilt, 1).
        thickness: along its normal, from the outside of one wall to that of the other.
        wall, wall_index: thickness and index of each of its walls.
        wedge: how far the outer normal of the tank's back differs from (tilt, 1); 0 where its walls are parallel.
    """

    ior: Scalar = number("index", scale=0.05)
    center: Triple = number("center.x", "center.y", "center.z", is_own=True, is_result=False)
    tilt: Pair = number("tilt.x", "tilt.y", scale=0.02, is_own=True)
    thickness: Scalar = number("thickness")
    wall: Scalar = number("wall")
    wall_index: Scalar = number("wall_index")
    wedge: Pair = number("wedge.x", "wedge.y")

    def follow(self, o: Rays, d: Rays, outside: Any) -> Seen:
        """Refract rays at both faces of the front wall and of the back wall, by Snell's law; `outside` is an index.

        Both faces of a wall are parallel. Where the walls are, too, each layer only shifts the rays aside, and where
        the tank stands does not matter. Behind a wedge the rays are turned by about (n - 1) times its angle, so that
        its place matters a little.
        """
        front, back = (
            normalize(jnp.append(by, jnp.ones_like(self.ior)))[:, None] for by in (self.tilt, self.tilt + self.wedge)
        )
        wall_ior = jnp.where(self.wall > 0, self.wall_index, self.ior)
        faces = (
            jnp.stack([self.thickness, self.thickness - self.wall, self.wall, jnp.zeros_like(self.wall)]),
            jnp.stack([front, front, back, back]),
            jnp.stack([wall_ior / outside, self.ior / wall_ior, wall_ior / self.ior, outside / wall_ior]),
        )

        def meet(ray, face):
            (o, d, valid), (height, normal, ratio) = ray, face
            falls = -dot(d, normal)
            o = o + dot(o - self.center[:, None] - height * normal, normal) / jnp.maximum(falls, 1e-9) * d
            d, _, total = refract(d, jnp.broadcast_to(normal, d.shape), jnp.broadcast_to(ratio, falls.shape))
            return (o, d, valid & (falls > 1e-9) & ~total), None

        # A loop: four copies of it take four times as long to compile.
        (o, d, valid), _ = jax.lax.scan(meet, (o, d, jnp.ones(d.shape[1:], bool)), faces)
        # A tank that is taken to stand at the board, and is tilted, reaches behind it: its rays are followed back.
        place, distance = on_board(o, d)
        return Seen(place, jnp.zeros_like(distance), valid & (d[2] < -1e-12))


class Setup(eqx.Module):
    """A camera before a board, what it looks through, and the liquid in which all but the camera lie.

    Or an error of each number of these.

    Args:
        glass: a `Ball`, a `Tank`, or None.
    """

    camera: Camera
    glass: Any = None
    liquid: Liquid | None = None

    @property
    def numbers(self) -> list[Number]:
        """What the numbers are, as they are raveled: the camera's, then those of what it looks through."""
        parts = [part for part in (self.camera, self.glass, self.liquid) if part is not None]
        return [one for part in parts for field in dataclasses.fields(part) for one in field.metadata["numbers"]]

    @property
    def names(self) -> list[str]:
        """The words for the numbers, as they are raveled."""
        return [one.name for one in self.numbers]

    def places(self, *names: str) -> list[int]:
        """Where the numbers of these names, or of all axes of these names, lie in the raveled vector."""
        return [k for k, name in enumerate(self.names) if name in names or name.partition(".")[0] in names]

    @property
    def vector(self) -> Numbers:
        """All numbers in a row, raveled."""
        return np.hstack(jax.tree.leaves(self))

    def at(self, vector: Numbers) -> "Setup":
        """A set-up like this one with other numbers; outside of programs, for JAX would compile some for it."""
        leaves, form = jax.tree.flatten(self)
        parts = np.split(vector, np.cumsum([np.size(leaf) for leaf in leaves])[:-1])
        return form.unflatten(part.reshape(np.shape(leaf)) for part, leaf in zip(parts, leaves, strict=True))

    @property
    def beside(self) -> "Setup":
        """The same without what the camera looks through."""
        return Setup(self.camera, liquid=self.liquid)

    def follow(self, o: Rays, d: Rays) -> Seen:
        """Follow rays to the board's plane: through the ball or the tank, or directly if there is none."""
        outside = 1.0
        if self.liquid is not None:
            (o, d), outside = self.liquid.enter(o, d), self.liquid.ior
        if self.glass is not None:
            return self.glass.follow(o, d, outside)
        place, distance = on_board(o, d)
        return Seen(place, jnp.zeros_like(distance), distance > 0)

    def see(self, size: Size, pixels: Points) -> Seen:
        """Follow the rays of pixels to the board's plane."""
        return self.follow(*self.camera.rays(size, pixels))

    def local_map(self, size: Size, pixels: Points) -> Float[Array, "n 2 2"]:
        """The derivative of the place that is seen by the pixel, "place pixel"."""
        # A step of all pixels moves each one's place alone: one trace for all.
        return jax.jacfwd(lambda step: self.see(size, pixels + step).place)(jnp.zeros(2, pixels.dtype))


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


def on_board(origin: Rays, direction: Rays) -> tuple[Points, Float[Array, " n"]]:
    """Where rays meet the board's plane, and how far along them: -1 where they never do."""
    falls = direction[2] < -1e-12
    distance = jnp.where(falls, origin[2] / jnp.where(falls, -direction[2], 1.0), -1.0)
    return (origin + distance * direction)[:2].T, distance


def inverse_of(matrix: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """The inverse of each matrix; 0 where it has none."""
    (a, b), (c, d) = (matrix[:, 0, 0], matrix[:, 0, 1]), (matrix[:, 1, 0], matrix[:, 1, 1])
    determinant = a * d - b * c
    is_there = jnp.abs(determinant) > TINY
    adjoint = jnp.stack([jnp.stack([d, -b], -1), jnp.stack([-c, a], -1)], -2)
    return jnp.where(is_there[:, None, None], adjoint / jnp.where(is_there, determinant, 1.0)[:, None, None], 0.0)
