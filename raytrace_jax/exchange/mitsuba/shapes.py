"""Mitsuba's spheres and rectangles become shapes of ours, with what they are made of."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raytrace_jax.exchange.described import holds
from raytrace_jax.exchange.mitsuba.materials import BLACK, Read, read_bsdf, read_medium, read_radiance
from raytrace_jax.exchange.mitsuba.plugins import Plugin, number_of, place_of, transform_of
from raytrace_jax.scene import build
from raytrace_jax.scene.rows import Description

EQUAL = 1e-9
"""Lengths that differ by a smaller share are equal, and directions that lean less are at right angles."""

KINDS = ("sphere", "rectangle")
"""Kinds of shapes that are read."""


@dataclasses.dataclass
class ShapeRead:
    """A shape that was read, with the numbers and the name of its block."""

    kind: str
    numbers: dict[str, Any]
    surface: Read
    is_within: bool  # A medium is said to be around it.
    name: str = ""

    @property
    def material(self) -> str:
        """The name of its material."""
        return self.surface.name or f"{self.name}_material"

    def block(self, material: str) -> Description:
        """The block of the shape."""
        construct = build.sphere if self.kind == "sphere" else build.rectangle
        return construct(self.name, material=material, **self.numbers)


def read_shape(plugin: Plugin, path: Path, eye: Sequence[float] | None, lost: list[str]) -> ShapeRead | None:
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
    return ShapeRead(plugin.kind, numbers, surface, outer in plugin.values)


def _numbers(plugin: Plugin, lost: list[str]) -> dict[str, Any] | None:
    """The numbers of a sphere or a rectangle; None for an ellipsoid, and a rectangle that is askew."""
    matrix = transform_of(plugin)
    if plugin.kind == "sphere":
        gram, radius = matrix[:3, :3].T @ matrix[:3, :3], number_of(plugin, "radius", 1.0)
        if not np.allclose(gram, gram[0, 0] * np.eye(3), rtol=0, atol=EQUAL * np.abs(gram).max()):
            lost.append("its to_world makes it an ellipsoid")
            return None
        return {"center": place_of(plugin, "center"), "radius": radius * math.sqrt(gram[0, 0])}
    right, up = matrix[:3, 0], matrix[:3, 1]
    if abs(right @ up) > EQUAL * np.linalg.norm(right) * np.linalg.norm(up):
        lost.append("its sides are not at right angles")
        return None
    vectors = {"center": matrix[:3, 3], "right": right, "up": up}
    return {key: tuple(map(float, vector)) for key, vector in vectors.items()}


def give_indices(shapes: Sequence[ShapeRead], lost: list[str]) -> None:
    """Turn inner and outer indices into those against vacuum, from the largest ball of glass to the smallest."""
    balls = [shape for shape in shapes if shape.kind == "sphere"]
    done: list[ShapeRead] = []
    for shape in sorted((ball for ball in balls if ball.surface.inside), key=lambda ball: -ball.numbers["radius"]):
        holding = [other for other in done if holds(other.numbers, shape.numbers)]
        around = min(holding, key=lambda other: other.numbers["radius"]).surface if holding else None
        surface = shape.surface
        if around is not None and around.inside == surface.outside:
            ior = surface.inside * (around.ior / around.inside)
        else:
            ior = surface.inside / surface.outside * (1.0 if around is None else around.ior)
        shape.surface = dataclasses.replace(surface, ior=ior)
        done.append(shape)
    for shape in shapes:
        is_held = shape in balls and any(holds(other.numbers, shape.numbers) for other in done)
        if shape.is_within and not is_held:
            lost.append(f"shape {shape.name}: exterior; there is nothing around it")
