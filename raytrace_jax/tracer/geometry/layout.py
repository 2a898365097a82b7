"""A scene's shapes and their materials, laid out for tracing: in the order of the file, whatever their kinds."""

import jax.numpy as jnp
from jaxtyping import Array

from raytrace_jax.scene.parameters import shape_blocks
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.util.numerics import with_lower_ranks


def shape_materials(scene: Scene) -> list[int]:
    """The index of each shape's material in the order of the file."""
    return [shape.read(scene, "material") for shape in shape_blocks(scene)]


@with_lower_ranks
def scene_shapes(scene: Scene) -> Shapes:
    """The coefficients of the implicit function for every shape of a scene."""
    groups = [getattr(scene, BLOCK_TYPES[keyword][0].group) for keyword in SHAPE_KINDS]
    # The place of each shape, in the order of the file, in the list of all shapes kind by kind.
    places = {name: place for place, name in enumerate(name for group in groups for name in group.names)}
    order = jnp.asarray([places[name] for name in scene.shape_order], jnp.int32)
    found = [kind.coefficients(group) for kind, group in zip(SHAPE_KINDS.values(), groups, strict=True)]
    # Kinds of which there is none in the scene add nothing to what is compiled.
    found = [one for one, group in zip(found, groups, strict=True) if group.names] or found[:1]

    def gathered(name: str) -> Array:
        return jnp.concatenate([one[name] for one in found], -1)[..., order]

    if any("axes" in one for one in found):
        for one in found:
            one.setdefault("axes", jnp.zeros((2, *one["position"].shape), one["position"].dtype))
    kinds, known = tuple(shape.keyword for shape in shape_blocks(scene)), list(SHAPE_KINDS)
    return Shapes(
        kinds=kinds,
        kind=jnp.asarray([known.index(kind) for kind in kinds], jnp.int32),
        position=gathered("position"),
        normal=gathered("normal"),
        curvature=gathered("curvature"),
        radius=gathered("radius"),
        axes=gathered("axes") if "axes" in found[0] else None,
    )
