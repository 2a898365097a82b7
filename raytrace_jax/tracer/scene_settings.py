"""How the picture of a scene is made: as it is asked for, else as its file says."""

import dataclasses
import warnings

from raytrace_jax.errors import SceneWarning
from raytrace_jax.scene.scene import FileSettings, Scene
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.settings import MODEL_RULES, RenderSettings

FILE_SETTINGS = tuple(field.name for field in dataclasses.fields(FileSettings) if field.name != "name")
"""The settings that a scene's file may say."""


def resolve_settings(scene: Scene, asked: RenderSettings | None = None) -> ResolvedSettings:
    """The settings of a scene's picture, with nothing left open.

    Args:
        scene: its file's settings hold where others are not asked for. Rendered as another model than the file is for,
            what that model cannot be told is left out.
        asked: what is asked for; None is nothing. Settings that are resolved already stay as they are.

    Raises:
        SettingsError: as `RenderSettings`.

    Warns:
        SceneWarning: the scene was loaded as another model, whose defaults it has.
    """
    if isinstance(asked, ResolvedSettings):
        return asked
    asked = asked or RenderSettings()
    model = asked.model or scene.model
    if model != scene.model:
        warnings.warn(
            f"this scene was loaded as {scene.model} and is rendered as {model}: what its blocks leave out has the "
            f"defaults of the {scene.model} model. Load it with model={model!r}.",
            SceneWarning,
            stacklevel=3,
        )
    only = MODEL_RULES[model].only
    said = {name: getattr(scene.settings, name, None) for name in FILE_SETTINGS}
    if said["model"] != model:
        said = {name: value for name, value in said.items() if name not in only}
    given = {field.name: getattr(asked, field.name) for field in dataclasses.fields(asked)}
    layers = {**said, **{name: value for name, value in given.items() if value is not None}, "model": model}
    return ResolvedSettings(**{name: value for name, value in layers.items() if value is not None})
