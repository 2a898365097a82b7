"""A scene of Mitsuba 3 as one of ours: what the physical model covers; the rest is named."""

import contextlib
import dataclasses
import itertools
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from raytrace_jax.errors import SceneError
from raytrace_jax.exchange.mitsuba_materials import BLACK, Read, read_bsdf, read_medium, read_radiance
from raytrace_jax.exchange.mitsuba_properties import check_properties
from raytrace_jax.exchange.mitsuba_textures import read_sky
from raytrace_jax.exchange.mitsuba_xml import read_plugins, resolved
from raytrace_jax.exchange.plugins import Color, LookAt, Matrix, Plugin, Point, transform_of
from raytrace_jax.scene import build
from raytrace_jax.scene.description import Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import MAX_BOUNCES

EQUAL = 1e-9
"""Lengths that differ by a smaller share are equal, and directions that lean less are at right angles."""


def import_scene(path: str | os.PathLike[str], *, dtype: DTypeLike | None = None) -> tuple[Scene, tuple[str, ...]]:
    """Read a scene of Mitsuba 3, in XML.

    It reads perspective cameras; spheres and rectangles; dielectric, conductor and diffuse surfaces and what is
    two-sided; area, point and constant emitters and environments; bitmaps and checkerboards; homogeneous media that
    absorb.

    Args:
        path: the file.
        dtype: floating dtype of the scene's arrays; None means JAX's default.

    Returns:
        The scene; and what of the file it lacks or represents differently, a few words each.

    Raises:
        SceneError: the file cannot be read or is no scene of Mitsuba, it has no camera, or one of its pictures cannot
            be read.
    """
    reader = _Importer(Path(path))
    plugins = resolved(read_plugins(path), str(path))
    check_properties(plugins, str(path), reader.lost)
    for plugin in plugins:
        read = getattr(reader, f"read_{plugin.tag}", None)
        if read is not None:
            with named(path, plugin):
                read(plugin)
    return reader.scene(dtype), tuple(dict.fromkeys(reader.lost))


@contextlib.contextmanager
def named(path: str | os.PathLike[str], plugin: Plugin) -> Iterator[None]:
    """Let errors say in which file and plugin they are, where they do not."""
    try:
        yield
    except SceneError as error:
        if str(error).startswith(str(path)):
            raise
        raise SceneError(f"{path}: {plugin.tag} {plugin.name or plugin.kind}: {error}") from error


@dataclasses.dataclass
class _Shape:
    """A shape that was read: what makes its block, what its surface does, and whether a medium is around it."""

    construct: Callable[..., Description]
    name: str
    numbers: dict[str, Any]
    surface: Read
    material: str
    is_within: bool


