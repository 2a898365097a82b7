"""Which glass lies in which: other renderers want to be told what is on the outside of a surface."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from raytrace_jax.exchange.described import Described, Material, Shape


def balls_of_glass(scene: Described) -> list[Shape]:
    """The spheres that light goes through."""
    return [shape for shape in scene.shapes if shape.material.is_glass and shape.keyword == "sphere"]


def overlap(a: Shape, b: Shape) -> bool:
    """Whether the surfaces of two spheres cut one another."""
    (p, r), (q, s) = _place(a), _place(b)
    return bool(abs(r - s) < np.linalg.norm(p - q) < r + s)


def touch(a: Shape, b: Shape) -> bool:
    """Whether two spheres have any point in common, on their surfaces or inside."""
    (p, r), (q, s) = _place(a), _place(b)
    return bool(np.linalg.norm(p - q) < r + s)


def around(shape: Shape, glass: list[Shape]) -> Material | None:
    """The glass that a sphere lies in: that of the smallest sphere which holds it; None in vacuum."""
    if shape.keyword != "sphere":
        return None
    holding = [other for other in glass if holds(other.numbers, shape.numbers)]
    return min(holding, key=lambda other: other.numbers["radius"]).material if holding else None


def holds(outer: Mapping[str, Any], inner: Mapping[str, Any]) -> bool:
    """Whether a sphere, by its numbers, lies in another, larger one."""
    apart = float(np.linalg.norm(np.subtract(outer["center"], inner["center"])))
    return bool(inner["radius"] < outer["radius"] and apart + inner["radius"] <= outer["radius"])


def _place(shape: Shape) -> tuple[np.ndarray, float]:
    """Where a sphere is, and its radius."""
    return shape.numbers["center"], float(shape.numbers["radius"])
