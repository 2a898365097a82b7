"""The scenes of a plan, on which its names and values are tried before any work begins."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax

from raytrace_jax.batch.plan_file import Keys, PlanFile
from raytrace_jax.errors import ParameterError, RaytraceError, SettingsError
from raytrace_jax.scene.reader import load_scene
from raytrace_jax.scene.scene import Scene, fingerprint
from raytrace_jax.scene.writer import format_scene
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings


class PlannedScene(NamedTuple):
    """A scene of a plan as its jobs have it.

    Args:
        text: its canonical text.
        structure: what a compiled program depends on; equal for scenes that can share one.
        folder: where the paths of its textures begin.
        pictures: a fingerprint of these; empty where it has none.
    """

    text: str
    structure: str
    settings: ResolvedSettings
    folder: str
    pictures: str


class PlanScenes:
    """The scenes that a plan file names, by the names that it has for them.

    Args:
        names: the scenes' files.
        given: the settings that the plan gives; what it does not say each scene's file may.

    Raises:
        PlanError: one comes twice, cannot be read, cannot have these settings, or is smaller than the
            crop.

    Attributes:
        planned: the scenes as jobs have them, with the same numbers as their files.
    """

    def __init__(self, file: PlanFile, names: Sequence[str], given: RenderSettings):
        self.file, self.given = file, given
        for name in names:
            if names.count(name) > 1:
                raise file.error(("scenes",), f"names {name} twice.")
        self.by_name = {name: self._load(name) for name in names}
        self.planned = {name: self._planned(name, scene) for name, scene in self.by_name.items()}

    def each(self, keys: Keys, attempt: Callable[[Scene], Any]) -> None:
        """Try something on every scene. Raises PlanError about the value in the plan where a parameter cannot be so."""
        for name, scene in self.by_name.items():
            try:
                attempt(scene)
            except ParameterError as reason:
                raise self.file.error(keys, f"{str(reason).rstrip('.')} (in {name}).") from None

    def _load(self, name: str) -> Scene:
        try:
            return load_scene(self.file.path.parent / name, model=self.given.model)
        except RaytraceError as reason:
            raise self.file.error(("scenes",), str(reason)) from None

    def _settings(self, name: str, scene: Scene) -> ResolvedSettings:
        try:
            settings = resolve_settings(scene, self.given)
        except SettingsError as reason:
            raise self.file.error(("settings",), f"{str(reason).rstrip('.')} (of {name}).") from None
        try:
            settings.window(scene.camera.pixeldim)
        except SettingsError as reason:
            raise self.file.error(("settings", "crop"), f"{str(reason).rstrip('.')} (of {name}).") from None
        return settings

    def _planned(self, name: str, scene: Scene) -> PlannedScene:
        settings = self._settings(name, scene)
        folder = str((self.file.path.parent / name).parent.absolute())
        text, structure = format_scene(scene, model=settings.model), str(jax.tree.structure(scene))
        return PlannedScene(text, structure, settings, folder, fingerprint(scene))
