"""What can be rendered and is hardly meant: sentences to warn with."""

import jax.numpy as jnp
import numpy as np

from raytrace_jax.scene.block_kinds import RGB
from raytrace_jax.scene.blocks import Block, material_of, scene_kinds, shape_blocks
from raytrace_jax.scene.scene import ImagePlaneCamera, Scene
from raytrace_jax.scene.setting_words import ModelName
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
    elif not has_light(scene, model):
        found.append(f"the scene has no light ({LIGHTS[model]}): its picture is black.")
    elif unlit := unlit_shapes(scene, model):
        found.append(
            f"{listed(unlit)} {'is' if len(unlit) == 1 else 'are'} matt and black: only light blocks shine on matt "
            "surfaces, and the scene has none."
        )
    camera = scene.camera
    if isinstance(camera, ImagePlaneCamera) and float(camera.viewpoint[2]) == 0:
        found.append(f"the camera {camera.name} is in its image plane, z = 0: all of its rays lie in that plane.")
    return found


LIGHTS: dict[ModelName, str] = {
    "classic": "no light block, no ambient colour",
    "additive": "no light block, no ambient colour",
    "physical": "no light block, no emission, no background",
}
"""What a scene lacks that has no light, by the models."""


def has_light(scene: Scene, model: ModelName) -> bool:
    """Whether anything in a scene sends light of its own."""
    sources = [scene.lights.emissivity]
    own = "emission" if model == "physical" else "ambient"
    sources += [
        getattr(materials, own) for materials in (scene.materials, scene.abbe_materials, scene.channel_materials)
    ]
    if model == "physical" and scene.background is not None:
        sources.append(scene.background.radiance)
    return any(bool(np.any(np.asarray(colour) != 0)) for colour in sources)


def unlit_shapes(scene: Scene, model: ModelName) -> list[str]:
    """Shapes of the physical model that are nothing but matt, in a scene without light blocks that shine."""
    if model != "physical" or np.any(np.asarray(scene.lights.emissivity) != 0):
        return []

    def is_matt(shape: Block) -> bool:
        values = material_of(scene, shape).read_all(scene)
        shines = any(np.any(np.asarray(values[name]) != 0) for name in ("emission", "reflectivity", "transmission"))
        return bool(np.any(np.asarray(values["diffuse"]) != 0)) and not shines

    return [shape.name for shape in shape_blocks(scene) if is_matt(shape)]


def is_gray(scene: Scene) -> bool:
    """Whether nothing in a scene has a colour: its picture has three equal channels."""
    for kind in scene_kinds(scene):
        group = getattr(scene, kind.group)
        colours = [getattr(group, a.name) for a in kind.continuous if a.components == RGB]
        if not all(np.all(np.asarray(colour) == np.asarray(colour)[:1]) for colour in colours):
            return False
    return all(bool(jnp.all(texels == texels[:1])) for texels in scene.images.texels)


def unused_attributes(scene: Scene, model: ModelName) -> dict[ModelName, list[str]]:
    """What blocks of the scene set and this model does not have, as `glass.transmission`, by a model that has it."""
    found: dict[ModelName, list[str]] = {}
    for kind in scene_kinds(scene):
        group = getattr(scene, kind.group)
        for attribute in kind.continuous:
            if attribute.is_used_by(model) or not isinstance(attribute.default, tuple):
                continue
            values = np.asarray(getattr(group, attribute.name)).reshape(attribute.value_count, -1)
            is_set = np.any(values != np.reshape(attribute.default, (-1, 1)), axis=0)
            owners = (group.name,) if kind.is_single else group.names
            names = [f"{owners[column]}.{attribute.name}" for column in np.flatnonzero(is_set)]
            if names:
                found.setdefault(attribute.only_models[0], []).extend(names)
    return found
