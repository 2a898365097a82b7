"""The settings of a picture, as they are asked for and as a scene has resolved them, and the models' rules.

The command line's help reads them, so that JAX is imported only where a scene is resolved.
"""

import dataclasses
import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

from ..errors import RaytraceWarning, SceneError, SettingsError
from ..scene import setting_words as words
from ..scene.setting_words import MAX_PICTURE_SIDE as MAX_SIDE
from ..util.checked import Checked, Wanted, listed_in_help, refuse_other

if TYPE_CHECKING:
    from ..scene.response import Frame
    from ..scene.scene import Scene

AovName = Literal["depth", "normal", "position", "shape_index", "bounce_count"]


class Aov(NamedTuple):
    """A variable of each pixel's own point: its channels, its value of a `PixelOutcome`, and that of a miss."""

    channels: tuple[str, ...]
    value: Callable[[Any], Any]
    missing: int = 0


AOVS: dict[str, Aov] = {
    "depth": Aov(("depth.Z",), lambda outcome: outcome.first.t),
    "normal": Aov(("normal.X", "normal.Y", "normal.Z"), lambda outcome: outcome.first.n),
    "position": Aov(("position.X", "position.Y", "position.Z"), lambda outcome: outcome.first.p),
    "shape_index": Aov(("shape_index.I",), lambda outcome: outcome.first.shape, missing=-1),
    "bounce_count": Aov(("bounce_count.I",), lambda outcome: outcome.bounce_count),
}
"""The AOVs, by the names of `RenderSettings.aov`."""

Precision = Literal[32, 64]
"""Bits of a scene's floating-point numbers and so of its pictures; the scene's arrays have them, not the settings."""


class ModelRules(NamedTuple):
    """A model's own values of settings that are left out, and its other rules of paths."""

    max_bounces: int
    path_limit: float
    planes_end_at_image_plane: bool
    mapping: words.PixelConvention
    least_weight: float
    only: dict[str, object]  # The settings that this model has no choice of, with the one value that they have.


_AS_REAL: dict[str, object] = {"reflectance": "schlick", "eta": "course", "total_internal_reflection": True}

MODEL_RULES: dict[words.ModelName, ModelRules] = {
    # Course model, 1.2: the length of paths, and where planes end.
    "classic": ModelRules(5, 100.0, True, "corner", 0.0, {"least_weight": 0.0}),
    "additive": ModelRules(2, math.inf, True, "corner", 0.0, {"least_weight": 0.0, **_AS_REAL}),
    # A ball's inner reflections weigh 0.04 to the power of their number: 1e-4 would show in every pixel.
    "physical": ModelRules(12, math.inf, False, "center", 1e-6, {**_AS_REAL, "second_root": True, "reflection": True}),
}
"""The models' rules; `levels.level.MODELS` has what they do with radiance."""


# The limits of settings as they are asked for and as they are resolved.
SAMPLES = Wanted(metavar="N", least=1, most=words.MAX_SAMPLES)
BOUNCES = Wanted(metavar="N", least=0, most=words.MAX_BOUNCES)
PATH_LIMIT = Wanted("a length greater than 0", "LENGTH", above=0)
LEAST_WEIGHT = Wanted(metavar="SHARE", least=0, below=1)


