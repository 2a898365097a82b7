"""The settings of a picture as a scene has resolved them: frozen, hashable, and static under `jax.jit`."""

import dataclasses
import math
import warnings
from typing import Annotated, Any

from ..errors import RaytraceWarning, SceneError, SettingsError
from ..scene import setting_words as words
from ..scene.response import Frame
from ..scene.scene import FileSettings, Scene, check_scene
from ..util.checked import Wanted, refuse_other
from .settings import MODEL_RULES, ModelRules, RenderSettings

SUBDIVISIONS = 2
"""A footprint may be cut into three so often.

Once less makes small pictures twice as wrong. Once more makes one scene of two half as wrong, for a third more rays
(experiments/tuning)."""

OF_MODEL: Any = None  # The default of a setting that `MODEL_RULES` fills.


@dataclasses.dataclass(frozen=True, kw_only=True)
class ResolvedSettings(RenderSettings):
    """The settings of a picture, each with its value: as asked for, else as the scene's file says, else the model's.

    `size` and `crop` are None where the picture is the camera's whole one. `edges` is None where the picture is that of
    points and its derivative that of areas. The defaults are the course's final image with Schlick's approximation.
    """

    samples: Annotated[int, Wanted(least=1, most=words.MAX_SAMPLES)] = 1
    mapping: words.PixelConvention = OF_MODEL
    reflectance: words.Reflectance = "schlick"
    eta: words.EtaConvention = "course"
    max_bounces: Annotated[int, Wanted(least=0, most=words.MAX_BOUNCES)] = OF_MODEL
    model: words.ModelName = "classic"
    path_limit: Annotated[float, Wanted("a length greater than 0", above=0)] = OF_MODEL
    least_weight: Annotated[float, Wanted(least=0, below=1)] = OF_MODEL

    def __post_init__(self):
        for name in ("mapping", "max_bounces", "path_limit", "least_weight"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(self.rules, name))
        super().__post_init__()

    @property
    def rules(self) -> ModelRules:
        return MODEL_RULES[self.model]

    @property
    def has_path_limit(self) -> bool:
        return math.isfinite(self.path_limit)

    @property
    def has_throughput(self) -> bool:
        return self.edges == "aware" or self.least_weight > 0

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
        where = {"size": None, "crop": None, "binning": 1, "mapping": "corner", "aov": ()}
        return dataclasses.replace(self, **where, samples=samples, rays_per_pixel=None, throw=True)

    @property
    def levels(self) -> int:
        """The number of levels below the camera's rays: one a bounce, and some more at edges."""
        # A path may pass edges and be subdivided so often in all; after that footprints see what their centre sees. One
        # less makes derivatives of one scene half as wrong again; one more changes nothing.
        return self.max_bounces + (2 + SUBDIVISIONS if self.edges == "aware" else 0)

    def picture_size(self, pixeldim: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the whole picture, before any crop or binning."""
        return self.size or pixeldim

    def window(self, pixeldim: tuple[int, int]) -> tuple[int, int, int, int]:
        """(x, y, width, height) of the rendered window in the whole picture.

        Raises SettingsError where the crop reaches outside of the picture or is empty.
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
        left, top, _, _ = self.window(pixeldim)
        return Frame(left, top, self.binning, *self.picture_size(pixeldim))


# The settings that a scene's file may say.
FILE_SETTINGS = tuple(field.name for field in dataclasses.fields(FileSettings) if field.name != "name")


def resolve_settings(scene: Scene, asked: RenderSettings | None = None) -> ResolvedSettings:
    """The settings of a scene's picture.

    Args:
        scene: its file's settings hold where others are not asked for. Rendered as another model than the file is for,
            what that model cannot be told is left out.
        asked: what is asked for; None is nothing. Settings that are resolved already stay as they are.

    Raises:
        SceneError, SettingsError: what is given is no scene, or no settings; or it has slabs, and the model none.

    Warns:
        RaytraceWarning: the scene was loaded as another model, whose defaults it has.
    """
    check_scene(scene)
    asked = RenderSettings() if asked is None else asked
    refuse_other(asked, RenderSettings)
    if isinstance(asked, ResolvedSettings):
        return asked
    model = asked.model or scene.model
    if model != scene.model:
        warnings.warn(
            f"this scene was loaded as {scene.model} and is rendered as {model}: attributes that its blocks leave "
            f"out have the defaults of the {scene.model} model. Load it with model={model!r}.",
            RaytraceWarning,
            stacklevel=3,
        )
    if scene.slabs.names and model != "physical":
        raise SceneError(f"slab {scene.slabs.names[0]!r}: the {model} model knows of no slabs; --model physical does.")
    said: dict[str, Any] = {name: getattr(scene.settings, name, None) for name in FILE_SETTINGS}
    if said["model"] != model:
        said = {name: value for name, value in said.items() if name not in MODEL_RULES[model].only}
    if scene.slabs.names:  # Five surfaces of a tank send each path to and fro.
        said["rays_per_pixel"] = 64.0
    given = {field.name: getattr(asked, field.name) for field in dataclasses.fields(RenderSettings)}
    said |= {name: value for name, value in given.items() if value is not None} | {"model": model}
    return ResolvedSettings(**{name: value for name, value in said.items() if value is not None})
