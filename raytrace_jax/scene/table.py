"""The table of blocks: every keyword and attribute of `model.txt`, and the struct that a block becomes.

The reader, the writer, the constructors in Python and the parameters by name all follow it, so that they accept the
same values. A new type of shape is its struct in `scene` and its row here.
"""

import math
from itertools import chain
from typing import Literal, get_args

import numpy as np

from raytrace_jax.images import Transfer
from raytrace_jax.scene import scene
from raytrace_jax.scene import setting_words as words
from raytrace_jax.scene.lens import visible_fraction
from raytrace_jax.scene.response import FILM, FILM_EFFECTS, RGB
from raytrace_jax.scene.schema import (
    ABOVE_ZERO,
    AMOUNT,
    LENGTH,
    LIGHT,
    NOT_ALL_ZERO,
    NOT_NEGATIVE,
    PIXELS,
    POSITIVE,
    VECTOR,
    Attribute,
    BlockType,
    Check,
    DerivedDefault,
    Limit,
    Quantity,
    between,
    less_than,
)

UNIT_INTERVAL = between(0, 1)

SETTINGS = "settings"
"""The keyword of what a file says of how its picture is made."""

USUAL_FOV = 39.6
"""A camera that does not say has this horizontal angle of view, in degrees: a lens of 50 mm on a frame 36 mm wide."""

TRANSPARENCY = ("alpha", "transmission")
"""The attributes by which a material lets light through, of one model or another."""

SHINE = LIGHT._replace(model_dimensions={"classic": 1, "physical": 2})
"""The colour of point lights, which the classic model divides by a distance and the physical one by its square.

Ambient light has it too, of which the physical model knows nothing."""

INDEX = Quantity("unit of index", ranges=((1.0, math.inf), *ABOVE_ZERO), scale="index", role="index")
"""An index stays above 1; one that starts below 1 is that of a bubble and only stays above 0."""

ANGLE_OF_VIEW = Quantity("degree", ranges=((1e-4, 179.9999),))
"""The range lies within an angle's limits also where its ends are rounded to float32."""


def _word(name: str, choices: object, default: str | None = None) -> Attribute:
    how = "it is a word; change it in the file."
    return Attribute(name, value_type="word", choices=get_args(choices), default=default, how_to_change=how)


def _choice(name: str, choices: object, without: str) -> Attribute:
    return _word(name, choices)._replace(is_optional=True, without=without)


def _setting(name: str, value_type: Literal["integer", "constant"], limit: Limit, without: str) -> Attribute:
    how = "it is a setting; use its option."
    return Attribute(name, value_type=value_type, limit=limit, is_optional=True, without=without, how_to_change=how)


def _only(model: words.ModelName, setting: Attribute) -> Attribute:
    """A setting of one model, and the words that say so."""
    return setting._replace(only_models=(model,), without=f"{setting.without} ({model} only)")


def _weight(name: str, *models: words.ModelName) -> Attribute:
    quantity = Quantity(ranges=((0.0, 1.0),))
    return Attribute(name, default=(0.0,), only_models=models, limit=UNIT_INTERVAL, quantity=quantity)


def _color(name: str, *models: words.ModelName, additive: float = 0.0) -> Attribute:
    """A colour of a material, black but for the additive model."""
    defaults = {"additive": (additive,) * 3} if additive else {}
    return Attribute(name, RGB, "number", (0.0,) * 3, defaults, only_models=models, quantity=AMOUNT)


XY, XYZ = ("x", "y"), ("x", "y", "z")

PIXELDIM = Attribute(
    "pixeldim",
    XY,
    value_type="integer",
    limit=between(1, words.MAX_PICTURE_SIDE, f"from 1 to {words.MAX_PICTURE_SIDE} a side"),
    how_to_change="it is a count of pixels; set the picture's size with the size option.",
)
MIDDLE = DerivedDefault(("pixeldim",), lambda sides: tuple((float(n) - 1) / 2 for n in sides), "the picture's middle")
VIEWPOINT = Attribute("viewpoint", XYZ, quantity=VECTOR)
CENTER = Attribute("center", XY, default=MIDDLE, quantity=PIXELS)

