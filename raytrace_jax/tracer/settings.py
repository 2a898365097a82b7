"""What to render and how, as it is asked for, and what the models say of it."""

import dataclasses
import math
from numbers import Integral
from typing import Literal, NamedTuple, get_args

from raytrace_jax.errors import SettingsError
from raytrace_jax.scene.setting_words import (
    MAX_BOUNCES,
    MAX_PICTURE_SIDE,
    MAX_SAMPLES,
    EdgeMode,
    EtaConvention,
    ModelName,
    PixelConvention,
    Reflectance,
)
from raytrace_jax.tracer.aovs import AOVS
from raytrace_jax.util.words import did_you_mean

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
"""The settings whose values are words, and the words of each."""

WHOLE_NUMBERS = {"samples": (1, MAX_SAMPLES), "max_bounces": (0, MAX_BOUNCES), "binning": (1, 64)}
"""The settings that are a whole number, with the least and the most that they can be."""


@dataclasses.dataclass(frozen=True)
class RenderSettings:
    """What to render and how, as it is asked for; None is what the scene's file says, or else the model's own.

    A scene makes `ResolvedSettings` of it, in which nothing is left open (`resolved_settings.resolve_settings`).

    Args:
        size: (width, height) in pixels; None takes the camera's `pixeldim`.
        crop: (x, y, width, height) of the window to render, in pixels from the top left of the picture; None is all.
        binning: n renders one large pixel for each n x n pixels of the picture. It covers their area and looks at their
            middle. Rows and columns that do not fill a large pixel are left out. A crop is counted in large pixels.
        samples: n renders an n x n grid of sub-pixel samples and averages them; else 1.
        edges: what a sample sees. `point`: one ray, so that pictures jump where an edge crosses it; `aware`: the area
            around it, each edge blended by the share of the area on either side (see `visibility`). None: pictures
            are those of points, and their derivatives those of areas, so that they contain the motion of edges.
        mapping: where the pixels look. `corner`: the course's, pixel x looks at x / (width - 1) of the image plane, end
            points included; `center`: (x + 1/2) / width, the centres of pixels that tile the image plane. The
            physical model's own is `center`, the others' `corner`.
        model: what a surface does with light. `classic`: the assignment's (see `shading.classic`); `additive`: that of
            the report on checkpoints 4 to 6 (see `shading.additive`); `physical`: that of real glass (see
            `shading.physical`). Else the model with which the scene was loaded. `additive` and `physical` have no
            choice of `reflectance`, `eta` and `total_internal_reflection`; attributes of their materials replace these.
        reflectance: how reflected and transmitted light share a transparent surface. `none`: alpha blends the
            transmitted ray only; `schlick`: alpha blends both, weighted with Schlick's approximation. Else `schlick`.
        eta: the ratio of indices on leaving a shape. `course`: `1.000293 * ior`, as the course's code has it;
            `physical`: `ior / 1.000293`. Entering is the same in both. Else `course`.
        max_bounces: how often a path may bounce; a ray that has bounced more often is black. The model's own number
            is 5 in the classic model, 2 in the additive one, 12 in the physical one.
        path_limit: the longest path, in world units; a longer one ends in black. The model's own is 100 in the classic
            model; the others have no limit.
        least_weight: a ray that contributes less than this share to its pixel is black; 0 keeps all rays. It belongs to
            the physical model only, whose own is 1e-6.
        total_internal_reflection: off, a ray that cannot leave is lost (black).
        second_root: off, a sphere is hit only at the nearer root of the quadratic; rays inside it miss its far side.
        reflection: off, there is no mirror ray. In the classic model the mirror ray is that of the specular colour, in
            the additive one that of the reflectivity.
        aov: which arbitrary output variables to compute, names of `aovs.AOVS`.

    Raises:
        SettingsError: a value outside what is said above.
    """

    size: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None
    samples: int | None = None
    mapping: PixelConvention | None = None
    reflectance: Reflectance | None = None
    eta: EtaConvention | None = None
    max_bounces: int | None = None
    total_internal_reflection: bool = True
    second_root: bool = True
    reflection: bool = True
    aov: tuple[str, ...] = ()
    edges: EdgeMode | None = None
    binning: int = 1
    model: ModelName | None = None
    path_limit: float | None = None
    least_weight: float | None = None

    def __post_init__(self):
        for name, words in CHOICES.items():
            value = getattr(self, name)
            if value is not None and value not in words:
                close = did_you_mean(str(value), words)
                raise SettingsError(f"{name} is {value!r}; it can be {' or '.join(words)}.{close}")
        for name, (least, most) in WHOLE_NUMBERS.items():
            value = getattr(self, name)
            if value is not None and not _is_row((value,), 1, least, most):
                raise SettingsError(f"{name} is {value!r}; it can be {least} to {most}.")
        if self.path_limit is not None and not self.path_limit > 0:
            raise SettingsError(f"path_limit is {self.path_limit!r}; it can be any length greater than 0.")
        if self.least_weight is not None and not 0 <= self.least_weight < 1:
            raise SettingsError(f"least_weight is {self.least_weight!r}; it can be any number from 0 to less than 1.")
        if self.size is not None and not _is_row(self.size, 2, 1, MAX_PICTURE_SIDE):
            raise SettingsError(f"size is {self.size!r}; it is (width, height), each 1 to {MAX_PICTURE_SIDE} pixels.")
        if self.crop is not None and not _is_row(self.crop, 4):
            raise SettingsError(f"crop is {self.crop!r}; it is (x, y, width, height), four whole numbers of pixels.")
        if isinstance(self.aov, str):
            raise SettingsError(f"aov is {self.aov!r}; it is a tuple of names, such as ({self.aov!r},).")
        for name in self.aov:
            if name not in AOVS:
                raise SettingsError(f"aov {name!r} is unknown; there are {', '.join(AOVS)}.")
        for name, only in (MODEL_RULES[self.model].only if self.model else {}).items():
            value = getattr(self, name)
            if value is not None and value != only:
                able = " and ".join(model for model, rules in MODEL_RULES.items() if name not in rules.only)
                raise SettingsError(f"{name} is {value!r}, which has a meaning only in the {able} model.")


def _is_row(value: object, count: int, least: int | None = None, most: int | None = None) -> bool:
    """Whether a value is a tuple of so many whole numbers, none beyond its limits."""
    if not (isinstance(value, tuple) and len(value) == count):
        return False
    whole = all(isinstance(n, Integral) and not isinstance(n, bool) for n in value)
    return whole and (least is None or most is None or all(least <= n <= most for n in value))
