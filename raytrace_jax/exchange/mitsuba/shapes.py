"""Shapes of Mitsuba's spheres and rectangles, with what they are made of."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raytrace_jax.exchange.described import BLACK, Shape, around
from raytrace_jax.exchange.mitsuba.materials import read_bsdf, read_medium, read_radiance
from raytrace_jax.exchange.mitsuba.plugins import Plugin, number_of, place_of, transform_of

KINDS = ("sphere", "rectangle")
"""Kinds of shapes that are read."""


def read_shape(plugin: Plugin, path: Path, eye: Sequence[float] | None, lost: list[str]) -> Shape | None:
    """A shape, yet without a name; None where it is of a form that we have not. `lost` gets what else we have not.

    `eye` is where the camera is; None where it was not read before.
    """
    numbers = _numbers(plugin, lost)
    if numbers is None:
        return None
    is_flat = plugin.kind == "rectangle"
    halves = np.array([np.linalg.norm(numbers[side]) for side in ("right", "up")]) if is_flat else None
    surface = read_bsdf(plugin, path, halves, lost)
    inner, outer = "interior", "exterior"
    # A mirrored sphere's normals point inwards as well (those of a rectangle follow from its sides).
    is_mirrored = np.linalg.det(transform_of(plugin)[:3, :3]) < 0
    if not is_flat and is_mirrored != (plugin.values.get("flip_normals") is True):
        if surface.inside and "emitter" not in plugin.values:
            surface = dataclasses.replace(surface, inside=surface.outside, outside=surface.inside)
            inner, outer = outer, inner
        else:
            lost.append("a mirror in to_world" if is_mirrored else "flip_normals")
    surface = read_medium(plugin.values.get(inner), surface, lost)
    surface = read_radiance(plugin, path, halves, surface, lost)
    if is_flat and surface.inside:
        lost.append("flat glass, which has no inside here; it is left out")
        return None
    if is_flat and surface.emission != BLACK and eye is not None:
        side = -1 if plugin.values.get("flip_normals") is True else 1
        if side * np.cross(numbers["right"], numbers["up"]) @ np.subtract(eye, numbers["center"]) < 0:
            lost.append("it shines to the camera too, from its back")
    return Shape(plugin.kind, "", numbers, surface, is_within=outer in plugin.values)


def _numbers(plugin: Plugin, lost: list[str]) -> dict[str, Any] | None:
    """The numbers of a sphere or a rectangle; None for an ellipsoid, and a rectangle that is askew."""
    # Lengths that differ by a smaller share are equal, and directions that lean less are at right angles.
    matrix, equal = transform_of(plugin), 1e-9
    if plugin.kind == "sphere":
        gram, radius = matrix[:3, :3].T @ matrix[:3, :3], number_of(plugin, "radius", 1.0)
        if not np.allclose(gram, gram[0, 0] * np.eye(3), rtol=0, atol=equal * np.abs(gram).max()):
            lost.append("its to_world makes it an ellipsoid")
            return None
        return {"center": place_of(plugin, "center"), "radius": radius * math.sqrt(gram[0, 0])}
    right, up = matrix[:3, 0], matrix[:3, 1]
    if abs(right @ up) > equal * np.linalg.norm(right) * np.linalg.norm(up):
        lost.append("its sides are not at right angles")
        return None
    vectors = {"center": matrix[:3, 3], "right": right, "up": up}
    return {key: tuple(map(float, vector)) for key, vector in vectors.items()}


def with_indices(shapes: Sequence[Shape], lost: list[str]) -> list[Shape]:
    """The shapes with indices against vacuum for inner and outer ones, found from the largest ball of glass inwards."""
    balls = [shape for shape in shapes if shape.keyword == "sphere" and shape.material.is_glass]
    done: list[Shape] = []
    for shape in sorted(balls, key=lambda ball: -ball.numbers["radius"]):
        outer, material = around(shape, done), shape.material
        ior = material.inside / material.outside * (1.0 if outer is None else outer.ior)
        if outer is not None and outer.inside == material.outside:
            ior = material.inside * (outer.ior / outer.inside)  # Exact where the file's indices are.
        done.append(shape._replace(material=dataclasses.replace(material, ior=ior)))
    lost += [
        f"shape {shape.name}: exterior; there is nothing around it"
        for shape in shapes
        if shape.is_within and around(shape, done) is None
    ]
    by_name = {shape.name: shape for shape in done}
    return [by_name.get(shape.name, shape) for shape in shapes]
