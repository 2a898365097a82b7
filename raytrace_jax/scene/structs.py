"""The structs of blocks: an attribute of `model.txt` is a field, and what is known of its values is declared with it.

A struct has arrays, components first and one column a block, with the blocks' `names`; or the values of the only block,
with its `name`. Units are the file's own (one world unit); the y axis points up. Every continuous value is a JAX array,
so that any of them can be differentiated; all else is static. `material` and `texture` hold columns of other blocks, as
`parameters.blocks_of` counts them, or `NO_BLOCK`.
"""

import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Float

from ..images import Transfer
from . import setting_words as words
from .schema import PICTURE_MIDDLE, RGB, XY, XYZ, Blocks, Limit, Quantity, SingleBlock, attribute, between, word

UNIT_INTERVAL = between(0, 1)
POSITIVE = Limit(lambda values: bool(np.all(values > 0)), "greater than 0")
NOT_NEGATIVE = Limit(lambda values: bool(np.all(values >= 0)), "0 or greater")
NOT_ALL_ZERO = Limit(lambda values: bool(np.any(values != 0)), "a vector other than 0 0 0")

Number = Float[Array, ""]
Pair = Float[Array, "2"]
Vector = Float[Array, "3"]
Numbers = Float[Array, " blocks"]
Vectors = Float[Array, "3 blocks"]
"""A point, a direction or a colour of each block of a type, one column a block."""

PHYSICAL: tuple[words.ModelName, ...] = ("physical",)
"""The only model that an attribute means something to."""

ABOVE_ZERO = ((0.0, math.inf),)

AMOUNT = Quantity(ranges=ABOVE_ZERO)
"""A number of 0 or more, a colour among them: one that starts negative may stay so, as no range holds it."""

LIGHT = AMOUNT._replace(is_light=True)

PIXELS = Quantity("pixel", scale="vector")
"""A point of the picture."""

PER_LENGTH = AMOUNT._replace(dimension=-1)
LENGTH = Quantity("world unit", dimension=1, ranges=ABOVE_ZERO)
VECTOR = Quantity("world unit", dimension=1, scale="vector")
"""A point, or the way from one point to another."""

USUAL_FOV = 39.6
"""A camera that does not say has this horizontal angle of view, in degrees: a lens of 50 mm on a frame 36 mm wide."""

SHINE = LIGHT._replace(model_dimensions={"classic": 1, "physical": 2})
"""The colour of point lights, which the classic model divides by a distance and the physical one by its square; and of
ambient light, of which the physical model knows nothing."""


def _pixeldim() -> Any:
    most = words.MAX_PICTURE_SIDE
    return attribute(XY, value_type="integer", limit=between(1, most, f"from 1 to {most} a side"))


def _point(quantity: Quantity = VECTOR, **declared: Any) -> Any:
    return attribute(XYZ, quantity=quantity, **declared)


def _direction(**declared: Any) -> Any:
    return attribute(XYZ, limit=NOT_ALL_ZERO, **declared)


def _length(**declared: Any) -> Any:
    return attribute(limit=POSITIVE, quantity=LENGTH, **declared)


def _angle(**declared: Any) -> Any:
    limit = Limit(lambda angle: bool(np.all((angle > 0) & (angle < 180))), "greater than 0 and less than 180 degrees")
    # The range is within the limits also where its ends are rounded to float32.
    return attribute(limit=limit, quantity=Quantity("degree", ranges=((1e-4, 179.9999),)), **declared)


def _integer(least: int, most: int, without: str) -> Any:
    return attribute(value_type="integer", limit=between(least, most), without=without)


def _column(**declared: Any) -> Any:
    return attribute(value_type="name", **declared)


def _scalar(default: float, limit: Limit, quantity: Quantity = AMOUNT, **declared: Any) -> Any:
    return attribute(default=(default,), limit=limit, quantity=quantity, **declared)


def _weight(*models: words.ModelName) -> Any:
    return _scalar(0.0, UNIT_INTERVAL, Quantity(ranges=((0.0, 1.0),)), only=models)


def _color(*models: words.ModelName, additive: float = 0.0, quantity: Quantity = AMOUNT, **declared: Any) -> Any:
    """A colour of a material, black but for the additive model."""
    defaults = {"additive": (additive,) * 3} if additive else {}
    return attribute(RGB, default=(0.0,) * 3, model_defaults=defaults, only=models, quantity=quantity, **declared)


