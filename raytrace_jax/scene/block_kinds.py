"""The table of blocks: every keyword and attribute of `model.txt`, and the struct that a block becomes.

The reader, the writer, the constructors in Python and the parameters by name all follow it, so that they accept the
same values. A new kind of shape is its struct in `scene` and its row here.
"""

from itertools import chain
from typing import Literal, get_args

from raytrace_jax.images.options import Transfer
from raytrace_jax.scene import limits, nature
from raytrace_jax.scene.film import FILM, FILM_EFFECTS, RGB, FilmResponse
from raytrace_jax.scene.scene import (
    AbbeMaterials,
    Background,
    ChannelMaterials,
    Checkers,
    FileSettings,
    ImagePlaneCamera,
    Images,
    Materials,
    PerspectiveCamera,
    Planes,
    PointLights,
    Rectangles,
    Spheres,
)
from raytrace_jax.scene.schema import Attribute, BlockKind, DerivedDefault
from raytrace_jax.scene.setting_words import (
    EdgeMode,
    EtaConvention,
    ModelName,
    PixelConvention,
    Reflectance,
    TextureFilter,
    TextureWrap,
)

SETTINGS = "settings"
"""The keyword of what a file says of how its picture is made."""

XY, XYZ = ("x", "y"), ("x", "y", "z")
BLACK = (0.0, 0.0, 0.0)
COURSE: tuple[ModelName, ...] = ("classic", "additive")

PIXELDIM = Attribute(
    "pixeldim",
    XY,
    kind="integer",
    limit=limits.PICTURE_SIDES,
    how_to_change="it is a count of pixels; set the picture's size with the size option.",
)
MIDDLE = DerivedDefault(
    ("pixeldim",), lambda sides: tuple((float(side) - 1) / 2 for side in sides), "the picture's middle"
)
USUAL_FOV = 39.6
"""A camera that does not say has this horizontal angle of view, in degrees: a lens of 50 mm on a frame 36 mm wide."""

VIEWPOINT = Attribute("viewpoint", XYZ, nature=nature.VECTOR)
MATERIAL = Attribute(
    "material", kind="name", refers_to="material", how_to_change="it is a name; change it in the file."
)


TEXTURE = Attribute(
    "texture",
    kind="name",
    refers_to="texture",
    is_optional=True,
    only_models=("physical",),
    how_to_change="it is a name; change it in the file.",
)


def _weight(name: str, *models: ModelName) -> Attribute:
    return Attribute(name, default=(0.0,), only_models=models, limit=limits.UNIT_INTERVAL, nature=nature.WEIGHT)


def _word(name: str, words: object, default: str | None = None) -> Attribute:
    how = "it is a word; change it in the file."
    return Attribute(name, kind="word", choices=get_args(words), default=default, how_to_change=how)


def _choice(name: str, words: object, without: str) -> Attribute:
    return _word(name, words)._replace(is_optional=True, without=without)


def _kind(word: str) -> Attribute:
    return Attribute("kind", kind="word", choices=(word,), how_to_change="it is a word; change it in the file.")


def _setting(name: str, kind: Literal["integer", "constant"], limit: limits.Limit, without: str) -> Attribute:
    how = "it is a setting; use its option."
    return Attribute(name, kind=kind, limit=limit, is_optional=True, without=without, how_to_change=how)


def _only(model: ModelName, setting: Attribute) -> Attribute:
    """A setting of one model, and the words that say so."""
    return setting._replace(only_models=(model,), without=f"{setting.without} ({model} only)")


TRANSPARENCY = ("alpha", "transmission")
"""The attributes by which a material lets light through, of one model or another."""

IOR = Attribute(
    "ior",
    default=(1.0,),
    model_defaults={"additive": (1.45,), "physical": (1.5,)},
    limit=limits.POSITIVE,
    nature=nature.INDEX,
)


def _material(struct: type[Materials], group: str, *index: Attribute) -> BlockKind:
    """A kind of material, with what it says of its index of refraction."""
    return BlockKind(
        "material",
        group,
        struct,
        (
            # Its colours.
            Attribute(
                "ambient",
                RGB,
                default=BLACK,
                model_defaults={"additive": (0.05,) * 3},
                only_models=COURSE,
                nature=nature.SHINE,
            ),
            Attribute("diffuse", RGB, default=BLACK, model_defaults={"additive": (0.78,) * 3}, nature=nature.COLOR),
            Attribute(
                "specular",
                RGB,
                default=BLACK,
                model_defaults={"additive": (0.2,) * 3},
                only_models=COURSE,
                nature=nature.COLOR,
            ),
            # How much shines through, and how it is bent.
            _weight("alpha", "classic"),
            *index,
            # What the classic model does not know.
            Attribute(
                "hardness",
                default=(1000.0,),
                only_models=("additive",),
                limit=limits.NOT_NEGATIVE,
                nature=nature.AMOUNT,
            ),
            _weight("reflectivity", "additive", "physical"),
            _weight("fresnel", "additive"),
            _weight("transmission", "additive", "physical"),
            Attribute("emission", RGB, default=BLACK, only_models=("physical",), nature=nature.COLOR),
            Attribute(
                "absorption",
                RGB,
                default=BLACK,
                only_models=("physical",),
                limit=limits.NOT_NEGATIVE,
                nature=nature.AMOUNT._replace(dimension=-1),
            ),
            TEXTURE,
        ),
    )


