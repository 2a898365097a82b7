"""The sets of pictures that a gallery shows: those of the source documents, and what glass can be.

A picture is a few settings, and for effects that belong to materials a few values, away from the whole model; or it has
a scene of its own.
Free of JAX, for the command line.
"""

import dataclasses
from collections.abc import Mapping
from typing import Literal

from raytrace_jax.report.gallery_glass import GLASS_SCENES
from raytrace_jax.scene.setting_words import ModelName

GallerySet = Literal["assignment", "checkpoints", "glass"]


@dataclasses.dataclass(frozen=True)
class Variant:
    """One picture of a gallery.

    Args:
        name: for its files, without a suffix.
        title: what it shows.
        switches: settings that differ from the gallery's.
        materials: attributes that have another value in all materials.
        text: of a scene of its own; empty where that of the gallery is meant.
    """

    name: str
    title: str
    switches: Mapping[str, object] = dataclasses.field(default_factory=dict)
    materials: Mapping[str, float] = dataclasses.field(default_factory=dict)
    text: str = ""


@dataclasses.dataclass(frozen=True)
class Gallery:
    """A set of pictures.

    Args:
        model: what they are made with.
        scene: the file, in the folder `data`, of which the source documents show them; empty where each picture has a
            scene of its own.
        columns: how many go into a row.
        variants: what they are.
    """

    model: ModelName
    scene: str
    columns: int
    variants: tuple[Variant, ...]


_ALPHA = {"reflectance": "none"}
_NO_TOTAL, _NO_SECOND = {"total_internal_reflection": False}, {"second_root": False}

GALLERIES: dict[GallerySet, Gallery] = {
    "assignment": Gallery(
        "classic",
        "vitreous",
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
        "checkpoints",
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
    "glass": Gallery(
        "physical",
        "",
        3,
        (
            Variant("1_clear", "clear: index 1.5168", text=GLASS_SCENES["clear"]),
            Variant("2_tinted", "tinted: red is absorbed most", text=GLASS_SCENES["tinted"]),
            Variant("3_dispersive", "dispersive: Abbe's number 8, a third of flint's", text=GLASS_SCENES["dispersive"]),
            Variant("4_bubble", "a bubble of air in it", text=GLASS_SCENES["bubble"]),
            Variant("5_two_balls", "two balls: index 1.31 before 1.85", text=GLASS_SCENES["two_balls"]),
            Variant("6_environment", "the sky alone around it", text=GLASS_SCENES["environment"]),
        ),
    ),
}
"""Galleries by the names that the command line takes."""
