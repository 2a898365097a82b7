"""The settings of a picture as they are asked for, and the models' rules; free of JAX, for the command line."""

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from ..errors import SettingsError
from ..scene import setting_words as words
from ..scene.setting_words import MAX_PICTURE_SIDE as MAX_SIDE
from ..util.checked import Checked, Wanted

AovName = Literal["depth", "normal", "position", "shape_index", "bounce_count"]


class Aov(NamedTuple):
    """A variable of each pixel's own point: its channels, its value of an `integrator.Outcome`, and that of a miss."""

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
    samples: Annotated[int | None, Wanted(metavar="N", least=1, most=words.MAX_SAMPLES)] = None
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
    max_bounces: Annotated[int | None, Wanted(metavar="N", least=0, most=words.MAX_BOUNCES)] = None
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
    model; additive: that of the report on checkpoints 4 to 6, with shadows; physical: that of real glass. Default: the
    settings in the scene's file, else classic. For the other options, too, the file's settings come first."""
    path_limit: Annotated[float | None, Wanted("a length greater than 0", "LENGTH", above=0)] = None
    """A longer path ends in black, in world units. Without it 100 in the classic model, infinite in the others."""
    least_weight: Annotated[float | None, Wanted(metavar="SHARE", least=0, below=1)] = None
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
