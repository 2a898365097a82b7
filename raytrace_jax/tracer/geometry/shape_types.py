"""The table of shape types, questions to shapes of any type, and the shapes of a scene laid out for tracing."""

import functools
from collections.abc import Callable, Collection
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ...scene.parameters import shape_blocks
from ...scene.scene import Scene
from ...scene.table import BLOCK_TYPES
from ...util.numerics import dot, select, unstacked, with_lower_ranks
from ..settings import ResolvedSettings
from .plane import PLANE
from .rays import UNROLL
from .rectangle import RECTANGLE
from .shapes import Shapes, ShapeType
from .sphere import SPHERE

SHAPE_TYPES: dict[str, ShapeType] = {"plane": PLANE, "sphere": SPHERE, "rectangle": RECTANGLE}
"""The types of shapes, by their keywords in a scene's file."""

T = TypeVar("T")
Answer = TypeVar("Answer")
Index = int | Int[Array, ""]


def fold_shapes(
    shapes: Shapes,
    ask: Callable[[ShapeType, Shapes, Index], Answer],
    combine: Callable[[T, Answer], T],
    start: T,
    settle: Callable[[T | list[Answer]], Any] = lambda found: found,
    leave_out: Collection[str] = (),
) -> T:
    """The answers of all shapes of a scene, put together in turn; asked type by type, in loops where they are many.

    Args:
        ask: the answer of one shape, from its type, itself and its index.
        combine: puts an answer to what was found before; the order of the shapes must not matter to it.
        settle: what to do with all answers before they are put together, and with what is found after each, where they
            are few. Chains of selections that feed each other are one kernel otherwise, which computes them anew.
    """
    names = [name for name in SHAPE_TYPES if name not in leave_out]
    asked = {name: [k for k, other in enumerate(shapes.types) if other == name] for name in names}

    def ask_one(name: str, index: Index) -> Answer:
        return ask(SHAPE_TYPES[name], jax.tree.map(lambda values: values[..., index], shapes), index)

    if sum(map(len, asked.values())) <= UNROLL:
        answers = []
        for name, indices in asked.items():
            if len(indices) == 1:
                answers.append(ask_one(name, indices[0]))
            elif indices:
                each = jax.vmap(functools.partial(ask_one, name))(jnp.asarray(indices, jnp.int32))
                answers += unstacked(each, len(indices))
        for answer in settle(answers):
            start = settle(combine(start, answer))
        return start
    for name, indices in asked.items():
        if indices:
            places = jnp.asarray(indices, jnp.int32)

            def step(k, found, name=name, places=places):
                return combine(found, ask_one(name, places[k]))

            start = jax.lax.fori_loop(0, len(indices), step, start)
    return start


def present_types(shapes: Shapes) -> list[tuple[int, ShapeType]]:
    return [(place, shape_type) for place, (name, shape_type) in enumerate(SHAPE_TYPES.items()) if name in shapes.types]


def by_type(shape: Shapes, answer: Callable[[ShapeType], T]) -> T:
    (_, shape_type), *others = present_types(shape)
    found = answer(shape_type)
    for place, shape_type in others:
        found = select(shape.type == place, answer(shape_type), found)
    return found


def shape_materials(scene: Scene) -> list[int]:
    return [shape.read(scene, "material") for shape in shape_blocks(scene)]


def repeated(shapes: Shapes) -> Bool[Array, " shapes"]:
    """Whether each shape has the surface of an earlier one; planes do whatever point of them the file has."""
    is_plane = shapes.type == list(SHAPE_TYPES).index("plane")
    foot = jnp.where(is_plane, dot(shapes.normal, shapes.position) * shapes.normal, shapes.position)
    # Types differ in what is 0: a sphere's normal, and of flat shapes a plane's axes.
    rows = [foot, shapes.normal, shapes.radius[None]]
    if shapes.axes is not None:
        rows.append(shapes.axes.reshape(-1, len(shapes.types)))
    table = jnp.concatenate(rows)
    same = jnp.all(table[:, :, None] == table[:, None], axis=0)
    return jnp.any(jnp.tril(same, -1), axis=1)


@with_lower_ranks
def scene_shapes(scene: Scene, settings: ResolvedSettings) -> Shapes:
    groups = [getattr(scene, BLOCK_TYPES[keyword][0].group) for keyword in SHAPE_TYPES]
    # The place of each shape, in the order of the file, in the list of all shapes type by type.
    places = {name: place for place, name in enumerate(name for group in groups for name in group.names)}
    order = jnp.asarray([places[name] for name in scene.shape_order], jnp.int32)
    found = [shape_type.coefficients(group) for shape_type, group in zip(SHAPE_TYPES.values(), groups, strict=True)]
    # Types of which there is none in the scene add nothing to what is compiled.
    found = [one for one, group in zip(found, groups, strict=True) if group.names] or found[:1]
    if any("axes" in one for one in found):
        for one in found:
            one.setdefault("axes", jnp.zeros((2, *one["position"].shape), one["position"].dtype))
    types, known = tuple(shape.keyword for shape in shape_blocks(scene)), list(SHAPE_TYPES)
    return Shapes(
        types=types,
        settings=settings,
        type=jnp.asarray([known.index(name) for name in types], jnp.int32),
        **{name: jnp.concatenate([one[name] for one in found], -1)[..., order] for name in found[0]},
    )
