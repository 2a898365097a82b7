"""From which side, and how much of it, the rays of a pixel are drawn."""

import jax
import numpy as np
from jaxtyping import Float

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.shape_types import SHAPE_TYPES, scene_shapes
from raytrace_jax.tracer.geometry.shapes import CuttingPlane, Section
from raytrace_jax.tracer.ray_tree import KINDS, RayNode, RayTree
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.numerics import TINY

UPRIGHT = 1e-3
"""How much a view in which y runs upwards is preferred, as a share of the rays' spread."""


def fit_view(points: Float[np.ndarray, "points 3"], root: RayNode) -> CuttingPlane:
    """The plane nearest to the points, seen so that y is as upright as it can be and the camera's ray runs right."""
    center = points.mean(axis=0)
    spread = (points - center).T @ (points - center)
    vertical = np.array([0.0, 1.0, 0.0])
    # Of the planes through a single line the upright one is taken, of the upright ones y-z.
    preference = np.outer(vertical, vertical) + np.diag([0, 0, UPRIGHT])
    _, axes = np.linalg.eigh(spread / max(np.trace(spread), TINY) + UPRIGHT * preference)
    normal = axes[:, 0]
    up = vertical - (vertical @ normal) * normal
    if np.linalg.norm(up) < 0.3:  # A view from above: what is far away is up.
        up = np.array([0, 0, -1.0]) + normal[2] * normal
    up = up / np.linalg.norm(up)
    right = np.cross(up, normal)
    # From the side light runs to the right, from above x does; turned round, not mirrored.
    if right @ (root.d if abs(normal[1]) < 0.9 else np.array([1.0, 0, 0])) < 0:
        right, normal = -right, -normal
    return CuttingPlane(center, right, up, normal)


def sections(scene: Scene, view: CuttingPlane, reach: float, settings: ResolvedSettings) -> dict[str, Section]:
    """How the drawing shows each shape, by name in the order of the file.

    Args:
        scene: the scene.
        view: the drawing's plane.
        reach: how far from the plane's `center` the drawing reaches, in world units.
        settings: give the model's rules.
    """
    shapes = jax.tree.map(np.asarray, scene_shapes(scene))
    return {
        name: SHAPE_TYPES[kind].section(jax.tree.map(lambda x, i=i: x[..., i], shapes), view, reach, settings)
        for i, (name, kind) in enumerate(zip(scene.shape_order, shapes.types, strict=True))
    }


def window(
    tree: RayTree, shown: dict[str, Section], view: CuttingPlane
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower and upper corner of what is shown: the hits, the balls around transmitted rays, some of the first ray."""
    ends = [view.project(node.p) for node in tree.nodes if node.shape is not None]
    hit = {node.number: node.shape for node in tree.nodes}
    crossed = {hit[node.parent] for node in tree.nodes if node.parent is not None and node.kind == KINDS[1]}
    ends += [point for name, section in shown.items() if name in crossed for point in section.outline]
    root = tree.nodes[0]
    if not ends:
        ends = [view.project(root.o), view.project(root.o + root.d)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    size = max(float(np.max(high - low)), 0.5 if root.shape is None else 0.5 * root.distance)
    if root.shape is not None:
        # The camera is far away: its ray is shown up to 0.35 of what all others take up.
        lead = view.project(root.p - min(0.35 * size, root.distance) * root.d)
        low, high = np.minimum(low, lead), np.maximum(high, lead)
    # The shorter side is at least 0.6 of the longer one, which title and labels need.
    middle, half = (low + high) / 2, (high - low) / 2 + 0.1 * size
    half = np.maximum(half, 0.6 * half.max())
    return middle - half, middle + half


def seen_points(tree: RayTree) -> Float[np.ndarray, "points 3"]:
    """The points that a drawing has to show: all hits, or the way of a ray that hits nothing."""
    ends = [node.p for node in tree.nodes if node.shape is not None]
    ends = ends or [tree.nodes[0].o + tree.nodes[0].d]
    return np.array([tree.nodes[0].o, *ends], np.float64)
