"""The scenes of a plan, on which its names and values are tried before any work begins."""

from collections.abc import Callable, Iterator
from typing import Any

import jax

from raytrace_jax.batch.plan_file import Keys, PlanFile
from raytrace_jax.batch.plan_values import read_texts
from raytrace_jax.errors import ParameterError, RaytraceError
from raytrace_jax.scene.modelfile import format_scene, load_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.settings import RenderSettings


class PlanScenes:
    """The scenes that a plan file names, by the names that it has for them.

    Args:
        file: the plan.
        settings: what is rendered of each.

    Raises:
        PlanError: there is none, one comes twice, cannot be read, or is smaller than the crop.
    """

    def __init__(self, file: PlanFile, settings: RenderSettings):
        self.file = file
        self.model: ModelName = settings.model
        if "scenes" not in file.data:
            raise file.error((), 'names no scenes: it needs a line such as scenes = ["vitreous.txt"].')
        names = read_texts(file, ("scenes",), file.data["scenes"], "an array of file names")
        for name in names:
            if names.count(name) > 1:
                raise file.error(("scenes",), f"names {name} twice.")
        self.by_name = {name: self._load(name) for name in names}
        for name, scene in self.by_name.items():
            try:
                settings.window(scene.camera.pixeldim)
            except ValueError as reason:
                raise file.error(("settings", "crop"), f"{reason} (of {name}).") from None

    def __iter__(self) -> Iterator[Scene]:
        return iter(self.by_name.values())

    def texts(self) -> dict[str, str]:
        """The canonical text of each scene, with the same numbers as its file."""
        return {name: format_scene(scene, model=self.model) for name, scene in self.by_name.items()}

    def structures(self) -> dict[str, str]:
        """For each scene all that a compiled program depends on: scenes with equal ones share their programs."""
        return {name: str(jax.tree.structure(scene)) for name, scene in self.by_name.items()}

    def each(self, keys: Keys, attempt: Callable[[Scene], Any]) -> None:
        """Try something on every scene. Raises PlanError about the value in the plan where a parameter cannot be so."""
        for name, scene in self.by_name.items():
            try:
                attempt(scene)
            except ParameterError as reason:
                raise self.file.error(keys, f"{str(reason).rstrip('.')} (in {name}).") from None

    def _load(self, name: str) -> Scene:
        try:
            return load_scene(self.file.path.parent / name, model=self.model)
        except RaytraceError as reason:
            raise self.file.error(("scenes",), str(reason)) from None
