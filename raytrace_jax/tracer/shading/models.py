"""The table of shading models: a new one is a file beside this one and a row here."""

from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.shading import additive, classic, physical
from raytrace_jax.tracer.shading.model import Model

MODELS: dict[ModelName, Model] = {
    "classic": classic.MODEL,
    "additive": additive.MODEL,
    "physical": physical.MODEL,
}
"""The models, by the names of `RenderSettings.model`."""