NAME = Attribute("", value_type="name", how_to_change="it is a name; change it in the file.")
MATERIAL = NAME._replace(name="material", refers_to="material")
TEXTURE = NAME._replace(name="texture", refers_to="texture", is_optional=True, only_models=("physical",))

IOR = Attribute(
    "ior", default=(1.0,), model_defaults={"additive": (1.45,), "physical": (1.5,)}, limit=POSITIVE, quantity=INDEX
)


def _material(struct: type[scene.Materials], group: str, *index: Attribute) -> BlockType:
    """A type of material, with what it says of its index of refraction."""
    attributes = (
        _color("ambient", "classic", "additive", additive=0.05)._replace(quantity=SHINE),
        _color("diffuse", additive=0.78),
        _color("specular", "classic", "additive", additive=0.2),
        _weight("alpha", "classic"),
        *index,
        Attribute("hardness", default=(1000.0,), only_models=("additive",), limit=NOT_NEGATIVE, quantity=AMOUNT),
        _weight("reflectivity", "additive", "physical"),
        _weight("fresnel", "additive"),
        _weight("transmission", "additive", "physical"),
        _color("emission", "physical")._replace(quantity=LIGHT),
        _color("absorption", "physical")._replace(limit=NOT_NEGATIVE, quantity=AMOUNT._replace(dimension=-1)),
        TEXTURE,
    )
    return BlockType("material", group, struct, attributes)


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


_SETTINGS = (
    _choice("model", words.ModelName, "classic"),
    _choice("mapping", words.PixelConvention, "corner, center (physical)"),
    _setting("max_bounces", "integer", between(0, words.MAX_BOUNCES), "5, 2 (additive), 12 (physical)"),
    _choice("edges", words.EdgeMode, "point, of derivatives aware"),
    _setting("samples", "integer", between(1, words.MAX_SAMPLES), "1"),
    _setting("path_limit", "constant", POSITIVE, "100 (classic), else no limit"),
    _only("physical", _setting("least_weight", "constant", less_than(1, 0), "1e-06")),
    _only("classic", _choice("reflectance", words.Reflectance, "schlick")),
    _only("classic", _choice("eta", words.EtaConvention, "course")),
)
_IMAGE_PLANE_CAMERA = (PIXELDIM, Attribute("worlddim", XY, limit=POSITIVE, quantity=LENGTH), VIEWPOINT, CENTER)
_BELOW_180 = Limit(
    lambda values: bool(np.all((values > 0) & (values < 180))), "greater than 0 and less than 180 degrees"
)
_PERSPECTIVE_CAMERA = (
    PIXELDIM,
    VIEWPOINT,
    Attribute("lookat", XYZ, quantity=VECTOR),
    Attribute("up", XYZ, default=(0.0, 1.0, 0.0), limit=NOT_ALL_ZERO),
    Attribute("fov", default=(USUAL_FOV,), limit=_BELOW_180, quantity=ANGLE_OF_VIEW),
    CENTER,
    Attribute("distortion", ("k1", "k2"), default=(0.0, 0.0)),
)
_CAMERA_CHECKS = (
    Check(("viewpoint", "lookat"), _looks_nowhere),
    Check(("viewpoint", "lookat", "up"), _not_upright),
    Check(("pixeldim", "fov", "center", "distortion"), _folds_over),
)
_ENERGY = Attribute(
    "energy", default=(10.0,), only_models=("additive",), limit=NOT_NEGATIVE, quantity=LIGHT._replace(dimension=2)
)
_LIGHT = (Attribute("location", XYZ, quantity=VECTOR), Attribute("emissivity", RGB, quantity=SHINE), _ENERGY)
_CHECKER = (
    _word("kind", Literal["checker"]),
    Attribute("color1", RGB, quantity=AMOUNT),
    Attribute("color2", RGB, quantity=AMOUNT),
    Attribute("square", limit=POSITIVE, quantity=LENGTH),
    Attribute("offset", XY, default=(0.0, 0.0), quantity=VECTOR),
)
_IMAGE = (
    _word("kind", Literal["image"]),
    Attribute("file", value_type="file", how_to_change="it is the name of a file; change it in the scene's file."),
    _choice("transfer", Transfer, "what the file says"),
    _word("filter", words.TextureFilter, "bilinear"),
    _word("wrap", words.TextureWrap, "clamp"),
)
_ABBE = Attribute("abbe", only_models=("physical",), limit=POSITIVE, quantity=AMOUNT)
_IOR_RGB = IOR._replace(components=RGB, default=None, model_defaults={})
_PLANE = (MATERIAL, Attribute("normal", XYZ, limit=NOT_ALL_ZERO), Attribute("point", XYZ, quantity=VECTOR))
_SPHERE = (
    MATERIAL,
    Attribute("center", XYZ, quantity=VECTOR._replace(scale="block", sized_by=("radius",), role="position")),
    Attribute("radius", limit=POSITIVE, quantity=LENGTH),
)
_RECTANGLE = (
    MATERIAL,
    Attribute("center", XYZ, quantity=VECTOR._replace(scale="block", sized_by=("right", "up"))),
    Attribute("right", XYZ, limit=NOT_ALL_ZERO, quantity=VECTOR),
    Attribute("up", XYZ, limit=NOT_ALL_ZERO, quantity=VECTOR),
)
_SIDES = (Check(("right", "up"), _not_orthogonal),)
_BACKGROUND = (Attribute("radiance", RGB, quantity=LIGHT), TEXTURE)
_EFFECTS = tuple(effect.attribute for effect in FILM_EFFECTS)

