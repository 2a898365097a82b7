"""The table of blocks: the struct that a block of each keyword becomes, and what its attributes may not be together.

The reader, the writer, the constructors in Python and the parameters by name all follow it, so that they accept the
same values. A new type of shape is its struct in `structs` and its row here.
"""

import numpy as np

from raytrace_jax.scene import structs
from raytrace_jax.scene.lens import visible_fraction
from raytrace_jax.scene.response import FILM
from raytrace_jax.scene.schema import Attribute, BlockType, Check, declared_attributes

SETTINGS = "settings"
"""The keyword of what a file says of how its picture is made."""


def _direction(a: np.ndarray) -> np.ndarray:
    """The unit vector along `a` in float64; zero stays zero, and squares neither overflow nor vanish."""
    scaled = np.asarray(a, np.float64) / (np.max(np.abs(a)) or 1.0)
    return scaled / (np.linalg.norm(scaled) or 1.0)


def _not_orthogonal(right: np.ndarray, up: np.ndarray) -> str | None:
    cosine = float(np.clip(_direction(right) @ _direction(up), -1, 1))
    if abs(cosine) <= 1e-4:  # People write four or five digits.
        return None
    return f"right and up must be orthogonal, but the angle between them is {np.degrees(np.arccos(cosine)):.6g} degrees"


def _looks_nowhere(viewpoint: np.ndarray, lookat: np.ndarray) -> str | None:
    if np.any(viewpoint != lookat):
        return None
    return "lookat must be another point than viewpoint, or the camera looks nowhere"


def _not_upright(viewpoint: np.ndarray, lookat: np.ndarray, up: np.ndarray) -> str | None:
    # Halved, the difference of two large numbers cannot overflow.
    view = _direction(np.asarray(lookat, np.float64) / 2 - np.asarray(viewpoint, np.float64) / 2)
    if np.linalg.norm(np.cross(view, _direction(up))) >= 1e-6:  # float32 resolves no more.
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


_SIDES = (Check(("right", "up"), _not_orthogonal),)
_CAMERA_CHECKS = (
    Check(("viewpoint", "lookat"), _looks_nowhere),
    Check(("viewpoint", "lookat", "up"), _not_upright),
    Check(("pixeldim", "fov", "center", "distortion"), _folds_over),
)


def _row(keyword: str, group: str, struct: type, checks: tuple[Check, ...] = (), kind: str = "", **other) -> BlockType:
    """A type of block with the attributes of its struct; before these comes `kind` where there are several."""
    kinds = (Attribute("kind", value_type="word", choices=(kind,)),) if kind else ()
    return BlockType(keyword, group, struct, (*kinds, *declared_attributes(struct)), checks, **other)


_ROWS = (
    _row(SETTINGS, SETTINGS, structs.FileSettings, is_optional=True),
    _row("camera", "camera", structs.ImagePlaneCamera),
    _row("camera", "camera", structs.PerspectiveCamera, _CAMERA_CHECKS),
    _row(FILM, FILM, structs.CameraResponse, is_optional=True),
    _row("background", "background", structs.Background, is_optional=True, textures=("images",)),
    _row("light", "lights", structs.PointLights),
    _row("texture", "checkers", structs.Checkers, kind="checker"),
    _row("texture", "images", structs.Images, kind="image"),
    _row("material", "materials", structs.Materials),
    _row("material", "abbe_materials", structs.AbbeMaterials),
    _row("material", "channel_materials", structs.ChannelMaterials),
    _row("plane", "planes", structs.Planes, textures=("checkers",)),
    _row("sphere", "spheres", structs.Spheres),
    _row("rectangle", "rectangles", structs.Rectangles, _SIDES, textures=("checkers", "images")),
)

BLOCK_TYPES: dict[str, tuple[BlockType, ...]] = {
    keyword: tuple(row for row in _ROWS if row.keyword == keyword)
    for keyword in dict.fromkeys(row.keyword for row in _ROWS)
}
"""The types of blocks by keyword, in the order in which a scene is written."""

SHAPE_KEYWORDS = tuple(dict.fromkeys(row.keyword for row in _ROWS if row.is_shape))
ATTRIBUTE_NAMES = frozenset(attribute.name for row in _ROWS for attribute in row.attributes)
COMPONENT_NAMES = frozenset(name for row in _ROWS for attribute in row.attributes for name in attribute.components)
