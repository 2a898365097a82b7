"""Questions to shapes of which each ray has its own: every kind in the scene answers, and each ray takes its kind's."""

from collections.abc import Callable
from typing import TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Bool

from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.util.numerics import select

T = TypeVar("T")


def present_kinds(shapes: Shapes) -> list[tuple[int, ShapeKind]]:
    """The kinds of which the scene has a shape, with their places in the table."""
    return [(place, kind) for place, (name, kind) in enumerate(SHAPE_KINDS.items()) if name in shapes.kinds]


def by_kind(shape: Shapes, answer: Callable[[ShapeKind, Bool[Array, " *rays"]], T]) -> T:
    """For each ray the answer of its shape's kind, which is told the rays that are its own."""
    (first, kind), *others = present_kinds(shape)
    found = answer(kind, shape.kind == first)
    for place, kind in others:
        mine = shape.kind == place
        found = select(mine, answer(kind, mine), found)
    return found


def is_curved(shape: Shapes) -> Bool[Array, " *rays"]:
    """Which rays' shapes have an outline where rays graze them."""
    curved = [shape.kind == place for place, kind in present_kinds(shape) if kind.curved]
    found = jnp.zeros(shape.kind.shape, bool)
    for mine in curved:
        found = found | mine
    return found
