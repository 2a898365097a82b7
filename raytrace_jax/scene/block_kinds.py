"""The table of blocks: every keyword and attribute of `model.txt`, and the struct that a block becomes.

The reader, the writer, the constructors in Python and the parameters by name all follow it, so that they accept the
same values. A new kind of shape is its struct in `scene` and its row here.
"""

from itertools import chain

from raytrace_jax.scene import limits, nature
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.scene import (
    ImagePlaneCamera,
    Materials,
    PerspectiveCamera,
    Planes,
    PointLights,
    Rectangles,
    Spheres,
)
from raytrace_jax.scene.schema import Attribute, BlockKind, DerivedDefault

XY, XYZ, RGB = ("x", "y"), ("x", "y", "z"), ("r", "g", "b")
BLACK = (0.0, 0.0, 0.0)

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
VIEWPOINT = Attribute("viewpoint", XYZ, nature=nature.VECTOR)
MATERIAL = Attribute(
    "material", kind="name", refers_to="material", how_to_change="it is a name; change it in the file."
)


def _weight(name: str, model: ModelName) -> Attribute:
    return Attribute(name, default=(0.0,), only_model=model, limit=limits.UNIT_INTERVAL, nature=nature.WEIGHT)


_ROWS = (
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
            Attribute("fov", limit=limits.ANGLE_OF_VIEW, nature=nature.ANGLE_OF_VIEW),
            Attribute("center", XY, default=MIDDLE, nature=nature.PIXELS),
            Attribute("distortion", ("k1", "k2"), default=(0.0, 0.0)),
        ),
        checks=(limits.LOOKS_SOMEWHERE, limits.UPRIGHT, limits.UNFOLDED),
        is_single=True,
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
                only_model="additive",
                limit=limits.NOT_NEGATIVE,
                nature=nature.AMOUNT._replace(dimension=2),
            ),
        ),
    ),
    BlockKind(
        "material",
        "materials",
        Materials,
        (
            Attribute("ambient", RGB, default=BLACK, model_defaults={"additive": (0.05,) * 3}, nature=nature.SHINE),
            Attribute("diffuse", RGB, default=BLACK, model_defaults={"additive": (0.78,) * 3}, nature=nature.COLOR),
            Attribute("specular", RGB, default=BLACK, model_defaults={"additive": (0.2,) * 3}, nature=nature.COLOR),
            _weight("alpha", "classic"),
            Attribute(
                "ior", default=(1.0,), model_defaults={"additive": (1.45,)}, limit=limits.POSITIVE, nature=nature.INDEX
            ),
            Attribute(
                "hardness",
                default=(1000.0,),
                only_model="additive",
                limit=limits.NOT_NEGATIVE,
                nature=nature.AMOUNT,
            ),
            _weight("reflectivity", "additive"),
            _weight("fresnel", "additive"),
            _weight("transmission", "additive"),
        ),
    ),
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
