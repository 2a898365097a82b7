"""Questions to shapes: to all of a scene in turn, or to one of each ray's own, whose kind answers."""

from collections.abc import Callable, Collection
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from raytrace_jax.tracer.geometry.gather import UNROLL
from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.util.numerics import select

T = TypeVar("T")
Answer = TypeVar("Answer")
Index = int | Int[Array, ""]


def fold_shapes(
    kinds: tuple[str, ...],
    ask: Callable[[ShapeKind, Index], Answer],
    combine: Callable[[T, Answer], T],
    start: T,
    settle: Callable[[T | list[Answer]], Any] = lambda found: found,
    leave_out: Collection[str] = (),
) -> T:
    """What all shapes of a scene say, put together one after the other; in loops, kind by kind, where they are many.

    Args:
        kinds: the kind of each shape.
        ask: the answer of one shape, from its kind and its index.
        combine: puts an answer to what was found before; the order of the shapes must not matter to it.
        start: what is found before the first.
        settle: what to do with all answers before they are put together, and with what is found after each, where they
            are few. Chains of selections that feed each other are one kernel otherwise, which computes them anew.
        leave_out: kinds whose shapes are not asked.
    """
    asked = [(index, kind) for index, kind in enumerate(kinds) if kind not in leave_out]
    if len(asked) <= UNROLL:
        for answer in settle([ask(SHAPE_KINDS[kind], index) for index, kind in asked]):
            start = settle(combine(start, answer))
        return start
    for name, kind in SHAPE_KINDS.items():
        indices = jnp.asarray([index for index, other in asked if other == name], jnp.int32)
        if len(indices):

            def step(k, found, kind=kind, indices=indices):
                return combine(found, ask(kind, indices[k]))

            start = jax.lax.fori_loop(0, len(indices), step, start)
    return start


def present_kinds(shapes: Shapes) -> list[tuple[int, ShapeKind]]:
    """The kinds of which the scene has a shape, with their places in the table."""
    return [(place, kind) for place, (name, kind) in enumerate(SHAPE_KINDS.items()) if name in shapes.kinds]


def by_kind(shape: Shapes, answer: Callable[[ShapeKind], T]) -> T:
    """The answer of the kind of each ray's shape."""
    (_, kind), *others = present_kinds(shape)
    found = answer(kind)
    for place, kind in others:
        found = select(shape.kind == place, answer(kind), found)
    return found


def is_curved(shape: Shapes) -> Bool[Array, " *rays"]:
    """Which rays' shapes have an outline where rays graze them."""
    curved = [shape.kind == place for place, kind in present_kinds(shape) if kind.curved]
    found = jnp.zeros(shape.kind.shape, bool)
    for mine in curved:
        found = found | mine
    return found