class _Importer:
    """What was read so far."""

    def __init__(self, path: Path):
        self.path = path
        self.lost: list[str] = []
        self.camera: Description | None = None
        self.settings: dict[str, Any] = {"model": "physical"}
        self.background: list[Description] = []
        self.lights: list[Description] = []
        self.textures: list[Description] = []
        self.shapes: list[_Shape] = []
        self.names: dict[str, set[str]] = {}

    def name(self, kind: str, said: str) -> str:
        """A name that a block may have, another one for each block of a kind."""
        word = re.sub(r"[^\w-]+", "_", said).strip("_") or kind
        taken = self.names.setdefault(kind, set())
        found = next(
            name for name in itertools.chain([word], (f"{word}{k}" for k in itertools.count(2))) if name not in taken
        )
        taken.add(found)
        return found

    def read_integrator(self, plugin: Plugin) -> None:
        """How often paths bounce."""
        if plugin.kind not in ("path", "volpath", "volpathmis"):
            self.lost.append(f"integrator {plugin.kind}: paths are followed")
        if plugin.values.get("hide_emitters") is True:
            self.lost.append("integrator: hide_emitters; what shines is seen")
        depth = plugin.values.get("max_depth", -1)
        bounces = int(depth) - 1 if isinstance(depth, int | float) and depth > 0 else MAX_BOUNCES
        if bounces >= MAX_BOUNCES:
            self.lost.append(f"max_depth {depth}: a path bounces {MAX_BOUNCES} times at most")
        self.settings["max_bounces"] = min(max(bounces, 0), MAX_BOUNCES)

    def read_sensor(self, plugin: Plugin) -> None:
        """Read the camera, the first one of several."""
        if self.camera is not None or plugin.kind not in ("perspective", "thinlens"):
            self.lost.append(f"sensor {plugin.name or plugin.kind} of type {plugin.kind}")
            return
        if plugin.kind == "thinlens":
            self.lost.append("sensor thinlens: all is in focus")
        values, film = plugin.values, plugin.values.get("film")
        film_values = film.values if isinstance(film, Plugin) else {}
        # Mitsuba's film has 768 x 576 pixels where nothing is said.
        width, height = (int(_number(film_values, key, side)) for key, side in (("width", 768), ("height", 576)))
        self.lost += [f"film {key}" for key in film_values if key.startswith("crop_")]
        pixels = film_values.get("rfilter")
        if not isinstance(pixels, Plugin) or pixels.kind != "box":
            kind = pixels.kind if isinstance(pixels, Plugin) else "gaussian"
            self.lost.append(f"rfilter {kind}: a pixel is the mean over its square, as of a box")
        world = values.get("to_world", Matrix(np.eye(4)))
        if isinstance(world, LookAt):
            origin, target, up = world
        elif isinstance(world, Matrix):
            matrix = world.values
            origin, target, up = matrix[:3, 3], matrix[:3, 3] + matrix[:3, 2], matrix[:3, 1]
            if np.linalg.det(matrix[:3, :3]) < 0:
                self.lost.append("sensor to_world: the picture is mirrored there")
        else:
            raise SceneError(f"{self.path}: the sensor's to_world is no transform.")
        aside, below = (_number(values, f"principal_point_offset_{axis}", 0.0) for axis in "xy")
        center = {}
        if aside or below:
            center = {"center": ((0.5 - aside) * width - 0.5, (0.5 - below) * height - 0.5)}
        self.camera = build.camera(
            self.name("camera", plugin.name or "eye"),
            pixeldim=(width, height),
            viewpoint=tuple(map(float, origin)),
            lookat=tuple(map(float, target)),
            up=tuple(map(float, up)),
            fov=_horizontal_fov(values, width, height),
            **center,
        )

    def read_emitter(self, plugin: Plugin) -> None:
        """A light, or what is all around."""
        if plugin.kind == "point":
            position = plugin.values.get("position")
            world = transform_of(plugin)
            place = position.values if isinstance(position, Point) else (0.0, 0.0, 0.0)
            place = tuple(map(float, (world @ np.array([*place, 1.0]))[:3]))
            name = self.name("light", plugin.name or "light")
            self.lights.append(build.light(name, location=place, emissivity=_color(plugin.values, "intensity", 1.0)))
        elif plugin.kind == "constant":
            name = self.name("background", plugin.name or "sky")
            self.background = [build.background(name, radiance=_color(plugin.values, "radiance", 1.0))]
        elif plugin.kind == "envmap":
            sky = self.name("texture", str(plugin.values.get("filename", "")).removesuffix(".exr").split(".")[-1])
            name = self.name("background", plugin.name or "sky")
            texels = read_sky(plugin, self.path, self.lost)
            scale = _number(plugin.values, "scale", 1.0)
            self.textures.append(build.texture(sky, kind="image", file=texels, wrap="repeat"))
            self.background = [build.background(name, radiance=(scale,) * 3, texture=sky)]
        else:
            self.lost.append(f"emitter {plugin.name or plugin.kind} of type {plugin.kind}")

    def read_shape(self, plugin: Plugin) -> None:
        """A sphere or a rectangle with what it is made of."""
        called = plugin.name or plugin.kind
        if plugin.kind not in ("sphere", "rectangle"):
            self.lost.append(f"shape {called} of type {plugin.kind}")
            return
        numbers = (self.sphere if plugin.kind == "sphere" else self.rectangle)(plugin, transform_of(plugin), called)
        if numbers is None:
            return
        halves = None
        if plugin.kind == "rectangle":
            halves = np.array([np.linalg.norm(numbers[side]) for side in ("right", "up")])
        surface = read_bsdf(plugin, self.path, called, halves, self.lost)
        surface = read_medium(plugin, called, surface, self.lost)
        surface = read_radiance(plugin, self.path, called, halves, surface, self.lost)
        if plugin.kind == "rectangle" and surface.inside:
            self.lost.append(f"shape {called}: flat glass, which has no inside here; it is left out")
            return
        name = self.name("shape", called)
        if plugin.kind == "rectangle" and surface.emission != (0, 0, 0) and self.is_behind(plugin, numbers):
            self.lost.append(f"shape {called}: it shines to the camera too, from its back")
        is_within = "exterior" in plugin.values
        construct = build.sphere if plugin.kind == "sphere" else build.rectangle
        self.shapes.append(_Shape(construct, name, numbers, surface, surface.name or f"{name}_material", is_within))

    def is_behind(self, plugin: Plugin, numbers: Mapping[str, Any]) -> bool:
        """Whether the camera, where it was read, sees the back of a rectangle."""
        normal = np.cross(numbers["right"], numbers["up"])
        side = -1 if plugin.values.get("flip_normals") is True else 1
        eye = np.array(self.camera.values["viewpoint"]) if self.camera else np.array(numbers["center"]) + side * normal
        return bool(side * normal @ (eye - numbers["center"]) < 0)

    def sphere(self, plugin: Plugin, matrix: np.ndarray, called: str) -> dict[str, Any] | None:
        """The numbers of a sphere; None for an ellipsoid."""
        center = plugin.values.get("center")
        place = center.values if isinstance(center, Point) else (0.0, 0.0, 0.0)
        radius = _number(plugin.values, "radius", 1.0)
        gram = matrix[:3, :3].T @ matrix[:3, :3]
        if not np.allclose(gram, gram[0, 0] * np.eye(3), rtol=0, atol=EQUAL * np.abs(gram).max()):
            self.lost.append(f"shape {called}: its to_world makes it an ellipsoid")
            return None
        if plugin.values.get("flip_normals") is True:
            self.lost.append(f"shape {called}: flip_normals")
        moved = tuple(map(float, (matrix @ np.array([*place, 1.0]))[:3]))
        return {"center": moved, "radius": radius * math.sqrt(gram[0, 0])}

    def rectangle(self, plugin: Plugin, matrix: np.ndarray, called: str) -> dict[str, Any] | None:
        """The numbers of a rectangle; None for one that is askew."""
        right, up = matrix[:3, 0], matrix[:3, 1]
        if abs(right @ up) > EQUAL * np.linalg.norm(right) * np.linalg.norm(up):
            self.lost.append(f"shape {called}: its sides are not at right angles")
            return None
        vectors = {"center": matrix[:3, 3], "right": right, "up": up}
        return {key: tuple(map(float, vector)) for key, vector in vectors.items()}

    def scene(self, dtype: DTypeLike | None) -> Scene:
        """The scene of all that was read. Raises SceneError if there is no camera."""
        if self.camera is None:
            raise SceneError(f"{self.path}: has no perspective sensor.")
        self.give_indices()
        self.tell_matt()
        materials: dict[str, tuple[Read, str]] = {}
        blocks = []
        for shape in self.shapes:
            # Shapes that refer to one material have it in common, where it is the same for both.
            known = materials.get(shape.material)
            if known is None or not known[0].is_like(shape.surface):
                materials[shape.material] = known = shape.surface, self.name("material", shape.material)
                blocks += shape.surface.blocks(known[1], lambda said: self.name("texture", said))
            blocks.append(shape.construct(shape.name, material=known[1], **shape.numbers))
        settings = build.settings("main", **self.settings)
        every = [settings, self.camera, *self.background, *self.lights, *self.textures, *blocks]
        return build.make_scene(*every, dtype=dtype)

    def tell_matt(self) -> None:
        """Name the matt surfaces that get no light of what shines but a point."""
        kinds = ["the sky"] if self.background else []
        if any(shape.surface.emission != BLACK for shape in self.shapes):
            kinds.append("shapes that shine")
        matt = [shape.name for shape in self.shapes if shape.surface.diffuse != BLACK]
        if kinds and matt:
            are = "is matt and lit" if len(matt) == 1 else "are matt and lit"
            self.lost.append(f"{', '.join(matt)} {are} by point lights alone, not by {' or '.join(kinds)}")

    def give_indices(self) -> None:
        """Turn inner and outer indices into those against vacuum, from the largest ball of glass to the smallest."""
        glass = [shape for shape in self.shapes if shape.surface.inside and "radius" in shape.numbers]
        done: list[_Shape] = []
        for shape in sorted(glass, key=lambda shape: -shape.numbers["radius"]):
            holding = [other for other in done if _holds(other.numbers, shape.numbers)]
            around = min(holding, key=lambda other: other.numbers["radius"]).surface if holding else None
            surface = shape.surface
            if around is not None and around.inside == surface.outside:
                ior = surface.inside * (around.ior / around.inside)
            else:
                ior = surface.inside / surface.outside * (1.0 if around is None else around.ior)
            shape.surface = dataclasses.replace(surface, ior=ior)
            done.append(shape)
        for shape in self.shapes:
            if shape.is_within and not any(_holds(other.numbers, shape.numbers) for other in done):
                self.lost.append(f"shape {shape.name}: exterior; there is nothing around it")


