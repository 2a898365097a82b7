"""Galleries: pictures rendered one after the other, and a labelled sheet of them."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from ..images import Transfer
from ..scene.parameters import blocks_of, set_parameters
from ..scene.scene import Scene
from ..scene.setting_words import ModelName
from ..tracer.rendering import PictureDerivatives, picture_derivatives, render
from ..tracer.settings import ResolvedSettings
from . import GallerySet
from .derivatives import draw_signed, scale_limit
from .panels import as_pixels, panel_bands

_GLASS = """
settings main {{ model physical samples 4 least_weight 1e-4 }}
camera eye {{ pixeldim 480 360 viewpoint 0 0.35 5.2 lookat 0 -0.02 0 up 0 1 0 fov 30 }}
background sky {{ radiance 1 1 1 texture evening }}
texture evening {{ kind image file sky.exr wrap repeat }}
texture squares {{ kind checker color1 0.05 0.10 0.16 color2 0.72 0.68 0.60 square 0.4 offset 0.13 0.07 }}
material board {{ emission 1 1 1 texture squares }}
material glass {{ transmission 1 {glass} }}
{board}
sphere ball {{ material glass center {ball} }}
{more}
"""

_BOARD = "rectangle backdrop { material board center 0 0 -2.2 right 4 0 0 up 0 3 0 }"
_BUBBLE = "material air { transmission 1 ior 1 }\nsphere bubble { material air center 0.3 0.12 0.3 radius 0.42 }"
_CROWN = "-0.5 0.1 0.35 radius 0.72"
_FLINT = "material flint { transmission 1 ior 1.85 }\nsphere far { material flint center 0.75 -0.1 -0.85 radius 0.72 }"


def _scene(glass: str = "ior 1.5168", more: str = "", board: str = _BOARD, ball: str = "0 0 0 radius 1") -> str:
    """A scene file's text; `sky.exr` lies with the scenes that come with the package."""
    return _GLASS.format(glass=glass, more=more, board=board, ball=ball)


class Variant(NamedTuple):
    """One picture of a gallery, away from the whole model by a few settings and a few values."""

    name: str  # For its files, without a suffix.
    title: str
    switches: Mapping[str, object] = {}  # Settings unlike the gallery's.
    materials: Mapping[str, float] = {}  # Attributes of all materials.
    text: str = ""  # Of a scene of its own; empty where that of the gallery is meant.


class Gallery(NamedTuple):
    """A set of pictures, drawn `columns` in a row."""

    model: ModelName
    scene: str  # The file in the folder `data`; empty where each picture has a scene of its own.
    columns: int
    variants: tuple[Variant, ...]


_ALPHA, _NO_TOTAL, _NO_SECOND = {"reflectance": "none"}, {"total_internal_reflection": False}, {"second_root": False}
_NEITHER = "no total internal reflection,\nno second root"
_NO_GLASS = {"fresnel": 0.0, "transmission": 0.0}

_ASSIGNMENT = (
    Variant("1_no_total_internal_reflection_no_second_root", _NEITHER, _ALPHA | _NO_TOTAL | _NO_SECOND),
    Variant("2_no_total_internal_reflection", "no total internal reflection", _ALPHA | _NO_TOTAL),
    Variant("3_no_second_root", "no second root", _ALPHA | _NO_SECOND),
    Variant("4_no_reflection", "no reflection", _ALPHA | {"reflection": False}),
    Variant("5_final", "final", _ALPHA),
    Variant("6_final_schlick", "final, with Schlick's approximation", {"reflectance": "schlick"}),
)
_CHECKPOINTS = (
    Variant("4_without_reflection", "checkpoint 4: without reflection", {"reflection": False}, _NO_GLASS),
    Variant("4_reflection", "checkpoint 4: reflection", {}, _NO_GLASS),
    Variant("5_without_fresnel", "checkpoint 5: without Fresnel", {}, _NO_GLASS),
    Variant("5_fresnel", "checkpoint 5: Fresnel", {}, {"transmission": 0.0}),
    Variant("6_without_transmission", "checkpoint 6: without transmission", {}, {"transmission": 0.0}),
    Variant("6_transmission", "checkpoint 6: transmission"),
)
_BALLS = (
    Variant("1_clear", "clear: index 1.5168", text=_scene()),
    Variant("2_tinted", "tinted: red is absorbed most", text=_scene("ior 1.5168 absorption 0.75 0.22 0.10")),
    Variant("3_dispersive", "dispersive: Abbe's number 8, a third of flint's", text=_scene("ior 1.78 abbe 8")),
    Variant("4_bubble", "a bubble of air in it", text=_scene(more=_BUBBLE)),
    Variant("5_two_balls", "two balls: index 1.31 before 1.85", text=_scene("ior 1.31", _FLINT, ball=_CROWN)),
    Variant("6_environment", "the sky alone around it", text=_scene(board="")),
)
GALLERIES: dict[GallerySet, Gallery] = {
    "assignment": Gallery("classic", "vitreous", 3, _ASSIGNMENT),
    "checkpoints": Gallery("additive", "checkpoints", 2, _CHECKPOINTS),
    "glass": Gallery("physical", "", 3, _BALLS),
}
"""Galleries by the names that the command line takes."""


def render_gallery(
    scene_of: Callable[[Variant], Scene], gallery: Gallery, settings: ResolvedSettings, wrt: tuple[str, ...] = ()
) -> Iterator[tuple[Variant, Scene, ResolvedSettings, PictureDerivatives]]:
    """Render the pictures of a gallery one after the other, each with the scene and the settings that made it.

    Each is differentiated with respect to the parameters `wrt`, with edges, if there are any.
    """
    for variant in gallery.variants:
        scene = scene_of(variant)
        materials = [block.name for block in blocks_of(scene, "material")]
        changed = {f"{name}.{what}": value for what, value in variant.materials.items() for name in materials}
        varied = set_parameters(scene, changed)
        how = dataclasses.replace(settings, **variant.switches)
        if wrt:
            how = dataclasses.replace(how, edges="aware")
            found = picture_derivatives(varied, wrt, how)
        else:
            image = render(varied, how).image
            found = PictureDerivatives(image, (), image[None][:0])
        yield variant, varied, how, found


def draw_gallery(
    titles: Sequence[str], pictures: Sequence[PictureDerivatives], columns: int, transfer: Transfer = "course"
) -> Figure:
    """Draw pictures of one size in rows of `columns`; each derivative has one colour scale for all of them."""
    names = pictures[0].names
    _, height, width = pictures[0].image.shape
    rows_each = 1 + len(names)
    figure, axes = panel_bands(
        len(pictures), columns, rows_each, 3.6, (3.24 * height / width + 0.3) * rows_each + 0.8 * len(names)
    )
    derivatives = [np.asarray(picture.values) for picture in pictures]
    limits = [max(scale_limit(values[k]) for values in derivatives) or 1.0 for k in range(len(names))]
    for (shown, *below), title, picture, values in zip(axes, titles, pictures, derivatives, strict=True):
        shown.imshow(as_pixels(picture.image, transfer))
        shown.set_title(title, fontsize=9)
        for k, ax in enumerate(below):
            draw_signed(ax, values[k], limits[k], picture.units[k], f"d.{names[k]}")
    return figure
