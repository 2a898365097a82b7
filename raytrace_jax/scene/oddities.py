"""What can be rendered and is hardly meant: sentences to warn with."""

import numpy as np

from raytrace_jax.scene.blocks import scene_kinds
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.scene import ImagePlaneCamera, Scene
from raytrace_jax.util.text import listed


def oddities(scene: Scene, model: ModelName) -> list[str]:
    """What is odd about a scene, with concrete values, that is to be rendered under a model; a sentence for each."""
    found = []
    for other, unused in unused_attributes(scene, model).items():
        found.append(
            f"{listed(unused)} {'means' if len(unused) == 1 else 'mean'} nothing to the {model} model; "
            f"--model {other} has {'it' if len(unused) == 1 else 'them'}."
        )
    if not scene.shape_order:
        found.append("the scene has no shapes: its picture is black.")
    camera = scene.camera
    if isinstance(camera, ImagePlaneCamera) and float(camera.viewpoint[2]) == 0:
        found.append(f"the camera {camera.name} is in its image plane, z = 0: all of its rays lie in that plane.")
    return found


def unused_attributes(scene: Scene, model: ModelName) -> dict[ModelName, list[str]]:
    """By another model the attributes that only it has and that a block of the scene sets, as `glass.transmission`."""
    found: dict[ModelName, list[str]] = {}
    for kind in scene_kinds(scene):
        group = getattr(scene, kind.group)
        for attribute in kind.continuous:
            if attribute.only_model in (None, model) or attribute.default is None:
                continue
            is_set = np.atleast_1d(np.asarray(getattr(group, attribute.name)) != attribute.default)
            names = [f"{group.names[column]}.{attribute.name}" for column in np.flatnonzero(is_set)]
            if names:
                found.setdefault(attribute.only_model, []).extend(names)
    return found