def _holds(outer: Mapping[str, Any], inner: Mapping[str, Any]) -> bool:
    """Whether a ball lies in another; a rectangle lies in none."""
    if "radius" not in inner:
        return False
    apart = float(np.linalg.norm(np.subtract(outer["center"], inner["center"])))
    return apart + inner["radius"] <= outer["radius"] and inner["radius"] < outer["radius"]


def _horizontal_fov(values: Mapping[str, Any], width: int, height: int) -> float:
    """The horizontal angle of view in degrees, from an angle along any side or from a focal length."""
    said, axis = values.get("fov"), values.get("fov_axis", "x")
    if said is None:
        length = str(values.get("focal_length", 50.0)).removesuffix("mm")
        try:
            millimetres = float(length)
        except ValueError as cause:
            raise SceneError(f"focal_length is {length!r}, and a number of millimetres is wanted, as 50mm.") from cause
        # Focal lengths are meant for a film of 36 x 24 mm.
        said, axis = math.degrees(2 * math.atan(math.hypot(36, 24) / (2 * millimetres))), "diagonal"
    fov = _number({"fov": said}, "fov", 0.0)
    if axis in ("smaller", "larger"):
        axis = "x" if (width < height) == (axis == "smaller") else "y"
    sides = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    if axis not in sides:
        raise SceneError(f"fov_axis is {axis!r}, and there are {', '.join(sides)}, smaller, larger.")
    side = sides[axis]
    if side == width:
        return fov
    return math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * width / side))


def _number(values: Mapping[str, Any], key: str, default: float) -> float:
    found = values.get(key, default)
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise SceneError(f"{key} is {found!r}, and a number is wanted.")
    return float(found)


def _color(values: Mapping[str, Any], key: str, default: float) -> tuple[float, float, float]:
    found = values.get(key, default)
    if isinstance(found, int | float):
        return float(found), float(found), float(found)
    if not isinstance(found, Color):
        raise SceneError(f"{key} is {type(found).__name__.lower()}, and a colour is wanted.")
    return found.values