@listed_in_help
@dataclasses.dataclass(frozen=True, kw_only=True)
class RenderSettings(Checked):
    """Settings as they are asked for; None is what the scene's file says, or else the model's own.

    Raises:
        SettingsError: a value outside what is said below.
    """

    refused: ClassVar = SettingsError

    size: Annotated[
        tuple[int, int] | None,
        Wanted(f"(width, height), each 1 to {MAX_SIDE} pixels", "W H", least=1, most=MAX_SIDE),
    ] = None
    """Width and height of the picture in pixels; without it the camera's pixeldim."""
    crop: Annotated[
        tuple[int, int, int, int] | None, Wanted("(x, y, width, height), four whole numbers of pixels", "X Y W H")
    ] = None
    """Render only this window of the picture: its left and top pixel, its width and its height."""
    samples: Annotated[int | None, SAMPLES] = None
    """Samples per pixel and side: N renders an N x N grid within each pixel and averages it, 1 to 64. Without it 1."""
    mapping: words.PixelConvention | None = None
    """Where the pixels look. corner: pixel x at x / (width - 1) of the image plane, end points included, as the
    course has it; center: at (x + 1/2) / width, the centres of pixels that tile the image plane. Without it corner, in
    the physical model center."""
    reflectance: words.Reflectance | None = None
    """How reflected and transmitted light share a transparent surface. none: alpha blends the transmitted ray only;
    schlick: alpha blends both, weighted with Schlick's approximation of Fresnel's equations. Without it schlick."""
    eta: words.EtaConvention | None = None
    """The ratio of indices on leaving a shape. course: 1.000293 * ior, as the course's code has it; physical:
    ior / 1.000293. Entering is the same in both. Without it course."""
    max_bounces: Annotated[int | None, BOUNCES] = None
    """How often a path may bounce, 0 to 64; a ray that has bounced more often is black. Without it 5, in the additive
    model 2, in the physical one 12."""
    total_internal_reflection: bool = True
    """Reflect a ray that cannot leave a shape; off, it is lost (black)."""
    second_root: bool = True
    """Let rays inside of a sphere hit its far side; off, they miss it."""
    reflection: bool = True
    """Follow the mirror ray of the specular colour, in the additive model of the reflectivity; off, there is none."""
    aov: tuple[AovName, ...] = ()
    """More channels for the OpenEXR file: depth, normal, position, shape_index, bounce_count."""
    edges: words.EdgeMode | None = None
    """What a sample sees. point: one ray, as the course has it; aware: the area around it, edges blended smoothly.
    Without it what the scene's file says, or point; derivatives then are those of areas, and see edges move."""
    binning: Annotated[int, Wanted(metavar="N", least=1, most=64)] = 1
    """Render one large pixel for each N x N of the picture: a quick preview. A crop is counted in large pixels."""
    model: words.ModelName | None = None
    """The shading model. It also gives the defaults of what the scene's file leaves out. classic: the assignment's
    model; additive: that of the report on checkpoints 4 to 6, with shadows; physical: that of real glass. Without it
    that of the scene's file, else classic. What other options leave open the file says first, too."""
    path_limit: Annotated[float | None, PATH_LIMIT] = None
    """A longer path ends in black, in world units. Without it 100 in the classic model, infinite in the others."""
    least_weight: Annotated[float | None, LEAST_WEIGHT] = None
    """A ray that contributes less than this share to its pixel is black; 0 keeps all rays. Physical model only. Without
    it 1e-6."""
    rays_per_pixel: Annotated[float | None, Wanted(metavar="N", least=1, below=1e6)] = None
    """How many rays there is room for, on the mean of all pixels, within a transformation of JAX, where sizes are fixed
    before the scene is known. Without it 10, or with slabs 64, and edge-aware 20 to 80, the more the larger pixels are;
    of a crop up to ten times as many. Elsewhere there is room for all."""
    throw: bool = True
    """Raise an error where rays find no room; off, they are black, and the film's overflow counts them."""

    def __post_init__(self):
        super().__post_init__()
        for name, only in (MODEL_RULES[self.model].only if self.model else {}).items():
            value = getattr(self, name)
            if value is not None and value != only:
                able = " and ".join(model for model, rules in MODEL_RULES.items() if name not in rules.only)
                raise SettingsError(f"{name} is {value!r}, which has a meaning only in the {able} model.")


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

    samples: Annotated[int, SAMPLES] = 1
    mapping: words.PixelConvention = OF_MODEL
    reflectance: words.Reflectance = "schlick"
    eta: words.EtaConvention = "course"
    max_bounces: Annotated[int, BOUNCES] = OF_MODEL
    model: words.ModelName = "classic"
    path_limit: Annotated[float, PATH_LIMIT] = OF_MODEL
    least_weight: Annotated[float, LEAST_WEIGHT] = OF_MODEL

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

    def with_edges(self, edges: words.EdgeMode) -> "ResolvedSettings":
        """The settings, with `edges` where they say none: `point` of the picture itself, `aware` of its derivative."""
        return self if self.edges else dataclasses.replace(self, edges=edges)

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

    def frame(self, pixeldim: tuple[int, int]) -> "Frame":
        from ..scene.response import Frame

        left, top, _, _ = self.window(pixeldim)
        return Frame(left, top, self.binning, *self.picture_size(pixeldim))


def resolve_settings(scene: "Scene", asked: RenderSettings | None = None) -> ResolvedSettings:
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
    from ..scene.scene import check_scene

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
    names = [field.name for field in dataclasses.fields(RenderSettings)]
    said: dict[str, Any] = {name: getattr(scene.settings, name, None) for name in names}
    if said["model"] != model:
        said = {name: value for name, value in said.items() if name not in MODEL_RULES[model].only}
    if scene.slabs.names:  # Five surfaces of a tank send each path to and fro.
        said["rays_per_pixel"] = 64.0
    said |= {name: value for name in names if (value := getattr(asked, name)) is not None} | {"model": model}
    return ResolvedSettings(**{name: value for name, value in said.items() if value is not None})
