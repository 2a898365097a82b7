"""Checks of whole scenes: what no picture can be made from is refused, what is probably a mistake is warned of."""

import operator

import jax
import numpy as np

from ..errors import SceneError
from ..util.numerics import is_traced
from ..util.text import listed
from .parameters import attribute_values, material_of, shape_blocks
from .scene import Scene
from .schema import RGB
from .setting_words import ModelName
from .structs import NOT_ALL_ZERO, POSITIVE, ImagePlaneCamera

_checked: list[object] = []
"""The arrays of the scene that was found right last: who renders it again does not wait for a check."""


def check_values(scene: Scene) -> None:
    """Refuse numbers that are not finite, lengths and indices that are 0, nearly so or less, no direction, flat glass.

    Weights beyond 0 to 1 pass: a finite difference may take them there. What is traced has no values yet. The
    SceneError names the block and its attribute.
    """
    leaves = jax.tree.leaves(scene)
    is_known = len(leaves) == len(_checked) and all(map(operator.is_, leaves, _checked))
    if is_known or is_traced(leaves):
        return
    for row, attribute, names, values in attribute_values(scene):
        wrong = ~np.all(np.isfinite(values), axis=0)
        # The limits without which there is no picture.
        limit = attribute.limit if attribute.limit in (POSITIVE, NOT_ALL_ZERO) else None
        if limit:
            # Pictures and derivatives are divided by powers of it: what has no fourth one in its dtype is as 0.
            felt = np.where(np.abs(values) < np.finfo(values.dtype).tiny ** 0.25, 0, values)
            wrong |= np.array([not limit.holds(of_block) for of_block in felt.T], bool)
        if wrong.any():
            column = int(np.argmax(wrong))
            wanted = f" and {limit.wanted}, not too small for {values.dtype}" if limit else ""
            got = " ".join(map(str, values[:, column]))
            raise SceneError(f"{row.keyword} {names[column]!r}: {attribute.name} must be finite{wanted}, got {got}.")
    for shape in shape_blocks(scene) if scene.model == "physical" else ():
        material = material_of(scene, shape)
        if shape.keyword == "rectangle" and _is_set(material.read(scene, "transmission")):
            raise SceneError(
                f"rectangle {shape.name!r}: its material {material.name!r} lets light through, and a rectangle has no "
                "inside: glass is a body such as a sphere or a box, a slab, or a plane with all that is behind it."
            )
    # What can be written to may be another scene the next time.
    _checked[:] = leaves if all(isinstance(leaf, jax.Array) for leaf in leaves) else ()


def scene_warnings(scene: Scene, model: ModelName) -> list[str]:
    """Warnings about a scene, with concrete values, that renders under a model but is probably a mistake."""
    found = []
    unused: dict[ModelName, list[str]] = {}
    for _, attribute, owners, values in attribute_values(scene):
        if not attribute.is_used_by(model) and isinstance(attribute.default, tuple):
            is_set = np.any(values != np.reshape(attribute.default, (-1, 1)), axis=0)
            for column in np.flatnonzero(is_set):
                unused.setdefault(attribute.only[0], []).append(f"{owners[column]}.{attribute.name}")
    for other, names in unused.items():
        means, it = ("means", "it") if len(names) == 1 else ("mean", "them")
        found.append(f"{listed(names)} {means} nothing to the {model} model; --model {other} has {it}.")
    sources = ("emissivity", "emission", "radiance") if model == "physical" else ("emissivity", "ambient")
    if not scene.shape_order:
        found.append("the scene has no shapes: its picture is black.")
    elif not any(_is_set(values) for _, one, _, values in attribute_values(scene) if one.name in sources):
        words = "emission, no background" if model == "physical" else "ambient colour"
        found.append(f"the scene has no light (no light block, no {words}): its picture is black.")
    elif unlit := _unlit_shapes(scene) if model == scene.model == "physical" else ():
        found.append(
            f"{listed(unlit)} {'is' if len(unlit) == 1 else 'are'} matt and black: only light blocks shine on matt "
            "surfaces, and the scene has none."
        )
    for camera in (scene.seen_by(name).camera for name in scene.cameras):
        if isinstance(camera, ImagePlaneCamera) and float(np.asarray(camera.viewpoint)[2]) == 0:
            found.append(f"the camera {camera.name} is in its image plane, z = 0: all of its rays lie in that plane.")
    return found


def _unlit_shapes(scene: Scene) -> list[str]:
    """Shapes of the physical model that are nothing but matt, in a scene without light blocks that shine."""
    if _is_set(scene.lights.emissivity):
        return []
    materials = {shape.name: material_of(scene, shape).read_all(scene) for shape in shape_blocks(scene)}
    others = ("emission", "reflectivity", "transmission")
    return [
        name
        for name, values in materials.items()
        if _is_set(values["diffuse"]) and not any(_is_set(values[other]) for other in others)
    ]


def _is_set(value: object) -> bool:
    return bool(np.any(np.asarray(value) != 0))


def is_gray(scene: Scene) -> bool:
    """Whether nothing in a scene has a colour: its picture has three equal channels."""
    colours = [values for _, attribute, _, values in attribute_values(scene.alone()) if attribute.components == RGB]
    return all(bool(np.all(colour == colour[:1])) for colour in [*colours, *map(np.asarray, scene.images.texels)])