def _index(components: tuple[str, ...] = (), **declared: Any) -> Any:
    """An index stays above 1; one that starts below 1 is that of a bubble and only stays above 0."""
    quantity = Quantity("unit of index", ranges=((1.0, math.inf), *ABOVE_ZERO), scale="index", role="index")
    return attribute(components, limit=POSITIVE, quantity=quantity, **declared)


class Shapes(Blocks):
    """Shapes of one type, with the column of each one's material."""

    material: tuple[int, ...] = _column()


class ImagePlaneCamera(SingleBlock):
    """The course's pinhole camera, which looks at the rectangle [0, width] x [0, height] of the plane z = 0.

    Args:
        pixeldim: (width, height) of the picture in pixels.
        worlddim: (width, height) of the image plane in world units.
        viewpoint: where the rays start, (x, y, z) in world units.
        center: where the rectangle's middle is seen, as `PerspectiveCamera.center` counts pixels.
    """

    pixeldim: tuple[int, int] = _pixeldim()
    worlddim: Pair = attribute(XY, limit=POSITIVE, quantity=LENGTH)
    viewpoint: Vector = _point()
    center: Pair = attribute(XY, default=PICTURE_MIDDLE, quantity=PIXELS)


class PerspectiveCamera(SingleBlock):
    """A camera with square pixels that looks from a point at a point, through a lens that may distort.

    Args:
        pixeldim: (width, height) of the picture in pixels.
        viewpoint: where the rays start, (x, y, z) in world units.
        lookat: the point that the picture shows at `center`, in world units.
        up: a direction of any length that is upright in the picture.
        fov: the full horizontal angle of view, in degrees, between 0 and 180, of a picture with `center` in its middle
            and without distortion: the focal length is width / (2 tan(fov / 2)) pixels.
        center: the principal point (x, y) in pixels; (0, 0) is the centre of the upper left one.
        distortion: the radial distortion (k1, k2), as in `scene.lens`.
    """

    pixeldim: tuple[int, int] = _pixeldim()
    viewpoint: Vector = _point()
    lookat: Vector = _point()
    up: Vector = _direction(default=(0.0, 1.0, 0.0))
    fov: Number = _angle(default=(USUAL_FOV,))
    center: Pair = attribute(XY, default=PICTURE_MIDDLE, quantity=PIXELS)
    distortion: Pair = attribute(("k1", "k2"), default=(0.0, 0.0))


class CameraResponse(SingleBlock):
    """The camera's response to the light that falls on it; the fields are in the order in which they take effect.

    Without an effect its field is None, as in a compiled program that leaves out what does nothing.

    Args:
        light: the light (x, y, xx, xy, yy) that falls on what is seen is 1 + x u + y v + xx (u^2 - 1/3) + xy u v
            + yy (v^2 - 1/3) times what the scene has, with u from -1 at the left to 1 at the right side of the picture
            and v from -1 at its top to 1 at its bottom.
        vignetting: the fraction of the light that is lost in the picture's corners; it grows with the squared distance
            from the picture's middle.
        blur: standard deviation of a Gaussian point-spread function, in pixels.
        gain: of each channel, a factor.
        offset: what is added to each channel, in units of white.
        gamma: the power of light as it is stored.
    """

    light: Float[Array, "5"] | None = attribute(("x", "y", "xx", "xy", "yy"), default=(0.0,) * 5)
    vignetting: Number | None = _scalar(0.0, between(-1, 1, is_open=True), Quantity(ranges=((-1.0, 1.0),)))
    blur: Number | None = _scalar(0.0, NOT_NEGATIVE, Quantity("pixel", ranges=ABOVE_ZERO))
    gain: Vector | None = attribute(RGB, default=(1.0, 1.0, 1.0), limit=POSITIVE, quantity=AMOUNT)
    offset: Vector | None = attribute(RGB, default=(0.0, 0.0, 0.0), quantity=Quantity(is_light=True))
    gamma: Number | None = _scalar(1.0, POSITIVE)


class FileSettings(SingleBlock):
    """The settings of a picture that a file has; None where it does not say. `RenderSettings` tells what it means."""

    model: words.ModelName | None = word(words.ModelName, without="classic")
    mapping: words.PixelConvention | None = word(words.PixelConvention, without="corner, center (physical)")
    max_bounces: int | None = _integer(0, words.MAX_BOUNCES, "5, 2 (additive), 12 (physical)")
    edges: words.EdgeMode | None = word(words.EdgeMode, without="point, of derivatives aware")
    samples: int | None = _integer(1, words.MAX_SAMPLES, "1")
    path_limit: float | None = attribute(value_type="constant", limit=POSITIVE, without="100 (classic), else no limit")
    least_weight: float | None = attribute(
        value_type="constant", limit=between(0, 1, is_open=True), only=PHYSICAL, without="1e-06 (physical only)"
    )
    reflectance: words.Reflectance | None = word(words.Reflectance, only=("classic",), without="schlick (classic only)")
    eta: words.EtaConvention | None = word(words.EtaConvention, only=("classic",), without="course (classic only)")


