"""The faces of the blocks of solids, as functions of their numbers: bodies that have several, and the sphere."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...scene.structs import Boxes, CutCylinders, CutSpheres, Cylinders, Lenses, Prisms, Spheres
from ...util.numerics import direction, dot
from .solid import Kind, solid

Numbers = Float[Array, " shapes"]
Vectors = Float[Array, "3 shapes"]
Face = dict[str, Array]


def plane(point: Vectors, normal: Vectors, **more: Array) -> Face:
    zeros, none = jnp.zeros_like(point[0]), jnp.zeros_like(point)
    return {"position": point, "normal": normal, "curvature": zeros, "radius": zeros, "axis": none, **more}


def round_face(center: Vectors, radius: Numbers, **axis: Vectors) -> Face:
    """A ball's, or with an axis a cylinder's."""
    return plane(center, jnp.zeros_like(center), curvature=1 / radius, radius=radius, **axis)


def body(volume: Numbers, *faces: Face) -> Face:
    size = jnp.cbrt(3 / (4 * jnp.pi) * jax.lax.stop_gradient(volume))
    size = jnp.broadcast_to(size[:, None], (len(volume), len(faces)))
    return {"size": size, **{name: jnp.stack([face[name] for face in faces], axis=-1) for name in faces[0]}}


def ball(spheres: Spheres) -> Face:
    face = round_face(spheres.center, spheres.radius)
    del face["axis"]
    return face | {"size": spheres.radius}


def half_ball(spheres: CutSpheres) -> Face:
    faces = round_face(spheres.center, spheres.radius), plane(spheres.center, direction(spheres.cut))
    return body(2 / 3 * jnp.pi * spheres.radius**3, *faces)


def box(boxes: Boxes) -> Face:
    right, up, center = direction(boxes.right), direction(boxes.up), boxes.center
    forward = direction(jnp.cross(right, up, axis=0))
    halves = [(boxes.right, right), (boxes.up, up), (boxes.depth * forward, forward)]
    volume = 8 * dot(boxes.right, right) * dot(boxes.up, up) * boxes.depth
    return body(volume, *(plane(center + s * half, s * normal) for half, normal in halves for s in (1, -1)))


def prism(prisms: Prisms) -> Face:
    point, along, down = prisms.point, direction(prisms.axis), direction(prisms.down)
    half = jnp.radians(prisms.apex) / 2
    aside = jnp.cos(half) * direction(jnp.cross(along, down, axis=0))
    refracting = [plane(point, s * aside - jnp.sin(half) * down) for s in (1, -1)]
    ends = [plane(point + s * prisms.axis, s * along) for s in (1, -1)]
    volume = 2 * dot(prisms.axis, along) * dot(prisms.down, down) ** 2 * jnp.tan(half)
    return body(volume, *refracting, plane(point + prisms.down, down), *ends)


def cylinder(cylinders: Cylinders, *cut: Face) -> Face:
    """With a cut through its center it is half a cylinder."""
    center, radius, along = cylinders.center, cylinders.radius, direction(cylinders.axis)
    ends = [plane(center + s * cylinders.axis, s * along) for s in (1, -1)]
    volume = 2 * jnp.pi * radius**2 * dot(cylinders.axis, along) / (1 + len(cut))
    return body(volume, round_face(center, radius, axis=along), *ends, *cut)


def half_cylinder(cylinders: CutCylinders) -> Face:
    return cylinder(cylinders, plane(cylinders.center, direction(cylinders.cut)))


def lens(lenses: Lenses) -> Face:
    along, radius = direction(lenses.axis), lenses.diameter / 2
    faces, volume = [round_face(lenses.center, radius, axis=along)], jnp.pi * radius**2 * lenses.thickness
    for s, curvature in ((-1, lenses.curvature1), (1, -lenses.curvature2)):
        faces.append(plane(lenses.center + s * lenses.thickness / 2 * along, s * along, curvature=curvature))
        # What lies between a face and the plane through its vertex, up to the rim.
        root = jnp.sqrt(jnp.maximum(1 - (curvature * radius) ** 2, 0))
        depth = curvature * radius**2 / (1 + root)
        volume -= jnp.pi * depth * (3 * radius**2 - depth**2) / 6
    return body(jnp.maximum(volume, 0), *faces)


FLAT: Kind = "flat"
SPHERE = solid(ball, "ball")
CUT_SPHERE = solid(half_ball, "ball", FLAT)
BOX = solid(box, *6 * (FLAT,))
PRISM = solid(prism, *5 * (FLAT,))
CYLINDER = solid(cylinder, "cylinder", FLAT, FLAT)
CUT_CYLINDER = solid(half_cylinder, "cylinder", FLAT, FLAT, FLAT)
LENS = solid(lens, "cylinder", "cap", "cap")
