"""The pictures of the source documents: what goes wrong without a part of the model, and what each effect adds.

Each picture is a few settings, and for effects that belong to materials a few values, away from the whole model.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import ModelName
from raytrace_jax.tracer.derivatives import PictureDerivatives, picture_derivatives
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.settings import RenderSettings

SetName = Literal["assignment", "checkpoints"]


@dataclasses.dataclass(frozen=True)
class Variant:
    """One picture of a gallery.

    Args:
        name: for its files, without a suffix.
        title: what it shows.
        switches: settings that differ from the gallery's.
        materials: attributes that have another value in all materials.
    """

    name: str
    title: str
    switches: Mapping[str, object] = dataclasses.field(default_factory=dict)
    materials: Mapping[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Gallery:
    """A set of pictures: the model they are made with, how many go into a row, and what they are."""

    model: ModelName
    columns: int
    variants: tuple[Variant, ...]


_ALPHA = {"reflectance": "none"}
_NO_TOTAL, _NO_SECOND = {"total_internal_reflection": False}, {"second_root": False}

GALLERIES: dict[SetName, Gallery] = {
    "assignment": Gallery(
        "classic",
        3,
        (
            Variant(
                "1_no_total_internal_reflection_no_second_root",
                "no total internal reflection,\nno second root",
                {**_ALPHA, **_NO_TOTAL, **_NO_SECOND},
            ),
            Variant("2_no_total_internal_reflection", "no total internal reflection", {**_ALPHA, **_NO_TOTAL}),
            Variant("3_no_second_root", "no second root", {**_ALPHA, **_NO_SECOND}),
            Variant("4_no_reflection", "no reflection", {**_ALPHA, "reflection": False}),
            Variant("5_final", "final", _ALPHA),
            Variant("6_final_schlick", "final, with Schlick's approximation", {"reflectance": "schlick"}),
        ),
    ),
    "checkpoints": Gallery(
        "additive",
        2,
        (
            Variant(
                "4_without_reflection",
                "checkpoint 4: without reflection",
                {"reflection": False},
                {"fresnel": 0.0, "transmission": 0.0},
            ),
            Variant("4_reflection", "checkpoint 4: reflection", {}, {"fresnel": 0.0, "transmission": 0.0}),
            Variant("5_without_fresnel", "checkpoint 5: without Fresnel", {}, {"fresnel": 0.0, "transmission": 0.0}),
            Variant("5_fresnel", "checkpoint 5: Fresnel", {}, {"transmission": 0.0}),
            Variant("6_without_transmission", "checkpoint 6: without transmission", {}, {"transmission": 0.0}),
            Variant("6_transmission", "checkpoint 6: transmission"),
        ),
    ),
}
"""By the names that the command line takes."""


def render_gallery(
    scene: Scene, gallery: Gallery, settings: RenderSettings, wrt: tuple[str, ...] = ()
) -> Iterator[tuple[Variant, Scene, RenderSettings, PictureDerivatives]]:
    """Render the pictures of a gallery one after the other, each with the scene and the settings that made it.

    Args:
        scene: the scene; its materials' values change where a variant says so.
        gallery: which pictures.
        settings: for all of them, of the gallery's model; what a variant switches is changed.
        wrt: parameters with respect to which each picture is differentiated, with edges; none gives no derivatives.
    """
    for variant in gallery.variants:
        names = scene.materials.names
        changed = {f"{name}.{what}": value for what, value in variant.materials.items() for name in names}
        varied = set_parameters(scene, changed)
        how = dataclasses.replace(settings, **variant.switches)
        if wrt:
            how = dataclasses.replace(how, edges="aware")
            found = picture_derivatives(varied, wrt, how)
        else:
            image = np.asarray(render(varied, how).image)
            found = PictureDerivatives(image, (), np.zeros((0, *image.shape)))
        yield variant, varied, how, found