class Background(SingleBlock):
    """Light from infinitely far away all around: the colour `radiance` (RGB, scene-linear) times that of `texture`."""

    radiance: Vector = attribute(RGB, quantity=LIGHT)
    texture: int = _column(only=PHYSICAL, without="")


class PointLights(Blocks):
    """Point lights of a colour `emissivity`, scaled by `energy` in the additive model.

    Their light falls off with one over the distance in the classic model, in the others with the distance squared.
    """

    location: Vectors = _point()
    emissivity: Vectors = attribute(RGB, quantity=SHINE)
    energy: Numbers = _scalar(10.0, NOT_NEGATIVE, LIGHT._replace(dimension=2), only=("additive",))


class Checkers(Blocks):
    """Checker boards: `color1` where floor(x) + floor(y) is even, with x, y = (world units - `offset`) / `square`."""

    kind: tuple[str, ...] = word(Literal["checker"])
    color1: Vectors = attribute(RGB, quantity=AMOUNT)
    color2: Vectors = attribute(RGB, quantity=AMOUNT)
    square: Numbers = _length()
    offset: Float[Array, "2 checkers"] = attribute(XY, default=(0.0, 0.0), quantity=VECTOR)


class Images(Blocks):
    """Pictures on surfaces, scene-linear; row 0 is the top one.

    Args:
        texels: the pictures.
        file: where each was read from, as the scene's file has it; empty for one that came as numbers.
        transfer: what the file was told of the numbers of a PNG, or None.
        filter: `bilinear` or `nearest`.
        wrap: what is beyond the border: `clamp`, `repeat` or `black`.
    """

    texels: tuple[Float[Array, "3 _ _"], ...]
    kind: tuple[str, ...] = word(Literal["image"])
    file: tuple[str, ...] = attribute(value_type="file")
    transfer: tuple[Transfer | None, ...] = word(Transfer, without="what the file says")
    filter: tuple[words.TextureFilter, ...] = word(words.TextureFilter, "bilinear")
    wrap: tuple[words.TextureWrap, ...] = word(words.TextureWrap, "clamp")


class Materials(Blocks):
    """Surface colours (RGB, scene-linear) and index of refraction `ior` > 0, which all models have; and more.

    Only the classic model has the transparency `alpha` in [0, 1]. Only the additive one has the exponent `hardness` of
    highlights and the switch `fresnel`: at 1 Schlick's approximation takes the place of `reflectivity`, between 0 and 1
    both are mixed. It and the physical one have the weights `reflectivity` of the mirror ray and `transmission` of the
    refracted one, both in [0, 1]. Only the physical one has the radiance `emission`, the `absorption` inside of what it
    fills, per world unit, and a `texture`.
    """

    ambient: Vectors = _color("classic", "additive", additive=0.05, quantity=SHINE)
    diffuse: Vectors = _color(additive=0.78)
    specular: Vectors = _color("classic", "additive", additive=0.2)
    alpha: Numbers = _weight("classic")
    ior: Numbers = _index(default=(1.0,), model_defaults={"additive": (1.45,), "physical": (1.5,)})
    hardness: Numbers = _scalar(1000.0, NOT_NEGATIVE, only=("additive",))
    reflectivity: Numbers = _weight("additive", "physical")
    fresnel: Numbers = _weight("additive")
    transmission: Numbers = _weight("additive", "physical")
    emission: Vectors = _color("physical", quantity=LIGHT)
    absorption: Vectors = _color("physical", limit=NOT_NEGATIVE, quantity=PER_LENGTH)
    texture: tuple[int, ...] = _column(only=PHYSICAL, without="")


class AbbeMaterials(Materials):
    """Materials with dispersion: `ior` is that at 587.56 nm, `abbe` > 0 Abbe's number V."""

    abbe: Numbers = attribute(after="ior", only=PHYSICAL, limit=POSITIVE, quantity=AMOUNT)


