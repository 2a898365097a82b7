"""A physical scene in plain numbers, as the writers for other renderers take them and the import makes them."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.linalg import norm

from ..errors import SceneError
from ..scene import build
from ..scene.parameters import Block, blocks_of, material_of, shape_blocks
from ..scene.response import active_effects, without_idle
from ..scene.rows import Description, describe
from ..scene.scene import PerspectiveCamera, Scene
from ..scene.slabs import with_planes
from ..tracer.geometry.camera import pixel_step, ray
from ..tracer.geometry.plane import LEVEL
from ..tracer.settings import ResolvedSettings
from .media import PARALLEL, Surface, surface_media

Vector = Float[np.ndarray, "3"]
Triple = tuple[float, ...]
Colour = Vector | Triple

MATERIAL_FIELDS = ("diffuse", "emission", "absorption", "reflectivity", "transmission")
"""The colours and weights of a physical material that all of it may have."""


class Texture(NamedTuple):
    """A texture: a checker board of two colours, or a picture, scene-linear, the top row first, as in `scene.Images`.

    Squares of a checker board have a side in world units; one of them begins at the offset.
    """

    name: str
    colors: tuple[Colour, ...] = ()
    square: float = 1.0
    offset: Float[np.ndarray, "2"] | Triple = (0.0, 0.0)
    texels: Float[np.ndarray, "3 height width"] | None = None
    filter: str = "bilinear"
    wrap: str = "repeat"

    @property
    def mean(self) -> Triple:
        """The mean colour."""
        colors = np.array(self.colors).T if self.texels is None else self.texels.reshape(3, -1)
        return tuple(map(float, colors.mean(axis=1)))

    def block(self, name: str) -> Description:
        if self.texels is not None:
            return build.texture(name, kind="image", file=self.texels, filter=self.filter, wrap=self.wrap)
        first, second = self.colors
        return build.texture(name, kind="checker", color1=first, color2=second, square=self.square, offset=self.offset)

    def is_like(self, other: "Texture | None") -> bool:
        """Whether another one shows the same, whatever it is called."""
        return other is not None and bool(eqx.tree_equal(self._replace(name=""), other._replace(name="")))


BLACK = (0.0, 0.0, 0.0)


class PinholeView(NamedTuple):
    """The rays of a picture: pixel `(column, row)` looks from `eye` along a direction that is linear in both.

    `given` is the perspective camera of the scene; None where it has another one, or where its angle is not that of all
    pixels, for the first and the last one look along the picture's borders.
    """

    name: str
    size: tuple[int, int]  # (width, height) in pixels.
    eye: Vector
    middle: Vector  # The direction, of any length, of the picture's middle.
    across: Vector  # How the direction changes over the whole width, from left to right.
    upwards: Vector  # How it changes over the whole height, from the bottom to the top.
    given: PerspectiveCamera | None


class Material(NamedTuple):
    """What a surface is made of; the fields are those of a physical material in `scene.Materials`."""

    name: str
    diffuse: Colour = BLACK
    emission: Colour = BLACK
    absorption: Colour = BLACK
    ior: float = 1.0
    reflectivity: float = 0.0
    transmission: float = 0.0
    texture: Texture | None = None
    inside: float = 0.0  # The index within a glass and that around it, as a file says that is imported.
    outside: float = 1.0

    @property
    def is_glass(self) -> bool:
        return self.transmission > 0

    def is_like(self, other: "Material") -> bool:
        """Whether another one, of tuples as this one, is the same."""
        if self.texture is not None and self.texture.is_like(other.texture):
            other = other._replace(texture=self.texture)
        return bool(eqx.tree_equal(self, other))

    def blocks(self, name: str, texture_name: Callable[[str], str]) -> list[Description]:
        """The block of a material of tuples, after that of its texture where it has one."""
        values: dict[str, Any] = {key: getattr(self, key) for key in MATERIAL_FIELDS}
        values = {key: value for key, value in values.items() if value not in (BLACK, 0.0)}
        if self.is_glass:
            values["ior"] = self.ior
        if self.texture is None:
            return [build.material(name, **values)]
        texture = texture_name(self.texture.name or f"{name}_texture")
        return [self.texture.block(texture), build.material(name, texture=texture, **values)]


class Shape(NamedTuple):
    """A shape: its keyword, its name, the numbers of its block by name, and its material."""

    keyword: str
    name: str
    numbers: dict[str, Any]
    material: Material
    outside: Material | None = None  # The media on both sides of its surface; None is vacuum.
    inside: Material | None = None
    around: tuple[Material | None, ...] = ()  # All media that it is in.
    is_hidden: bool = False  # Its surface is that of an earlier shape.
    surface: Surface | None = None  # None where it was not asked for.

    @property
    def is_body(self) -> bool:
        """Whether it has several faces."""
        return self.keyword not in ("plane", "rectangle", "sphere") or "cut" in self.numbers

    def block(self, material: str) -> Description:
        """The block of a shape that has the material of this name."""
        return describe(self.keyword, self.name, {"material": material, **self.numbers})

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """A plane's directions to the right and upwards, in which a texture lies on it; see `plane.frame`."""
        n = unit(self.numbers["normal"])
        across = np.cross([0.0, 1.0, 0.0], n)
        right = unit(across) if norm(across) > LEVEL else np.array([1.0, 0.0, 0.0])
        return right, np.cross(n, right)


