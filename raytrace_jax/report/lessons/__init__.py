"""Figures for teaching, made by the library itself: one lesson a module, with the text that goes with its figure."""

from typing import Literal

LessonName = Literal["snell", "fresnel", "critical", "ball", "total_reflection", "edges", "cost"]
"""The lessons of `lessons.page`; here, where nothing imports JAX, for the command line."""
