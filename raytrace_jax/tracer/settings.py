"""What to render and how, apart from the scene: frozen, hashable, and static under `jax.jit` (one compile each)."""

import dataclasses
import math
from typing import Literal, NamedTuple, get_args

from raytrace_jax.scene.setting_words import (
    MAX_BOUNCES,
    MAX_SAMPLES,
    EdgeMode,
    EtaConvention,
    ModelName,
    PixelConvention,
    Reflectance,
)
from raytrace_jax.tracer.aovs import AOVS

Precision = Literal[32, 64]
"""Bits of a scene's floating-point numbers and so of its pictures; the scene's arrays have them, not the settings."""


class ModelRules(NamedTuple):
    """What a model says of paths, apart from light.

    Args:
        max_bounces: how often a path may bounce, if the settings do not say.
        longest_path: a longer path ends in black, in world units; infinite where paths do not end.
        planes_end_at_image_plane: planes are not seen where z > 0.
        mapping: where pixels look, if the settings do not say.
        least_weight: a ray that counts less in its pixel is black; 0 where all rays count.
        only: the settings that this model has no choice of, with the one value that says nothing.
    """

    max_bounces: int
    longest_path: float
    planes_end_at_image_plane: bool
    mapping: PixelConvention
    least_weight: float
    only: dict[str, object]


MODEL_RULES: dict[ModelName, ModelRules] = {
    # Course model, 1.2: the length of paths, and where planes end.
    "classic": ModelRules(5, 100.0, True, "corner", 0.0, {"least_weight": None}),
    "additive": ModelRules(
        2,
        math.inf,
        True,
        "corner",
        0.0,
        {"least_weight": None, "reflectance": "schlick", "eta": "course", "total_internal_reflection": True},
    ),
    # A ball's inner reflections weigh 0.04 to the power of their number: 1e-4 would show in every pixel.
    "physical": ModelRules(
        12,
        math.inf,
        False,
        "center",
        1e-6,
        {
            "reflectance": "schlick",
            "eta": "course",
            "total_internal_reflection": True,
            "second_root": True,
            "reflection": True,
        },
    ),
}
"""The models' rules; `shading.models` has what they do with light."""

SUBDIVISIONS = 2
"""How often a footprint may be cut into three. Once less makes small pictures twice as wrong; once more, on
one scene of two, half as wrong for a third more rays (experiments/tuning)."""

EDGE_LEVELS = 2 + SUBDIVISIONS
"""How many edges a path may pass and how often it may be subdivided, in all; then edges are seen by their centre. One
less makes derivatives of one scene half as wrong again, one more changes nothing (experiments/tuning)."""


CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(words)
    for name, words in {
        "mapping": PixelConvention,
        "model": ModelName,
        "edges": EdgeMode,
        "reflectance": Reflectance,
        "eta": EtaConvention,
    }.items()
}
"""The settings that are one of a few words, and these words."""