_ROWS = (
    BlockKind(
        SETTINGS,
        "settings",
        FileSettings,
        (
            _choice("model", ModelName, "classic"),
            _choice("mapping", PixelConvention, "corner, center (physical)"),
            _setting("max_bounces", "integer", limits.BOUNCES, "5, 2 (additive), 12 (physical)"),
            _choice("edges", EdgeMode, "point, of derivatives aware"),
            _setting("samples", "integer", limits.SAMPLES, "1"),
            _setting("path_limit", "constant", limits.POSITIVE, "100 (classic), else no limit"),
            _only("physical", _setting("least_weight", "constant", limits.BELOW_ONE, "1e-06")),
            _only("classic", _choice("reflectance", Reflectance, "schlick")),
            _only("classic", _choice("eta", EtaConvention, "course")),
        ),
        is_single=True,
        is_optional=True,
    ),
    BlockKind(
        "camera",
        "camera",
        ImagePlaneCamera,
        (PIXELDIM, Attribute("worlddim", XY, limit=limits.POSITIVE, nature=nature.LENGTH), VIEWPOINT),
        is_single=True,
    ),
    BlockKind(
        "camera",
        "camera",
        PerspectiveCamera,
        (
            PIXELDIM,
            VIEWPOINT,
            Attribute("lookat", XYZ, nature=nature.VECTOR),
            Attribute("up", XYZ, default=(0.0, 1.0, 0.0), limit=limits.NOT_ALL_ZERO),
            Attribute("fov", default=(USUAL_FOV,), limit=limits.ANGLE_OF_VIEW, nature=nature.ANGLE_OF_VIEW),
            Attribute("center", XY, default=MIDDLE, nature=nature.PIXELS),
            Attribute("distortion", ("k1", "k2"), default=(0.0, 0.0)),
        ),
        checks=(limits.LOOKS_SOMEWHERE, limits.UPRIGHT, limits.UNFOLDED),
        is_single=True,
    ),
    BlockKind(
        FILM,
        FILM,
        FilmResponse,
        tuple(effect.attribute for effect in FILM_EFFECTS),
        is_single=True,
        is_optional=True,
    ),
    BlockKind(
        "background",
        "background",
        Background,
        (Attribute("radiance", RGB, nature=nature.COLOR), TEXTURE),
        is_single=True,
        is_optional=True,
        textures=("images",),
    ),
    BlockKind(
        "light",
        "lights",
        PointLights,
        (
            Attribute("location", XYZ, nature=nature.VECTOR),
            Attribute("emissivity", RGB, nature=nature.SHINE),
            Attribute(
                "energy",
                default=(10.0,),
                only_models=("additive",),
                limit=limits.NOT_NEGATIVE,
                nature=nature.AMOUNT._replace(dimension=2),
            ),
        ),
    ),
    BlockKind(
        "texture",
        "checkers",
        Checkers,
        (
            _kind("checker"),
            Attribute("color1", RGB, nature=nature.COLOR),
            Attribute("color2", RGB, nature=nature.COLOR),
            Attribute("square", limit=limits.POSITIVE, nature=nature.LENGTH),
            Attribute("offset", XY, default=(0.0, 0.0), nature=nature.VECTOR),
        ),
    ),
    BlockKind(
        "texture",
        "images",
        Images,
        (
            _kind("image"),
            Attribute("file", kind="file", how_to_change="it is the name of a file; change it in the scene's file."),
            _choice("transfer", Transfer, "what the file says"),
            _word("filter", TextureFilter, "bilinear"),
            _word("wrap", TextureWrap, "clamp"),
        ),
    ),
    _material(Materials, "materials", IOR),
    _material(
        AbbeMaterials,
        "abbe_materials",
        IOR,
        Attribute("abbe", only_models=("physical",), limit=limits.POSITIVE, nature=nature.AMOUNT),
    ),
    _material(ChannelMaterials, "channel_materials", IOR._replace(components=RGB, default=None, model_defaults={})),
    BlockKind(
        "plane",
        "planes",
        Planes,
        (
            MATERIAL,
            Attribute("normal", XYZ, limit=limits.NOT_ALL_ZERO),
            Attribute("point", XYZ, nature=nature.VECTOR),
        ),
        is_shape=True,
        textures=("checkers",),
    ),
    BlockKind(
        "sphere",
        "spheres",
        Spheres,
        (
            MATERIAL,
            Attribute(
                "center",
                XYZ,
                nature=nature.VECTOR._replace(scale="block", sized_by=("radius",), role="position"),
            ),
            Attribute("radius", limit=limits.POSITIVE, nature=nature.LENGTH),
        ),
        is_shape=True,
    ),
    BlockKind(
        "rectangle",
        "rectangles",
        Rectangles,
        (
            MATERIAL,
            Attribute("center", XYZ, nature=nature.VECTOR._replace(scale="block", sized_by=("right", "up"))),
            Attribute("right", XYZ, limit=limits.NOT_ALL_ZERO, nature=nature.VECTOR),
            Attribute("up", XYZ, limit=limits.NOT_ALL_ZERO, nature=nature.VECTOR),
        ),
        checks=(limits.ORTHOGONAL_SIDES,),
        is_shape=True,
        textures=("checkers", "images"),
    ),
)

BLOCK_KINDS: dict[str, tuple[BlockKind, ...]] = {
    keyword: tuple(kind for kind in _ROWS if kind.keyword == keyword)
    for keyword in dict.fromkeys(kind.keyword for kind in _ROWS)
}
"""The kinds of blocks by keyword, in the order in which a scene is written."""

SHAPE_KEYWORDS = tuple(dict.fromkeys(kind.keyword for kind in _ROWS if kind.is_shape))
ATTRIBUTE_NAMES = frozenset(attribute.name for kind in _ROWS for attribute in kind.attributes)
COMPONENT_NAMES = frozenset(chain.from_iterable(a.components for kind in _ROWS for a in kind.attributes))
