"""Which glass lies in which: other renderers want to be told what is on the outside of a surface."""

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
    center, radius = _place(shape)
    holding = [
        (size, other.material)
        for other in glass
        for place, size in (_place(other),)
        if other is not shape and size > radius and np.linalg.norm(center - place) + radius <= size
    ]
    return min(holding, key=lambda found: found[0])[1] if holding else None


def _place(shape: Shape) -> tuple[np.ndarray, float]:
    """Where a sphere is, and its radius."""
    return shape.numbers["center"], float(shape.numbers["radius"])
