"""Shading models: what a surface shows of its own, which rays it sends on, and how their colours come back.

Each model is a module with the same functions: `shade`, `combine`, `child_weights`, `transparency`,
`relative_ior` and `nothing`.
"""

from raytrace_jax.tracer.shading import additive, classic

MODELS = {"classic": classic, "additive": additive}
"""By the names of `RenderSettings.model`."""