class ChannelMaterials(Materials):
    """Materials with an index of refraction for each channel.

    A block may have the name of a `glass` in the place of `ior`; a scene has the indices alone, and None here.
    """

    ior: Vectors = _index(RGB)
    glass: tuple[None, ...] = attribute(value_type="glass", without="")


class Planes(Shapes):
    """Two-sided planes through `point`; `normal` is kept as the file gives it and need not have length one."""

    normal: Vectors = _direction()
    point: Vectors = _point()


def _place(*sized_by: str) -> Any:
    """The point that says where a body is, which a search moves all over the picture."""
    return _point(VECTOR._replace(scale="block", sized_by=sized_by, role="position"))


def _half() -> Any:
    return _direction(quantity=VECTOR)


def _bend(sign: int) -> Any:
    """The curvature of a face of a lens, which bulges: `sign` is which way."""
    words = "0 or greater (1 over" if sign > 0 else "0 or less (minus 1 over"
    limit = Limit(lambda values: bool(np.all(sign * values >= 0)), f"{words} the radius: no face of a lens is hollow)")
    ranges = ABOVE_ZERO if sign > 0 else ((-math.inf, 0.0),)
    return attribute(limit=limit, quantity=Quantity("unit of 1 / world unit", dimension=-1, ranges=ranges))


class Spheres(Shapes):
    """Spheres with outward normals."""

    center: Vectors = _place("radius")
    radius: Numbers = _length()


class CutSpheres(Spheres):
    """Spheres without what lies on the side of the vector `cut` of the plane through the center: half balls."""

    cut: Vectors = _direction()


class Boxes(Shapes):
    """Blocks `center + u right + v up + w depth n` with u, v, w from -1 to 1 and n the direction of right x up.

    `right` and `up` are orthogonal, as a rectangle's; `depth` is half the third side.
    """

    center: Vectors = _place("right", "up", "depth")
    right: Vectors = _half()
    up: Vectors = _half()
    depth: Numbers = _length()


class Prisms(Shapes):
    """Prisms with a refracting edge and a base.

    Args:
        point: the middle of the refracting edge.
        axis: half of that edge.
        down: from there to the middle of the base, at right angles to the edge and to the base.
        apex: the angle between the two faces that meet in the edge, in degrees; `down` halves it.
    """

    point: Vectors = _place("axis", "down")
    axis: Vectors = _half()
    down: Vectors = _half()
    apex: Numbers = _angle()


class Cylinders(Shapes):
    """Rods and discs `radius` thick around `center`; `axis` leads from there to the middle of an end."""

    center: Vectors = _place("axis", "radius")
    axis: Vectors = _half()
    radius: Numbers = _length()


class CutCylinders(Cylinders):
    """Cylinders without what lies on the side of the vector `cut` of the plane through the center: half discs."""

    cut: Vectors = _direction()


class Lenses(Shapes):
    """Lenses with two faces that are parts of balls, or flat, and a cylinder as their rim.

    Args:
        center: the middle of the thickness on the axis.
        axis: a direction along the axis, that of the light.
        curvature1: 1 over the radius of the face that the light meets first; 0 of a flat one.
        curvature2: of the last face, negative, as its center lies on the side that the light comes from.
        thickness: on the axis.
        diameter: of the rim.
    """

    center: Vectors = _place("diameter", "thickness")
    axis: Vectors = _direction()
    curvature1: Numbers = _bend(1)
    curvature2: Numbers = _bend(-1)
    thickness: Numbers = _length()
    diameter: Numbers = _length()


class Rectangles(Shapes):
    """Two-sided rectangles `center + u right + v up` with u and v from -1 to 1; `right` and `up` are orthogonal."""

    center: Vectors = _point(VECTOR._replace(scale="block", sized_by=("right", "up")))
    right: Vectors = _half()
    up: Vectors = _half()


class Slabs(Shapes):
    """Liquid or glass between parallel planes, such as a tank: without end sideways, with a clear wall on either side.

    Args:
        point: on the front face.
        normal: out of that face, of any length.
        thickness: along the normal, from outer face to outer face.
        wall: the thickness of each wall; 0 for none.
        wall_ior: the walls' index of refraction.
    """

    material: tuple[int, ...] = _column(only=PHYSICAL)
    point: Vectors = _point(only=PHYSICAL)
    normal: Vectors = _direction(only=PHYSICAL)
    thickness: Numbers = _length(only=PHYSICAL)
    wall: Numbers = _scalar(0.0, NOT_NEGATIVE, LENGTH, only=PHYSICAL)
    wall_ior: Numbers = _index(default=(1.5,), only=PHYSICAL)
