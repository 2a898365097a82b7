"""Figures and files for people: fit reports, derivative sheets, galleries, ray trees, lessons.

The words that the command line offers stand here, where nothing imports JAX.
"""

from typing import Literal

GallerySet = Literal["assignment", "checkpoints", "glass"]
LessonName = Literal[
    "ray", "snell", "fresnel", "critical", "half_disc", "prism", "lens", "ball", "dispersion", "total_reflection",
    "edges", "cost",
]  # fmt: skip
