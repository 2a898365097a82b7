"""Scenes made by hand, checked when they are rendered: what no file may hold, and no picture can be made from."""

import jax
import numpy as np

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.blocks import material_of, scene_kinds, shape_blocks
from raytrace_jax.scene.limits import NOT_ALL_ZERO, POSITIVE
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.scene.values import is_traced

_checked: list[object] = []
"""The arrays of the scene that was found right last: who renders it again does not wait for a check."""


def check_values(scene: Scene) -> None:
    """Refuse numbers that are not finite, lengths and indices that are not positive, no direction, flat glass.

    Weights beyond 0 to 1 pass: a finite difference may take them there. What is traced has no values yet.

    Raises:
        SceneError: names the block and its attribute.
    """
    leaves = jax.tree.leaves(scene)
    is_known = len(leaves) == len(_checked) and all(map(lambda leaf, known: leaf is known, leaves, _checked))
    if is_known or is_traced(leaves):
        return
    for kind in scene_kinds(scene):
        group = getattr(scene, kind.group)
        for attribute in kind.continuous:
            values = np.asarray(getattr(group, attribute.name))
            values = values[..., None] if kind.is_single else values
            wrong = np.logical_not(_holds(attribute, values))
            if wrong.any():
                column = int(np.argmax(wrong))
                name = group.name if kind.is_single else group.names[column]
                raise SceneError(
                    f"{kind.keyword} {name!r}: {attribute.name} must be {_wanted(attribute)}, "
                    f"got {' '.join(map(str, np.atleast_1d(values[..., column])))}."
                )
    if scene.model == "physical":
        check_glass(scene)
    # What can be written to may be another scene the next time.
    _checked[:] = leaves if all(isinstance(leaf, jax.Array) for leaf in leaves) else ()


def check_glass(scene: Scene) -> None:
    """Refuse glass that has no inside.

    Raises:
        SceneError: names the shape.
    """
    for shape in shape_blocks(scene):
        material = material_of(scene, shape)
        if shape.keyword == "rectangle" and np.any(np.asarray(material.read(scene, "transmission")) > 0):
            raise SceneError(
                f"rectangle {shape.name!r}: its material {material.name!r} lets light through, and a rectangle has no "
                "inside: glass is a sphere, or a plane with all that is behind it; docs/physical.md has a slab of two."
            )


def _holds(attribute: Attribute, values: np.ndarray) -> np.ndarray:
    """For each block whether its value can be used."""
    numbers = values if attribute.components else values[None]
    fine = np.all(np.isfinite(numbers), axis=0)
    if attribute.limit is POSITIVE:
        fine = fine & np.all(numbers > 0, axis=0)
    if attribute.limit is NOT_ALL_ZERO:
        fine = fine & np.any(numbers != 0, axis=0)
    return np.asarray(fine)


def _wanted(attribute: Attribute) -> str:
    limit = attribute.limit
    return f"finite and {limit.wanted}" if limit and limit in (POSITIVE, NOT_ALL_ZERO) else "finite"
