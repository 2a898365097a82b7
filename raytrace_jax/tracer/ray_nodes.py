"""The rays of one pixel as a tree of nodes."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

Kind = Literal["camera", "reflected", "transmitted"]
KINDS: tuple[Kind, ...] = ("reflected", "transmitted")


class RayNode(NamedTuple):
    """A ray, what it hits, and the colour that it brings back.

    Args:
        number: its place in the tree; parents come before their children, and 0 is the camera's ray.
        parent: number of the ray from whose hit it starts; None for the camera's.
        kind: how it left there.
        bounce: how many rays lie before it on its path.
        weight: about how much its colour counts in the pixel's: the product of the weights along its path.
        o: where it starts, world units.
        d: its direction, of length one.
        shape: name of the shape that it hits; None if it hits nothing, and then what follows has no meaning but for
            the colour, which is black.
        p: the point hit.
        n: the unit normal there.
        distance: from `o` to `p`, world units.
        path_length: of the whole path from the viewpoint to `p`; ambient light falls off with it.
        entering: whether it comes from the side that the normal points to.
        theta_i: angle of incidence in radians, 0 to pi / 2.
        theta_t: angle of refraction in radians; None where nothing is transmitted.
        total: whether there is total internal reflection.
        reflect: weight of the reflected ray in this one's colour, of the largest channel; 0 if there is none.
        transmit: weight of the transmitted ray in it.
        color: what the ray brings back, scene-linear RGB.
        medium: name of the shape whose glass it runs through; None in vacuum, in models without media, and where the
            ray hits nothing.
        absorbed: the share of its light that is absorbed there, the mean of the channels.
    """

    number: int
    parent: int | None
    kind: Kind
    bounce: int
    weight: float
    o: Float[np.ndarray, "3"]
    d: Float[np.ndarray, "3"]
    shape: str | None
    p: Float[np.ndarray, "3"]
    n: Float[np.ndarray, "3"]
    distance: float
    path_length: float
    entering: bool
    theta_i: float
    theta_t: float | None
    total: bool
    reflect: float
    transmit: float
    color: Float[np.ndarray, "3"]
    medium: str | None = None
    absorbed: float = 0.0


class RayTree(NamedTuple):
    """All rays of one pixel.

    Args:
        pixel: column and row, from the top left of the picture.
        nodes: the rays, level by level; the first is the camera's and has the pixel's colour.
        dropped: how many more rays were wanted after the last bounce that the settings allow; they count as black.
    """

    pixel: tuple[int, int]
    nodes: tuple[RayNode, ...]
    dropped: int
