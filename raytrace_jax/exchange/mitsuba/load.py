"""The import of Mitsuba 3's scenes: what the physical model covers is read, the rest is named."""

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from ...errors import RaytraceError, SceneError
from ...images.exif import DIAGONAL_OF_FILM
from ...scene import build
from ...scene.rows import Description
from ...scene.scene import Scene
from ...scene.setting_words import MAX_BOUNCES
from ...tracer.settings import resolve_settings
from ...util.files import StrPath
from ..described import BLACK, Material, Shape, unit
from ..media import SurfaceMedia, surface_media
from .parser import KNOWN, read_plugins, unread_properties
from .plugins import Plugin, numbered
from .shapes import deepest_first, endless_glass, is_end, other_side, read_medium, read_shape, read_sky, with_indices


def import_scene(path: StrPath, *, dtype: DTypeLike | None = None) -> tuple[Scene, tuple[str, ...]]:
    """Read a scene of Mitsuba 3, in XML.

    It reads perspective cameras; spheres, rectangles, cubes and cylinders; dielectric, conductor and diffuse surfaces
    and what is two-sided; area, point and constant emitters and environments; bitmaps and checkerboards; homogeneous
    media that absorb.

    Args:
        dtype: floating dtype of the scene's arrays; None means JAX's default.

    Returns:
        The scene; and what of the file it lacks or represents differently, a few words each.

    Raises:
        SceneError: the file cannot be read or is no scene of Mitsuba, it has no camera, or one of its pictures cannot
            be read.
    """
    reader = _Importer(Path(path))
    plugins = read_plugins(path)
    reader.lost += unread_properties(plugins)
    # Shapes are read by the camera, wherever it stands; and cylinders by the discs at their ends.
    reader.discs = [plugin for plugin in plugins if plugin.tag == "shape" and plugin.kind == "disk"]
    for plugin in sorted(plugins, key=lambda one: (one.tag != "sensor", one.kind == "disk")):
        read = getattr(reader, f"read_{plugin.tag}", None)
        if read is not None:
            try:
                read(plugin)
            except RaytraceError as error:
                raise SceneError(f"{path}: {plugin.tag} {plugin.called}: {error}") from error
    return reader.scene(dtype), tuple(dict.fromkeys(reader.lost))


class _Importer:
    """What was read so far."""

    def __init__(self, path: Path):
        self.path = path
        self.lost: list[str] = []
        self.camera: Description | None = None
        self.eye_medium = Material("")
        self.settings: dict[str, Any] = {"model": "physical"}
        self.background: list[Description] = []
        self.others: list[Description] = []
        self.shapes: list[Shape] = []
        self.discs: list[Plugin] = []  # Of no cylinder yet.
        self.names: dict[str, set[str]] = defaultdict(set)

    def name(self, kind: str, said: str) -> str:
        """A name that a block may have, another one for each block of a kind."""
        word = re.sub(r"[^\w-]+", "_", plain_name(said)).strip("_") or kind
        names = self.names[kind]
        name = next(name for name in numbered(word, "") if name not in names)
        names.add(name)
        return name

    def skip(self, plugin: Plugin) -> None:
        self.lost.append(f"{plugin.tag} {plugin.called} of type {plugin.kind}")

    def read_integrator(self, plugin: Plugin) -> None:
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
            return self.skip(plugin)
        self.eye_medium = read_medium(plugin.values.get("medium"), self.eye_medium, self.lost)
        self.camera = read_camera(plugin, self.name("camera", plugin.name or "eye"), self.lost)

    def read_emitter(self, plugin: Plugin) -> None:
        if plugin.kind == "point":
            name, emissivity = self.name("light", plugin.name or "light"), plugin.color("intensity", 1.0)
            self.others.append(build.light(name, location=plugin.place("position"), emissivity=emissivity))
        elif plugin.kind == "constant":
            name = self.name("background", plugin.name or "sky")
            self.background = [build.background(name, radiance=plugin.color("radiance", 1.0))]
        elif plugin.kind == "envmap":
            file = Path(str(plugin.values.get("filename", ""))).name
            sky = self.name("texture", file.removesuffix(".exr").split(".")[-1])
            name = self.name("background", plugin.name or "sky")
            texels = read_sky(plugin, self.lost)
            scale = plugin.number("scale", 1.0)
            self.others.append(build.texture(sky, kind="image", file=texels, wrap="repeat"))
            self.background = [build.background(name, radiance=(scale,) * 3, texture=sky)]
        else:
            self.skip(plugin)

    def read_shape(self, plugin: Plugin) -> None:
        if plugin.kind == "disk" and all(plugin is not disc for disc in self.discs):
            return None
        if plugin.kind not in ("sphere", "rectangle", "cube", "cylinder"):
            return self.skip(plugin)
        lost: list[str] = []
        shape = read_shape(plugin, self.camera.values["viewpoint"] if self.camera else None, lost)
        if shape is not None and plugin.kind == "cylinder":
            ends = [next((disc for disc in self.discs if is_end(disc, plugin, shape, s)), None) for s in (-1, 1)]
            if None in ends:
                lost.append("an open tube; its ends are closed")
            self.discs = [disc for disc in self.discs if all(disc is not end for end in ends)]
        self.lost += [f"shape {plugin.called}: {words}" for words in lost]
        if shape is not None:
            self.shapes.append(shape._replace(name=self.name("shape", plugin.called)))

    def scene(self, dtype: DTypeLike | None) -> Scene:
        """The scene of all that was read. Raises SceneError if there is no camera."""
        if self.camera is None:
            raise SceneError(f"{self.path}: has no perspective sensor.")
        shapes = self.shapes_in_media(self.camera, dtype)
        # Matt surfaces get light from points alone.
        kinds = ["the sky"] if self.background else []
        kinds += ["shapes that shine"] * any(shape.material.emission != BLACK for shape in shapes)
        if kinds:
            lit = f"is matt and lit by point lights alone, not by {' or '.join(kinds)}"
            self.lost += [f"{shape.name} {lit}" for shape in shapes if shape.material.diffuse != BLACK]
        materials: dict[str, list[tuple[Material, str]]] = {}
        blocks = []
        for shape in shapes:
            called = plain_name(shape.material.name) or f"{shape.name}_material"
            same = materials.setdefault(called, [])
            material = shape.material._replace(name=called)
            name = next((name for known, name in same if known.is_like(material)), None)
            if name is None:
                name = self.name("material", called)
                same.append((material, name))
                blocks += material.blocks(name, lambda said: self.name("texture", said))
            blocks.append(shape.block(name))
        settings = build.settings("main", **self.settings)
        return build.make_scene(settings, self.camera, *self.background, *self.others, *blocks, dtype=dtype)

    def shapes_in_media(self, camera: Description, dtype: DTypeLike | None) -> list[Shape]:
        """The shapes in the order in which the tracer has the file's media, with indices against vacuum."""
        shapes = deepest_first(endless_glass(self.shapes, camera.values["viewpoint"], self.lost))
        media = _media(shapes, camera, dtype)
        for shape, (outside, _) in zip(list(shapes), media.sides, strict=True):
            # One plane of a medium without end does for all shapes in it.
            if shape.keyword == "plane" and shape.outside is not None and outside is None:
                shapes.append(other_side(shape, self.name("shape", f"{shape.name}_outside")))
                media = _media(shapes, camera, dtype)
                break
        eye = BLACK if media.eye is None else shapes[media.eye].material.absorption
        if not np.allclose(self.eye_medium.absorption, eye):
            self.lost.append("sensor: medium; what is around it here absorbs otherwise")
        return with_indices(shapes, media, self.lost)