class Described(NamedTuple):
    """A scene; its lights and shapes are in the order of the file."""

    view: PinholeView
    radiance: Vector
    background: str  # Its name; empty where there is none.
    sky: Texture | None  # The picture all around that `radiance`, the background's, scales.
    lights: tuple[tuple[str, Vector, Vector], ...]  # The name, place and radiant intensity of each point light.
    shapes: tuple[Shape, ...]
    eye_medium: Material | None  # What the camera is in.
    far_media: tuple[Material | None, ...]  # What is far away.
    settings: ResolvedSettings
    lost: tuple[str, ...]  # What neither of the other programs can be told, a few words each.

    def glass(self) -> list[Shape]:
        """The shapes with an inside that light goes through."""
        return [shape for shape in self.shapes if shape.material.is_glass and shape.keyword != "rectangle"]

    def materials(self) -> list[Material]:
        """What the shapes are made of, each once."""
        return list({shape.material.name: shape.material for shape in self.shapes}.values())


def describe_scene(scene: Scene, settings: ResolvedSettings) -> Described:
    """The scene in plain numbers.

    Raises:
        SceneError: it is of another model, or only a window of its picture is rendered.
    """
    if settings.model != "physical":
        raise SceneError(
            f"the scene's model is {settings.model}; only the physical model can be exported: --model physical."
        )
    if settings.crop is not None or settings.binning != 1:
        raise SceneError("a whole picture is exported, without crop and binning.")
    scene, lost = with_planes(scene), []
    media, blocks = surface_media(scene, settings), shape_blocks(scene)
    materials = [_material(scene, material_of(scene, block), lost) for block in blocks]

    def of(place: int | None) -> Material | None:
        return None if place is None else materials[place]

    shapes = tuple(
        Shape(
            block.keyword,
            block.name,
            _numbers(scene, block),
            materials[k],
            *map(of, media.sides[k]),
            around=tuple(map(of, media.around[k])),
            is_hidden=media.hidden[k],
            surface=media.surfaces[k],
        )
        for k, block in enumerate(blocks)
    )
    if settings.has_path_limit:
        lost.append(f"path_limit {settings.path_limit:g}: paths end by their bounces alone")
    if scene.film is not None:
        lost += [
            f"{scene.film.name}.{effect.name}: the other program's camera does nothing to the light"
            for effect in active_effects(without_idle(scene.film))
        ]
    lost += [f"camera {name}: the file has one camera, {scene.camera.name}" for name in scene.cameras[1:]]
    background, lights = scene.background, scene.lights
    behind = next(iter(blocks_of(scene, "background")), None)
    sky = behind.refers_to(scene, "texture") if behind else None
    return Described(
        view=_view(scene, settings, lost),
        radiance=_numeric(background.radiance) if background else np.zeros(3),
        background=background.name if background else "",
        sky=_texture(scene, sky),
        lights=tuple(zip(lights.names, _numeric(lights.location).T, _numeric(lights.emissivity).T, strict=True)),
        shapes=shapes,
        eye_medium=of(media.eye),
        far_media=tuple(map(of, media.far)),
        settings=settings,
        lost=tuple(dict.fromkeys(lost)),
    )


def _view(scene: Scene, settings: ResolvedSettings, lost: list[str]) -> PinholeView:
    camera, given = scene.camera, None
    if isinstance(camera, PerspectiveCamera):
        if settings.mapping != "corner":
            given = camera
        if np.any(np.asarray(camera.distortion)):
            lost.append(f"{camera.name}.distortion: the lens is taken to be without")
            camera = dataclasses.replace(camera, distortion=jnp.zeros_like(camera.distortion))
    places = np.array([[0.5, 0.0, 1.0, 0.5, 0.5], [0.5, 0.5, 0.5, 0.0, 1.0]])
    eye, directions = eqx.filter_jit(ray)(camera, *jnp.asarray(places))
    middle, left, right, bottom, top = np.asarray(directions, np.float64).T
    width, height = settings.picture_size(camera.pixeldim)
    step = pixel_step(camera, settings)
    across, upwards = (right - left) * step[0] * width, (top - bottom) * -step[1] * height
    return PinholeView(camera.name, (width, height), _numeric(eye[:, 0]), middle, across, upwards, given)