@dataclasses.dataclass(frozen=True)
class RenderSettings:
    """Settings of a picture; the defaults are the course's final image with Schlick's approximation.

    Args:
        size: (width, height) in pixels; None takes the camera's `pixeldim`.
        crop: (x, y, width, height) of the window to render, in pixels from the top left of the picture; None is all.
        binning: n renders one pixel for each n x n pixels of the picture: as wide, and looking at their middle. Rows
            and columns that do not fill a pixel are left out. A crop counts the large pixels.
        samples: n renders an n x n grid of sub-pixel samples and averages them.
        edges: what a sample sees. `point`: one ray, so that pictures jump where an edge crosses it; `aware`: the area
            around it, each edge blended by the share of the area on either side (see `visibility`).
        mapping: where the pixels look. `corner`: the course's, pixel x looks at x / (width - 1) of the image plane, end
            points included; `center`: (x + 1/2) / width, the centres of pixels that tile the image plane. None takes
            the model's own: `center` in the physical one, `corner` in the course's.
        model: what a surface does with light. `classic`: the assignment's (see `shading.classic`); `additive`: that of
            the report on checkpoints 4 to 6 (see `shading.additive`); `physical`: that of real glass (see
            `shading.physical`). The latter two have no choice of `reflectance`, `eta` and `total_internal_reflection`;
            their materials have what takes their place.
        reflectance: how reflected and transmitted light share a transparent surface. `none`: alpha blends the
            transmitted ray only; `schlick`: alpha blends both, weighted with Schlick's approximation.
        eta: the ratio of indices on leaving a shape. `course`: `1.000293 * ior`, as the course's code has it;
            `physical`: `ior / 1.000293`. Entering is the same in both.
        max_bounces: how often a path may bounce; a ray that has bounced more often is black. None takes the model's own
            number: 5 in the classic model, 2 in the additive one, 12 in the physical one.
        path_limit: a longer path ends in black, in world units. None takes the model's own: 100 in the classic model,
            none in the others.
        least_weight: a ray that counts less than this share of its pixel is black, and 0 keeps them all: the physical
            model's only. None takes 1e-6 there.
        total_internal_reflection: off, a ray that cannot leave is lost (black).
        second_root: off, a sphere is hit only at the nearer root, so that rays inside of it pass its far side unseen.
        reflection: off, there is no mirror ray: that of the specular colour in the classic model, that of the
            reflectivity in the additive one.
        aov: which arbitrary output variables to compute, names of `aovs.AOVS`.

    Raises:
        ValueError: a value outside what is said above.
    """

    size: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None
    samples: int = 1
    mapping: PixelConvention | None = None
    reflectance: Reflectance = "schlick"
    eta: EtaConvention = "course"
    max_bounces: int | None = None
    total_internal_reflection: bool = True
    second_root: bool = True
    reflection: bool = True
    aov: tuple[str, ...] = ()
    edges: EdgeMode = "point"
    binning: int = 1
    model: ModelName = "classic"
    path_limit: float | None = None
    least_weight: float | None = None

    def __post_init__(self):
        if self.model in MODEL_RULES and self.mapping is None:
            object.__setattr__(self, "mapping", self.rules.mapping)
        for name, words in CHOICES.items():
            if getattr(self, name) not in words:
                raise ValueError(f"{name} is {getattr(self, name)!r}; it can be {' or '.join(words)}")
        for name, only in self.rules.only.items():
            if getattr(self, name) != only:
                able = " and ".join(model for model, rules in MODEL_RULES.items() if name not in rules.only)
                raise ValueError(f"{name} is {getattr(self, name)!r}, which only the {able} model can be told")
        if self.max_bounces is None:
            object.__setattr__(self, "max_bounces", self.rules.max_bounces)
        if self.path_limit is not None and not self.path_limit > 0:
            raise ValueError(f"path_limit is {self.path_limit}; it can be any length greater than 0")
        if self.least_weight is not None and not 0 <= self.least_weight < 1:
            raise ValueError(f"least_weight is {self.least_weight}; it can be any number from 0 to less than 1")
        for name, least, most in (("samples", 1, MAX_SAMPLES), ("max_bounces", 0, MAX_BOUNCES), ("binning", 1, 64)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}; it can be {least} to {most}")
        if self.size is not None and not (len(self.size) == 2 and all(1 <= n <= 32768 for n in self.size)):
            raise ValueError(f"size is {self.size}; it is a width and a height, each 1 to 32768 pixels")
        for name in self.aov:
            if name not in AOVS:
                raise ValueError(f"aov {name!r} is unknown; there are {', '.join(AOVS)}")

    @property
    def bounces(self) -> int:
        """How often a path may bounce, never None."""
        assert self.max_bounces is not None
        return self.max_bounces

    @property
    def rules(self) -> ModelRules:
        """What the model says of paths."""
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
    def levels(self) -> int:
        """How many levels of rays follow the camera's: one a bounce, and some more at edges."""
        return self.bounces + (EDGE_LEVELS if self.edges == "aware" else 0)

    def picture_size(self, pixeldim: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the whole picture, before any crop or binning."""
        return self.size or pixeldim

    def window(self, pixeldim: tuple[int, int]) -> tuple[int, int, int, int]:
        """(x, y, width, height) of the rendered window in the whole picture.

        Raises:
            ValueError: the crop reaches outside of the picture or is empty.
        """
        width, height = (max(1, pixels // self.binning) for pixels in self.picture_size(pixeldim))
        if self.crop is None:
            return 0, 0, width, height
        x, y, crop_width, crop_height = self.crop
        if x < 0 or y < 0 or crop_width < 1 or crop_height < 1 or x + crop_width > width or y + crop_height > height:
            raise ValueError(f"crop {self.crop} (x y width height) does not lie in the picture of {width} x {height}")
        return self.crop
