"""The settings of a picture, with nothing left open: frozen, hashable, and static under `jax.jit` (one compile each).

A picture is made as it is asked for, else as the scene's file says, else as the model has it.
"""

import dataclasses
import math
import warnings
from typing import Annotated

from raytrace_jax.errors import SceneWarning, SettingsError
from raytrace_jax.scene.response import Frame
from raytrace_jax.scene.scene import FileSettings, Scene, check_scene
from raytrace_jax.scene.setting_words import (
    MAX_SAMPLES,
    EdgeMode,
    EtaConvention,
    ModelName,
    PixelConvention,
    Reflectance,
)
from raytrace_jax.tracer.settings import MODEL_RULES, ModelRules, RenderSettings
from raytrace_jax.util.checked import Wanted

SUBDIVISIONS = 2
"""A footprint may be cut into three so often.

Once less makes small pictures twice as wrong. Once more makes one scene of two half as wrong, for a third more rays
(experiments/tuning)."""

EDGE_LEVELS = 2 + SUBDIVISIONS
"""A path may pass edges and be subdivided so often in all; after that footprints see what their centre sees.

One less makes derivatives of one scene half as wrong again; one more changes nothing (experiments/tuning)."""


@dataclasses.dataclass(frozen=True)
class ResolvedSettings(RenderSettings):
    """The settings of a picture as a scene has made them of `RenderSettings`, which explains them.

    What is still None here is the model's own, and known from it; without `edges` a picture is that of points, and its
    derivative that of areas. The defaults are the course's final image with Schlick's approximation.

    Raises:
        SettingsError: as `RenderSettings`.
    """

    samples: Annotated[int, Wanted(least=1, most=MAX_SAMPLES)] = 1
    mapping: PixelConvention | None = None
    reflectance: Reflectance = "schlick"
    eta: EtaConvention = "course"
    edges: EdgeMode | None = None
    model: ModelName = "classic"

    def __post_init__(self):
        super().__post_init__()
        if self.mapping is None:
            object.__setattr__(self, "mapping", self.rules.mapping)
        if self.max_bounces is None:
            object.__setattr__(self, "max_bounces", self.rules.max_bounces)

    @property
    def bounces(self) -> int:
        """The most bounces of a path: the model's own number, if the settings do not say."""
        return self.rules.max_bounces if self.max_bounces is None else self.max_bounces

    @property
    def rules(self) -> ModelRules:
        """The model's rules of paths."""
        return MODEL_RULES[self.model]

    @property
    def longest_path(self) -> float:
        """A path that is longer than this ends in black; infinite where paths do not end."""
        return self.rules.longest_path if self.path_limit is None else self.path_limit

    @property
    def has_longest_path(self) -> bool:
        """Whether paths end at some length."""
        return math.isfinite(self.longest_path)

    @property
    def weight_limit(self) -> float:
        """A ray that counts less than this in its pixel is black; 0 where all rays count."""
        return self.rules.least_weight if self.least_weight is None else self.least_weight

    @property
    def follows_weights(self) -> bool:
        """Whether rays know how much they count in their pixels."""
        return self.edges == "aware" or self.weight_limit > 0

    @property
    def of_points(self) -> "ResolvedSettings":
        """The settings of the picture itself: by points, where `edges` does not say."""
        return self if self.edges else dataclasses.replace(self, edges="point")

    @property
    def of_derivative(self) -> "ResolvedSettings":
        """The settings of the picture's derivative: by areas, where `edges` does not say."""
        return self if self.edges else dataclasses.replace(self, edges="aware")

    @property
    def of_rays(self) -> "ResolvedSettings":
        """The settings as far as they matter to rays: where pixels are, and how large, the rays know themselves."""
        samples = self.samples if self.edges == "aware" else 1
        return dataclasses.replace(self, size=None, crop=None, binning=1, mapping="corner", aov=(), samples=samples)

    @property
    def levels(self) -> int:
        """The number of levels below the camera's rays: one a bounce, and some more at edges."""
        return self.bounces + (EDGE_LEVELS if self.edges == "aware" else 0)

    def picture_size(self, pixeldim: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the whole picture, before any crop or binning."""
        return self.size or pixeldim

    def window(self, pixeldim: tuple[int, int]) -> tuple[int, int, int, int]:
        """(x, y, width, height) of the rendered window in the whole picture.

        Raises:
            SettingsError: the crop reaches outside of the picture or is empty.
        """
        width, height = (max(1, pixels // self.binning) for pixels in self.picture_size(pixeldim))
        if self.crop is None:
            return 0, 0, width, height
        x, y, crop_width, crop_height = self.crop
        if x < 0 or y < 0 or crop_width < 1 or crop_height < 1 or x + crop_width > width or y + crop_height > height:
            raise SettingsError(
                f"crop {self.crop} (x y width height) does not lie in the picture of {width} x {height}."
            )
        return self.crop

    def frame(self, pixeldim: tuple[int, int]) -> Frame:
        """The rendered part of the whole picture. Raises SettingsError as `window`."""
        left, top, _, _ = self.window(pixeldim)
        return Frame(left, top, self.binning, *self.picture_size(pixeldim))


FILE_SETTINGS = tuple(field.name for field in dataclasses.fields(FileSettings) if field.name != "name")
"""The settings that a scene's file may say."""


def resolve_settings(scene: Scene, asked: RenderSettings | None = None) -> ResolvedSettings:
    """The settings of a scene's picture, with nothing left open.

    Args:
        scene: its file's settings hold where others are not asked for. Rendered as another model than the file is for,
            what that model cannot be told is left out.
        asked: what is asked for; None is nothing. Settings that are resolved already stay as they are.

    Raises:
        SceneError: what is given is no scene.
        SettingsError: as `RenderSettings`; or what is asked for are no settings.

    Warns:
        SceneWarning: the scene was loaded as another model, whose defaults it has.
    """
    check_scene(scene)
    if asked is not None and not isinstance(asked, RenderSettings):
        written = ", ".join(f"{name}={value!r}" for name, value in asked.items()) if isinstance(asked, dict) else "..."
        raise SettingsError(f"settings are wanted, and this is {asked!r}: write RenderSettings({written}).")
    if isinstance(asked, ResolvedSettings):
        return asked
    asked = asked or RenderSettings()
    model = asked.model or scene.model
    if model != scene.model:
        warnings.warn(
            f"this scene was loaded as {scene.model} and is rendered as {model}: attributes that its blocks leave "
            f"out have the defaults of the {scene.model} model. Load it with model={model!r}.",
            SceneWarning,
            stacklevel=3,
        )
    only = MODEL_RULES[model].only
    said = {name: getattr(scene.settings, name, None) for name in FILE_SETTINGS}
    if said["model"] != model:
        said = {name: value for name, value in said.items() if name not in only}
    given = {field.name: getattr(asked, field.name) for field in dataclasses.fields(RenderSettings)}
    layers = {**said, **{name: value for name, value in given.items() if value is not None}, "model": model}
    return ResolvedSettings(**{name: value for name, value in layers.items() if value is not None})