_ROWS = (
    BlockType(SETTINGS, SETTINGS, scene.FileSettings, _SETTINGS, is_single=True, is_optional=True),
    BlockType("camera", "camera", scene.ImagePlaneCamera, _IMAGE_PLANE_CAMERA, is_single=True),
    BlockType("camera", "camera", scene.PerspectiveCamera, _PERSPECTIVE_CAMERA, _CAMERA_CHECKS, is_single=True),
    BlockType(FILM, FILM, scene.CameraResponse, _EFFECTS, is_single=True, is_optional=True),
    BlockType("background", "background", scene.Background, _BACKGROUND, (), True, True, textures=("images",)),
    BlockType("light", "lights", scene.PointLights, _LIGHT),
    BlockType("texture", "checkers", scene.Checkers, _CHECKER),
    BlockType("texture", "images", scene.Images, _IMAGE),
    _material(scene.Materials, "materials", IOR),
    _material(scene.AbbeMaterials, "abbe_materials", IOR, _ABBE),
    _material(scene.ChannelMaterials, "channel_materials", _IOR_RGB),
    BlockType("plane", "planes", scene.Planes, _PLANE, is_shape=True, textures=("checkers",)),
    BlockType("sphere", "spheres", scene.Spheres, _SPHERE, is_shape=True),
    BlockType(
        "rectangle", "rectangles", scene.Rectangles, _RECTANGLE, _SIDES, is_shape=True, textures=("checkers", "images")
    ),
)

BLOCK_TYPES: dict[str, tuple[BlockType, ...]] = {
    keyword: tuple(row for row in _ROWS if row.keyword == keyword)
    for keyword in dict.fromkeys(row.keyword for row in _ROWS)
}
"""The types of blocks by keyword, in the order in which a scene is written."""

SHAPE_KEYWORDS = tuple(dict.fromkeys(row.keyword for row in _ROWS if row.is_shape))
ATTRIBUTE_NAMES = frozenset(attribute.name for row in _ROWS for attribute in row.attributes)
COMPONENT_NAMES = frozenset(chain.from_iterable(a.components for row in _ROWS for a in row.attributes))
