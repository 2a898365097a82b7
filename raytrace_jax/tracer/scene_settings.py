"""How the picture of a scene is made, as its file says."""

import dataclasses
from typing import Any

from raytrace_jax.scene.scene import FileSettings, Scene
from raytrace_jax.tracer.settings import MODEL_RULES, RenderSettings

FILE_SETTINGS = tuple(field.name for field in dataclasses.fields(FileSettings) if field.name != "name")
"""The settings that a scene's file may say."""


def scene_settings(scene: Scene, **given: Any) -> RenderSettings:
    """The settings that a scene's file asks for.

    Args:
        scene: what its settings do not say is the model's.
        given: settings by their names that hold in the place of the file's; None leaves one as it is. Of a file that is
            given another model, what that model cannot be told is left out.

    Raises:
        ValueError: as `RenderSettings`.
    """
    said = {} if scene.settings is None else {name: getattr(scene.settings, name) for name in FILE_SETTINGS}
    given = {name: value for name, value in given.items() if value is not None}
    own = said.get("model") or RenderSettings.model
    model = given.get("model", own)
    if model != own and model in MODEL_RULES:
        said = {name: value for name, value in said.items() if name not in MODEL_RULES[model].only}
    return RenderSettings(**{name: value for name, value in said.items() if value is not None} | given)
