"""The table of shape types, questions to shapes of any type, and the shapes of a scene laid out for tracing."""

import functools
from collections.abc import Callable, Collection, Sequence
from itertools import accumulate
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ...scene.parameters import shape_blocks
from ...scene.scene import Scene
from ...scene.slabs import surface_owners
from ...util.compilation import jit
from ...util.numerics import dot, select, unstacked, with_lower_ranks
from ..settings import ResolvedSettings
from . import bodies
from .plane import PLANE
from .rays import UNROLL, Index
from .rectangle import RECTANGLE
from .shapes import Faces, Shapes, ShapeType

SHAPE_TYPES: dict[str, ShapeType] = {
    "planes": PLANE,
    "spheres": bodies.SPHERE,
    "rectangles": RECTANGLE,
    "cut_spheres": bodies.CUT_SPHERE,
    "boxes": bodies.BOX,
    "prisms": bodies.PRISM,
    "cylinders": bodies.CYLINDER,
    "cut_cylinders": bodies.CUT_CYLINDER,
    "lenses": bodies.LENS,
}
"""The types of shapes, by their groups in a scene."""

T = TypeVar("T")
Answer = TypeVar("Answer")


def fold_shapes(
    shapes: Shapes,
    ask: Callable[[ShapeType, Faces, Index], Answer],
    combine: Callable[[T, Answer], T],
    start: T,
    settle: Callable[[T | list[Answer]], Any] = lambda found: found,
    leave_out: Collection[str] = (),
) -> T:
    """The answers of all shapes of a scene, put together in turn; asked type by type, in loops where they are many.

    Args:
        ask: the answer of one shape, from its type, its faces and the index of the first.
        combine: puts an answer to what was found before; the order of the shapes must not matter to it.
        settle: what to do with all answers before they are put together, and with what is found after each, where they
            are few. Chains of selections that feed each other are one kernel otherwise, which computes them anew.
    """
    placed = list(zip(shapes.types, shapes.starts, strict=True))
    asked = set(shapes.types) - set(leave_out)
    starts = {name: [start for other, start in placed if other == name] for name in SHAPE_TYPES if name in asked}

    def ask_one(name: str, index: Index) -> Answer:
        shape_type = SHAPE_TYPES[name]
        return ask(shape_type, [face(shapes, index + k) for k in range(shape_type.face_count)], index)

    if sum(map(len, starts.values())) <= UNROLL:
        answers = []
        for name, indices in starts.items():
            if len(indices) == 1:
                answers.append(ask_one(name, indices[0]))
            else:
                each = jax.vmap(functools.partial(ask_one, name))(jnp.asarray(indices, jnp.int32))
                answers += unstacked(each, len(indices))
        for answer in settle(answers):
            start = settle(combine(start, answer))
        return start
    for name, indices in starts.items():
        places = jnp.asarray(indices, jnp.int32)

        def step(k, found, name=name, places=places):
            return combine(found, ask_one(name, places[k]))

        start = jax.lax.fori_loop(0, len(indices), step, start)
    return start


def face(shapes: Shapes, index: Index) -> Shapes:
    return jax.tree.map(lambda values: values[..., index], shapes)


def all_faces(shapes: Shapes) -> list[Faces]:
    """The faces of each shape."""
    return [[face(shapes, place) for place in range(*part)] for part in zip(shapes.starts, shapes.ends, strict=True)]


def families(names: Collection[str]) -> dict[Any, int]:
    """The types of some names, of those that ask one face alike the first: all solids are one, named by their edges."""
    found: dict[Any, int] = {}
    for place, (name, shape_type) in enumerate(SHAPE_TYPES.items()):
        if name in names:
            found.setdefault(shape_type.edges, place)
    return found


def present_types(shapes: Shapes) -> list[tuple[int, ShapeType]]:
    """The families of types that there are, by the number that their faces have as type."""
    known = families(SHAPE_TYPES)
    return [(known[edges], list(SHAPE_TYPES.values())[known[edges]]) for edges in families(shapes.types)]


def by_type(shape: Shapes, answer: Callable[[ShapeType], T]) -> T:
    (_, shape_type), *others = present_types(shape)
    found = answer(shape_type)
    for place, shape_type in others:
        found = select(shape.type == place, answer(shape_type), found)
    return found


