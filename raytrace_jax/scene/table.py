"""The table of blocks: the struct that a block of each keyword becomes, and what its attributes may not be together.

The reader, the writer, the constructors in Python and the parameters by name all follow it, so that they accept the
same values. A new type of shape is its struct in `structs` and its row here.
"""

from itertools import groupby

import numpy as np
from numpy.linalg import norm

from . import structs
from .lens import visible_fraction
from .response import FILM
from .schema import BlockType

SETTINGS = "settings"
"""The keyword of what a file says of how its picture is made."""

OBLIQUE = 1e-4
"""Directions are at right angles whose cosine is no more: people write four or five digits."""


def _direction(a: np.ndarray) -> np.ndarray:
    """The unit vector along `a` in float64; zero stays zero, and squares neither overflow nor vanish."""
    scaled = np.asarray(a, np.float64) / (np.max(np.abs(a)) or 1.0)
    return scaled / (norm(scaled) or 1.0)


def _not_orthogonal(right: np.ndarray, up: np.ndarray) -> str | None:
    return _oblique(right, up, "right and up")


def _not_upright_base(axis: np.ndarray, down: np.ndarray) -> str | None:
    return _oblique(axis, down, "axis and down")


def _oblique(a: np.ndarray, b: np.ndarray, names: str) -> str | None:
    cosine = float(np.clip(_direction(a) @ _direction(b), -1, 1))
    if abs(cosine) <= OBLIQUE:
        return None
    return f"{names} must be orthogonal, but the angle between them is {np.degrees(np.arccos(cosine)):.6g} degrees"


def _no_rim(curvature1: np.ndarray, curvature2: np.ndarray, thickness: np.ndarray, diameter: np.ndarray) -> str | None:
    half, curvatures = float(diameter) / 2, {"curvature1": float(curvature1), "curvature2": float(curvature2)}
    for name, curvature in curvatures.items():
        if half * abs(curvature) > 1:
            return (
                f"the face of {name} has a radius of {1 / abs(curvature):.6g} and must reach the rim, {half:.6g} from "
                f"the axis: diameter may be {2 / abs(curvature):.6g}, or {name} {np.copysign(1 / half, curvature):.6g}"
            )
    least = sum(abs(bend) * half**2 / (1 + np.sqrt(1 - (bend * half) ** 2)) for bend in curvatures.values())
    if least <= thickness:
        return None
    return (
        f"the two faces cross before the rim: at {half:.6g} from the axis they are {least:.6g} nearer to each other "
        f"than on it, so that thickness must be {least:.6g} or more, not {float(thickness):.6g}"
    )


def _not_upright(viewpoint: np.ndarray, lookat: np.ndarray, up: np.ndarray) -> str | None:
    if np.all(viewpoint == lookat):
        return "lookat must be another point than viewpoint, or the camera looks nowhere"
    # Halved, the difference of two large numbers cannot overflow.
    view = _direction(np.asarray(lookat, np.float64) / 2 - np.asarray(viewpoint, np.float64) / 2)
    if norm(np.cross(view, _direction(up))) >= 1e-6:  # float32 resolves no more.
        return None
    return "up must not be parallel to the view from viewpoint to lookat, or nothing is upright"


def _folds_over(pixeldim: np.ndarray, fov: np.ndarray, center: np.ndarray, distortion: np.ndarray) -> str | None:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # From the principal point to the corners of the picture, which are half a pixel beyond their pixels' centres.
        corners = np.maximum(center.astype(np.float64) + 0.5, pixeldim - 0.5 - center)
        focal_length = pixeldim[0] / (2 * np.tan(np.radians(fov.astype(np.float64)) / 2))
        visible = visible_fraction(distortion, np.hypot(*corners) / focal_length)
    if not visible <= 1:
        return None
    return (
        "distortion must not fold the picture over, but it does at "
        f"{100 * visible:.4g} % of the way from center to the farthest corner"
    )


def _all_wall(thickness: np.ndarray, wall: np.ndarray) -> str | None:
    return None if 2 * wall < thickness else f"two walls of {wall:.6g} must be less than the thickness, {thickness:.6g}"


_ROWS = (
    BlockType(SETTINGS, SETTINGS, structs.FileSettings),
    BlockType("camera", "camera", structs.ImagePlaneCamera),
    BlockType("camera", "camera", structs.PerspectiveCamera, (_not_upright, _folds_over)),
    BlockType(FILM, FILM, structs.CameraResponse),
    BlockType("background", "background", structs.Background, textures=("images",)),
    BlockType("light", "lights", structs.PointLights),
    BlockType("texture", "checkers", structs.Checkers),
    BlockType("texture", "images", structs.Images),
    BlockType("material", "materials", structs.Materials),
    BlockType("material", "abbe_materials", structs.AbbeMaterials),
    BlockType("material", "channel_materials", structs.ChannelMaterials),
    BlockType("plane", "planes", structs.Planes, textures=("checkers",)),
    BlockType("sphere", "spheres", structs.Spheres),
    BlockType("sphere", "cut_spheres", structs.CutSpheres),
    BlockType("rectangle", "rectangles", structs.Rectangles, (_not_orthogonal,), textures=("checkers", "images")),
    BlockType("box", "boxes", structs.Boxes, (_not_orthogonal,)),
    BlockType("prism", "prisms", structs.Prisms, (_not_upright_base,)),
    BlockType("cylinder", "cylinders", structs.Cylinders),
    BlockType("cylinder", "cut_cylinders", structs.CutCylinders),
    BlockType("lens", "lenses", structs.Lenses, (_no_rim,)),
    BlockType("slab", "slabs", structs.Slabs, (_all_wall,)),
)

BLOCK_TYPES: dict[str, tuple[BlockType, ...]] = {
    keyword: tuple(rows) for keyword, rows in groupby(_ROWS, lambda row: row.keyword)
}
"""The types of blocks by keyword, in the order in which a scene is written."""

SHAPE_KEYWORDS = tuple(dict.fromkeys(row.keyword for row in _ROWS if row.is_shape))
COMPONENT_NAMES = frozenset(name for row in _ROWS for attribute in row.attributes for name in attribute.components)