def _media(shapes: Sequence[Shape], camera: Description, dtype: DTypeLike | None) -> SurfaceMedia:
    """The media on both sides of the shapes' surfaces, as the tracer has them."""
    blocks = [build.material("clear", transmission=1.0), build.material("dark")]
    blocks += [shape.block("clear" if shape.material.is_glass else "dark") for shape in shapes]
    scene = build.make_scene(camera, *blocks, dtype=dtype, model="physical")
    return surface_media(scene, resolve_settings(scene, None))


def plain_name(said: str) -> str:
    """The name of a block by an id, which in an export has its tag behind it where another kind has that name."""
    return re.sub(rf"\.({'|'.join(KNOWN)})(\.\d+)?$", "", said)


def read_camera(sensor: Plugin, name: str, lost: list[str]) -> Description:
    """The camera of a sensor; what it has and we have not is added to `lost`."""
    if sensor.kind == "thinlens":
        lost.append("sensor thinlens: all is in focus")
    film = sensor.values.get("film")
    if not isinstance(film, Plugin):
        film = Plugin("film", "hdrfilm", {})
    # Mitsuba's film has 768 x 576 pixels where nothing is said.
    width, height = (int(film.number(key, side)) for key, side in (("width", 768), ("height", 576)))
    lost += [f"film {key}" for key in film.values if key.startswith("crop_")]
    pixels = film.values.get("rfilter")
    kind = pixels.kind if isinstance(pixels, Plugin) else "gaussian"
    if kind != "box":
        lost.append(f"rfilter {kind}: a pixel is the mean over its square, as of a box")
    channels = film.values.get("pixel_format", "rgb")
    if str(channels).lower() not in ("rgb", "rgba"):
        lost.append(f"film pixel_format {channels}: a picture is red, green and blue")
    matrix = sensor.transform()
    origin, up, forward = matrix[:3, 3], matrix[:3, 1], unit(matrix[:3, 2])
    # The axis' point that is nearest to the world's origin, if it is ahead: far off, so that little is rounded away.
    target = origin + max(1.0, float(-origin @ forward)) * forward
    if np.linalg.det(matrix[:3, :3]) < 0:
        lost.append("sensor to_world: the picture is mirrored there")
    aside, below = (sensor.number(f"principal_point_offset_{axis}", 0.0) for axis in "xy")
    center = {}
    if aside or below:
        center = {"center": ((0.5 - aside) * width - 0.5, (0.5 - below) * height - 0.5)}
    return build.camera(
        name,
        pixeldim=(width, height),
        viewpoint=origin,
        lookat=target,
        up=up,
        fov=_horizontal_fov(sensor, width, height),
        **center,
    )


def _horizontal_fov(sensor: Plugin, width: int, height: int) -> float:
    """The horizontal angle of view in degrees, from an angle along any side or from a focal length."""
    if sensor.values.get("fov") is not None:
        fov, axis = sensor.number("fov", 0.0), str(sensor.values.get("fov_axis", "x"))
    else:
        length = str(sensor.values.get("focal_length", 50.0)).removesuffix("mm")
        try:
            millimetres = float(length)
        except ValueError:
            raise SceneError(f"focal_length is {length!r}, and a number of millimetres is wanted, as 50mm.") from None
        fov, axis = math.degrees(2 * math.atan(DIAGONAL_OF_FILM / (2 * millimetres))), "diagonal"
    sides = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    sides |= {"smaller": min(width, height), "larger": max(width, height)}
    if axis not in sides:
        raise SceneError(f"fov_axis is {axis!r}, and there are {', '.join(sides)}.")
    side = sides[axis]
    return fov if side == width else math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * width / side))