def face_counts(scene: Scene) -> list[int]:
    """How many faces each shape has, in the order of the file."""
    return [SHAPE_TYPES[shape.type.group].face_count for shape in shape_blocks(scene)]


def per_face(scene: Scene, of_shapes: Sequence[T]) -> list[T]:
    """Of each face what its shape has."""
    return [value for value, count in zip(of_shapes, face_counts(scene), strict=True) for _ in range(count)]


def face_owners(scene: Scene) -> list[tuple[str, int]]:
    """Of each face that rays meet the name of its surface, and the place of its shape in the file."""
    # Without arrays: those of a batch of scenes have another axis.
    counts = {name: kind.face_count for group, kind in SHAPE_TYPES.items() for name in getattr(scene, group).names}
    return [(name, place) for name, place in surface_owners(scene).items() for _ in range(counts.get(name, 1))]


def face_materials(scene: Scene) -> list[int]:
    return per_face(scene, [shape.read(scene, "material") for shape in shape_blocks(scene)])


def repeated(shapes: Shapes) -> Bool[Array, " shapes"]:
    """Whether each face is of a shape that has the surface of an earlier one; planes do whatever point the file has."""
    is_plane = shapes.type == list(SHAPE_TYPES).index("planes")
    foot = jnp.where(is_plane, dot(shapes.normal, shapes.position) * shapes.normal, shapes.position)
    # Types differ in what is 0: a sphere's normal, and of flat shapes a plane's axes.
    rows = [foot, shapes.normal, shapes.radius[None]]
    if shapes.axes is not None:
        rows.append(shapes.axes.reshape(-1, len(shapes.type)))
    if shapes.axis is not None:
        rows += [shapes.axis, shapes.curvature[None], shapes.type[None].astype(foot.dtype)]
    table, hidden = jnp.concatenate(rows), jnp.zeros(len(shapes.type), bool)
    counts = np.subtract(shapes.ends, shapes.starts)
    for count in np.unique(counts):
        # The faces of the shapes that have so many, "shapes faces".
        faces = np.array(shapes.starts)[counts == count][:, None] + np.arange(count)
        of_shape = jnp.moveaxis(table[:, faces], -1, 0).reshape(-1, len(faces))
        same = jnp.all(of_shape[:, :, None] == of_shape[:, None], axis=0)
        hidden = hidden.at[faces].set(jnp.any(jnp.tril(same, -1), axis=1)[:, None])
    return hidden


@with_lower_ranks
def scene_shapes(scene: Scene, settings: ResolvedSettings) -> Shapes:
    groups = {name: getattr(scene, name) for name in SHAPE_TYPES}
    # Types of which there is none in the scene add nothing to what is compiled.
    present = [name for name, group in groups.items() if group.names] or list(SHAPE_TYPES)[:1]
    # Face after face of all shapes, type by type; and in that list the places of the faces in the order of the file.
    faces = (name for kind in present for name in groups[kind].names for _ in range(SHAPE_TYPES[kind].face_count))
    ranks = {name: rank for rank, name in enumerate(scene.shape_order)}
    order = jnp.asarray(np.argsort([ranks[name] for name in faces], kind="stable"), jnp.int32)
    found = [SHAPE_TYPES[kind].coefficients(groups[kind]) for kind in present]
    for part, axes in (("axes", (2, 3)), ("axis", (3,))):
        if any(part in one for one in found):
            for one in found:
                one.setdefault(part, jnp.zeros((*axes, *one["radius"].shape), one["radius"].dtype))
    # Faces and shapes as one axis.
    flat = [{k: x.reshape(*x.shape[: x.ndim - one["radius"].ndim], -1) for k, x in one.items()} for one in found]
    columns = {name: jnp.concatenate([one[name] for one in flat], -1)[..., order] for name in flat[0]}
    types, counts = tuple(shape.type.group for shape in shape_blocks(scene)), face_counts(scene)
    family = families(SHAPE_TYPES)
    numbers = [family[SHAPE_TYPES[name].edges] for name in per_face(scene, types)]
    starts = tuple(accumulate(counts, initial=0))[:-1]
    return Shapes(types, starts, settings, jnp.asarray(numbers, jnp.int32), **columns)


shapes_of_numbers = jit(scene_shapes, static_argnames="settings")
"""`scene_shapes` as a program of its own, for who is in none: by single operations it takes seconds."""
