"""The kinds of shapes: one a file, and the table of them."""

from raytrace_jax.tracer.geometry.kind import ShapeKind
from raytrace_jax.tracer.geometry.kinds.plane import PLANE
from raytrace_jax.tracer.geometry.kinds.rectangle import RECTANGLE
from raytrace_jax.tracer.geometry.kinds.sphere import SPHERE

SHAPE_KINDS: dict[str, ShapeKind] = {"plane": PLANE, "sphere": SPHERE, "rectangle": RECTANGLE}
"""The kinds of shapes, by their keywords in a scene's file."""
