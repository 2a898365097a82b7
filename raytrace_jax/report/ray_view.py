"""From which side, and how much of it, the rays of a pixel are drawn."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.ray_tree import KINDS, RayNode, RayTree

LEAD = 0.35
"""How much of the camera's ray is shown at most, as a share of what all others take up; the camera is far away."""

NARROWEST = 0.6
"""The shorter side of what is shown, at least, as a share of the longer one."""

UPRIGHT = 1e-3
"""How much a view in which y runs upwards is preferred, as a share of the rays' spread."""


class View(NamedTuple):
    """The plane of the drawing: a point of it, and unit vectors to the right, upwards and towards the beholder."""

    center: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def project(self, p: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
        """A point's place in the drawing."""
        return np.array([(p - self.center) @ self.right, (p - self.center) @ self.up])


def fit_view(points: Float[np.ndarray, "points 3"], root: RayNode) -> View:
    """The plane nearest to the points, seen so that y is as upright as it can be and the camera's ray runs right."""
    center = points.mean(axis=0)
    spread = (points - center).T @ (points - center)
    vertical = np.array([0.0, 1.0, 0.0])
    # Of the planes through a single line the upright one is taken, of the upright ones y-z.
    preference = np.outer(vertical, vertical) + np.diag([0, 0, UPRIGHT])
    _, axes = np.linalg.eigh(spread / max(np.trace(spread), 1e-300) + UPRIGHT * preference)
    normal = axes[:, 0]
    up = vertical - (vertical @ normal) * normal
    if np.linalg.norm(up) < 0.3:  # A view from above: what is far away is up.
        up = np.array([0, 0, -1.0]) + normal[2] * normal
    up = up / np.linalg.norm(up)
    right = np.cross(up, normal)
    # From the side light runs to the right, from above x does; turned round, not mirrored.
    if right @ (root.d if abs(normal[1]) < 0.9 else np.array([1.0, 0, 0])) < 0:
        right, normal = -right, -normal
    return View(center, right, up, normal)


def window(tree: RayTree, scene: Scene, view: View) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower and upper corner of what is shown: the hits, the balls around transmitted rays, some of the first ray."""
    ends = [view.project(node.p) for node in tree.nodes if node.shape is not None]
    crossed = {
        tree.nodes[node.parent].shape for node in tree.nodes if node.parent is not None and node.kind == KINDS[1]
    }
    for index, name in enumerate(scene.spheres.names):
        if name in crossed:
            place, radius = view.project(np.asarray(scene.spheres.center[:, index])), scene.spheres.radius[index]
            ends += [place - float(radius), place + float(radius)]
    root = tree.nodes[0]
    if not ends:
        ends = [view.project(root.o), view.project(root.o + root.d)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    size = max(float(np.max(high - low)), 0.5 if root.shape is None else 0.5 * root.distance)
    if root.shape is not None:
        lead = view.project(root.p - min(LEAD * size, root.distance) * root.d)
        low, high = np.minimum(low, lead), np.maximum(high, lead)
    # No narrower than what its title and labels need.
    middle, half = (low + high) / 2, (high - low) / 2 + 0.1 * size
    half = np.maximum(half, NARROWEST * half.max())
    return middle - half, middle + half


def seen_points(tree: RayTree) -> Float[np.ndarray, "points 3"]:
    """The points that a drawing has to show: all hits, or the way of a ray that hits nothing."""
    ends = [node.p for node in tree.nodes if node.shape is not None]
    ends = ends or [tree.nodes[0].o + tree.nodes[0].d]
    return np.array([tree.nodes[0].o, *ends], np.float64)
