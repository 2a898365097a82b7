"""Glass that rays cannot tell from what is next to it: surfaces that coincide, and cameras on a surface."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from ..scene.parameters import material_of, shape_blocks
from ..scene.scene import Scene, least_distance, world_length
from ..scene.slabs import with_planes
from ..util.compilation import jit
from .geometry.shape_types import SHAPE_TYPES, face_owners, scene_shapes
from .geometry.shapes import Shapes, surface_value
from .geometry.solid import middles
from .settings import ResolvedSettings, resolve_settings


def indistinct_glass(scene: Scene) -> list[str]:
    """Warnings of glass, in the physical model, that is nearer to another surface or to a camera than rays can tell."""
    views = (scene.seen_by(name) for name in scene.cameras)
    return list(dict.fromkeys(sentence for view in views for sentence in _in_view(view)))


def _in_view(given: Scene) -> list[str]:
    scene = with_planes(given)
    blocks = shape_blocks(scene)
    solid = np.array([SHAPE_TYPES[shape.type.group].has_inside for shape in blocks], bool)
    clear = np.array([material_of(scene, shape).read(scene, "transmission") != 0 for shape in blocks], bool)
    glass = solid & clear
    if not glass.any():
        return []
    length = float(world_length(scene))
    least = float(least_distance(world_length(scene) / 10))
    shapes, heights = jax.tree.map(np.asarray, _heights(scene, resolve_settings(given)))
    names, on_surface = [shape.name for shape in blocks], np.abs(heights[-1]) < least
    near = [
        (f"the camera {scene.camera.name}", f"the surface of {names[k]}") for k in np.flatnonzero(glass & on_surface)
    ]

    rows, owners = _lengths(shapes, np.asarray(scene.camera.viewpoint), length), face_owners(given)
    pairs, shape_of = set(), shapes.owners
    for i, j in KDTree(rows).query_pairs(least):
        a, b = sorted((shape_of[i], shape_of[j]))
        # Two planes of a slab coincide where it has no wall, which is drawn as it is.
        is_no_wall = np.array_equal(rows[i], rows[j]) and owners[i][1] == owners[j][1]
        overlap = min(heights[a, b], heights[b, a]) < least
        if a != b and solid[[a, b]].all() and glass[[a, b]].any() and overlap and not is_no_wall:
            pairs.add((a, b))
    near += [(f"the surfaces of {names[a]}", names[b]) for a, b in sorted(pairs)]
    return [
        f"{one} and {other} are less than {least:g} units apart, which rays do not tell from none: move one of them."
        for one, other in near
    ]


@jit(static_argnames="settings")
def _heights(scene: Scene, settings: ResolvedSettings) -> tuple[Shapes, Float[Array, "points shapes"]]:
    """The faces of a scene, and how far outside of each shape the middles of all shapes and the viewpoint are.

    Far from a shape it is only the sign that counts; a plane's middle is its point.
    """
    shapes = scene_shapes(scene, settings)
    points = jnp.concatenate([middles(shapes), scene.camera.viewpoint[:, None]], axis=1)
    values = jax.vmap(lambda p: surface_value(jnp.broadcast_to(p[:, None], shapes.normal.shape), shapes))(points.T)
    return shapes, jax.ops.segment_max(values.T, shapes.owners, len(shapes.types)).T


def _lengths(shapes: Shapes, eye: np.ndarray, length: float) -> np.ndarray:
    """Each face as numbers that are the same for the same surface, and differ by as much as two are apart."""
    normal, flat = shapes.normal, shapes.curvature == 0
    axis = np.zeros_like(normal) if shapes.axis is None else shapes.axis
    place = shapes.position - eye[:, None]
    # Of a plane the point below the eye counts, of a cylinder that of its axis.
    place = np.where(flat, (normal * place).sum(0) * normal, place - (axis * place).sum(0) * axis)
    # An axis may point either way, and its products do not change.
    axes, bend = (axis[:, None] * axis).reshape(9, -1), np.where(shapes.radius == 0, length * shapes.curvature, 0)
    return np.concatenate([place, shapes.radius[None], length * np.concatenate([normal, axes, [~flat, bend]])]).T
