"""What a kind of shape has to say of itself, so that rays, footprints, shadows and figures can meet it.

A new kind is a file in `kinds` with one `ShapeKind`, and a row in the table there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.tracer.geometry.edges import Approach, Edge
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.geometry.shapes import Shapes
from raytrace_jax.tracer.resolved_settings import ResolvedSettings


class Sighting(NamedTuple):
    """How each footprint meets one shape.

    Args:
        t: distance to where it is met first, in world units.
        seen: whether any part of the footprint that matters meets it.
        outside: whether it is a curved shape that is seen from outside of it.
        centered: whether the footprint's centre meets it, not only a part beyond its edge.
    """

    t: Float[Array, " *rays"]
    seen: Bool[Array, " *rays"]
    outside: Bool[Array, " *rays"]
    centered: Bool[Array, " *rays"]


class CuttingPlane(NamedTuple):
    """The plane of a drawing: a point of it, and unit vectors to the right, upwards and towards the beholder."""

    center: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def project(self, p: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
        """A point's place in the drawing."""
        return np.array([(p - self.center) @ self.right, (p - self.center) @ self.up])


class Section(NamedTuple):
    """How a drawing shows a shape, as points of the drawing's plane in order; without points there is nothing.

    Args:
        cut: where the plane cuts the shape: the corners of an area, or the points of a line.
        is_area: which of the two.
        outline: the shape's outline as seen from far in front of the drawing; none for what has no end.
    """

    cut: Float[np.ndarray, "points 2"]
    is_area: bool
    outline: Float[np.ndarray, "corners 2"]


NO_POINTS = np.zeros((0, 2))


class ShapeKind(NamedTuple):
    """A kind of shape. "A shape" is a `Shapes` of one entry, or of one for each ray.

    Args:
        curved: closed and convex, with an outline where rays graze it; flat if not.
        coefficients: from the scene's struct of such shapes the fields of `Shapes` of the same names; `axes` only where
            the kind has sides.
        hit: distance along rays to one shape, and whether that is a hit: from rays, the shape, which rays start on it,
            the least distance that counts, and settings. Not differentiable: `shapes.hit_distance` adds that.
        distance: distance along rays that are known to meet their shapes, one shape a ray. The last argument tells
            which of them see a curved shape from outside. Not differentiable.
        see: how footprints meet one shape: from rays with footprints, the shape, which rays start on it, which of them
            have a level for what is past an edge, the least distance, and settings.
        edges: the shape's own edges, one shape a ray: from the rays, the shapes, which of them are of this kind, which
            are seen from outside, distances and how these change over the footprint, and settings.
        clearance: how far the ways from points to a light stay clear of one shape, in units of length; negative where
            it cuts them: from points, the light's place, the shape, the unit of length, and settings.
        section: how a drawing shows one shape: from its numbers, the drawing's plane, how far the drawing reaches, and
            settings.
        reach: how far shapes extend from their positions, in world units; None where they have no end.
        has_inside: there is glass behind its surface, wherever F is negative.
        frame: the directions in which places on shapes are measured, "2 3 *shapes" of length one, and half their sizes
            along these, "2 *shapes", infinite where they have no end: from shapes; None where textures have no mapping.
    """

    curved: bool
    coefficients: Callable[[Any], dict[str, Array]]
    hit: Callable[[Rays, Shapes, Bool[Array, " *rays"], Array, ResolvedSettings], tuple[Array, Array]]
    distance: Callable[[Rays, Shapes, Bool[Array, " *rays"]], Float[Array, " *rays"]]
    see: Callable[[Rays, Shapes, Array, Array, Array, ResolvedSettings], Sighting]
    edges: Callable[[Rays, Shapes, Array, Array, Array, Approach, ResolvedSettings], tuple[Edge, ...]]
    clearance: Callable[[Array, Array, Shapes, Array, ResolvedSettings], Float[Array, " *rays"]]
    section: Callable[[Shapes, CuttingPlane, float, ResolvedSettings], Section]
    reach: Callable[[Shapes], Float[Array, " *shapes"]] | None = None
    has_inside: bool = False
    frame: Callable[[Shapes], tuple[Float[Array, "2 3 *shapes"], Float[Array, "2 *shapes"]]] | None = None
