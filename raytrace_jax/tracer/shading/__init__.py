"""Shading models: what a surface shows of its own, which rays it sends on, and how their colours come back."""

from raytrace_jax.scene.schema import ModelName
from raytrace_jax.tracer.shading import additive, classic
from raytrace_jax.tracer.shading.model import Model

MODELS: dict[ModelName, Model] = {"classic": classic.MODEL, "additive": additive.MODEL}
"""By the names of `RenderSettings.model`."""
