"""A scene's shapes and their materials, laid out for tracing: in the order of the file, whatever their kinds."""

import jax.numpy as jnp
from jaxtyping import Array

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.kinds import SHAPE_KINDS
from raytrace_jax.tracer.geometry.shapes import Shapes


def file_order(scene: Scene) -> list[int]:
    """For each shape in the order of the file its place in the list of all shapes kind by kind."""
    names = [name for kind in SHAPE_KINDS.values() for name in getattr(scene, kind.group).names]
    places = {name: place for place, name in enumerate(names)}
    return [places[name] for name in scene.shape_order]


def shape_kinds(scene: Scene) -> tuple[str, ...]:
    """The kind of each shape in the order of the file."""
    kinds = [keyword for keyword, kind in SHAPE_KINDS.items() for _ in getattr(scene, kind.group).names]
    return tuple(kinds[place] for place in file_order(scene))


def shape_materials(scene: Scene) -> list[int]:
    """The index of each shape's material in the order of the file."""
    used = [material for kind in SHAPE_KINDS.values() for material in getattr(scene, kind.group).material]
    return [used[place] for place in file_order(scene)]


def scene_shapes(scene: Scene) -> Shapes:
    """The coefficients of the implicit function for every shape of a scene."""
    order = jnp.asarray(file_order(scene), jnp.int32)
    groups = [kind.coefficients(getattr(scene, kind.group)) for kind in SHAPE_KINDS.values()]
    counts = [len(getattr(scene, kind.group).names) for kind in SHAPE_KINDS.values()]

    def gathered(name: str) -> Array:
        # Kinds of which there is none in the scene add nothing to what is compiled.
        parts = [group[name] for group, count in zip(groups, counts, strict=True) if count]
        return jnp.concatenate(parts or [groups[0][name]], -1)[..., order]

    def with_sides() -> Array | None:
        if not any(count and "axes" in group for group, count in zip(groups, counts, strict=True)):
            return None
        pairs = zip(groups, counts, strict=True)
        dtype = groups[0]["position"].dtype
        sides = [group.get("axes", jnp.zeros((2, 3, count), dtype)) for group, count in pairs]
        return jnp.concatenate(sides, -1)[..., order]

    kinds = shape_kinds(scene)
    names = list(SHAPE_KINDS)
    return Shapes(
        kinds=kinds,
        kind=jnp.asarray([names.index(kind) for kind in kinds], jnp.int32),
        position=gathered("position"),
        normal=gathered("normal"),
        curvature=gathered("curvature"),
        radius=gathered("radius"),
        axes=with_sides(),
    )