def _numbers(scene: Scene, block: Block) -> dict[str, Any]:
    return {name: _numeric(value) for name, value in block.read_all(scene).items()}


def _material(scene: Scene, block: Block, lost: list[str]) -> Material:
    numbers = _numbers(scene, block)
    if np.ndim(numbers["ior"]):
        lost.append(f"{block.name}.ior: three indices; the green channel's is taken for all")
        numbers["ior"] = float(numbers["ior"][1])
    if "abbe" in numbers:
        lost.append(f"{block.name}.abbe: dispersion; the index at 587.56 nm is taken for all channels")
    if 0 < numbers["transmission"] < 1 or (numbers["transmission"] and np.any(numbers["emission"])):
        lost.append(f"{block.name}: glass that is something else as well; it is written as clear glass")
    texture = _texture(scene, block.refers_to(scene, "texture"))
    return Material(block.name, **{name: numbers[name] for name in (*MATERIAL_FIELDS, "ior")}, texture=texture)


def _texture(scene: Scene, block: Block | None) -> Texture | None:
    if block is None:
        return None
    numbers = _numbers(scene, block)
    if numbers:
        colors = (numbers.pop("color1"), numbers.pop("color2"))
        return Texture(block.name, colors, **numbers)
    texels = _numeric(block.read(scene, "texels"))
    return Texture(block.name, texels=texels, filter=block.read(scene, "filter"), wrap=block.read(scene, "wrap"))


def _numeric(values: object) -> Any:
    """Numbers of a scene in double precision: an array, a float where it is a single number."""
    array = np.asarray(values, np.float64)
    return array if array.ndim else array.item()


def touch(a: Shape, b: Shape) -> bool:
    """Whether two shapes without planes have any point in common, on their surfaces or inside; bodies are sampled."""
    if a.is_body or b.is_body:
        return any(map(np.any, _held(a, b)))
    return bool(_apart(a, b) < a.numbers["radius"] + b.numbers["radius"])


def overlap(a: Shape, b: Shape) -> bool:
    """Whether the surfaces of two shapes with an inside cut one another; a rounding is no cut, bodies are sampled."""
    if a.is_body or b.is_body:
        return any(np.any(held) and not np.all(held) for held in _held(a, b))
    if a.keyword == b.keyword == "plane":
        return bool(norm(np.cross(unit(a.numbers["normal"]), unit(b.numbers["normal"]))) > PARALLEL)
    if a.keyword == b.keyword:
        return touch(a, b) and bool(_apart(a, b) > abs(a.numbers["radius"] - b.numbers["radius"]))
    plane, ball = (a, b) if a.keyword == "plane" else (b, a)
    height = (ball.numbers["center"] - plane.numbers["point"]) @ unit(plane.numbers["normal"])
    return bool(abs(height) < (1 - PARALLEL) * ball.numbers["radius"])


def _held(a: Shape, b: Shape) -> list[np.ndarray]:
    """Of each of two shapes, a body among them, which points are inside of the other; of planes none."""
    assert a.surface is not None and b.surface is not None, "an import has no bodies to compare"
    pairs = ((a, a.surface, b.surface), (b, b.surface, a.surface))
    return [other.holds(own) for shape, own, other in pairs if shape.keyword != "plane"]


def reach(shapes: Iterable[Shape], eye: np.ndarray) -> float:
    """How far from the eye the farthest of some shapes ends; of a plane, and of flat glass, where its middle is."""

    def far(shape: Shape) -> float:
        numbers, ends = shape.numbers, shape.keyword != "rectangle" or not shape.material.is_glass
        names = ("right", "up", "depth", "axis", "down", "radius", "diameter")
        sides = [norm(numbers[side]) for side in names if side in numbers and ends]
        middle = numbers["center"] if "center" in numbers else numbers["point"]
        return float(norm(np.subtract(middle, eye)) + sum(sides))

    return max(map(far, shapes), default=0.0)


def unit(vector: np.ndarray) -> np.ndarray:
    """The vector of length one in the direction of another."""
    return vector / norm(vector)


def _apart(a: Shape, b: Shape) -> float:
    return float(norm(np.subtract(a.numbers["center"], b.numbers["center"])))
