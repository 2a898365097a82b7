"""The tree of plugins of a scene's file, by Mitsuba's own parser, and the properties that its plugins may have."""

import importlib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from raytrace_jax.errors import RaytraceError, SceneError
from raytrace_jax.exchange.mitsuba.plugins import Color, Matrix, Plugin, Point, Value, numbered
from raytrace_jax.util.text import did_you_mean, install

TAGS = {"reconstructionfilter": "rfilter", "phasefunction": "phase"}
"""The tags of Mitsuba's types of objects that are not the types' own names."""

ROLES = {"bsdf", "emitter", "film", "sampler", "rfilter", "phase"}
"""Plugins whose role in another one is their tag, whatever name they are given."""

GREY = {"uniform": "value", "d65": "scale"}
"""Spectra that are white times a number, with that number's name; daylight is white."""

SPECTRA = {*GREY, "blackbody", "discrete", "irregular", "rawconstant", "regular", "srgb"}
"""The textures that are spectra."""


def _mitsuba() -> ModuleType:
    try:
        mitsuba = importlib.import_module("mitsuba")
        importlib.import_module("mitsuba.parser")
        importlib.import_module("mitsuba.scalar_rgb")  # has the types of properties; the process's variant stays
    except ImportError as cause:
        raise RaytraceError(f"a scene of Mitsuba needs Mitsuba 3.9 or newer ({cause}): {install('mitsuba')}") from None
    return mitsuba


def read_plugins(path: str | os.PathLike[str]) -> list[Plugin]:
    """The plugins of a scene file, in its order, with references replaced by what they refer to.

    Raises:
        SceneError: the file cannot be read, or is no scene, in Mitsuba's words.
        RaytraceError: Mitsuba is missing.
    """
    mitsuba = _mitsuba()
    before = mitsuba.file_resolver()
    # Where files are looked for: where the scene's `path` elements say, which the parser adds, and beside the scene.
    folders = mitsuba.FileResolver(before)
    folders.prepend(str(Path(path).parent.absolute()))
    config = mitsuba.parser.ParserConfig("scalar_rgb")
    config.merge_equivalent = config.merge_meshes = False
    mitsuba.set_file_resolver(folders)
    try:
        state = mitsuba.parser.parse_file(config, os.fspath(path))
        mitsuba.parser.transform_all(config, state)
        scene = _Tree(mitsuba, state).plugin(0)
    except (RuntimeError, UnicodeDecodeError) as cause:
        # A line without the places in Mitsuba's source.
        words = " ".join(re.sub(r"\[\w+\.(cpp|h):\d+\] (Error while loading )?", "", str(cause)).split()).rstrip(".")
        raise SceneError(f"{words if str(path) in words else f'{path}: {words}'}.") from cause
    finally:
        mitsuba.set_file_resolver(before)
    return [value for value in scene.values.values() if isinstance(value, Plugin)]


def _grey(number: float) -> Color:
    return Color((float(number), float(number), float(number)))


class _Tree:
    """The nodes of a parsed file as plugins, each of them one however often it is referred to."""

    def __init__(self, mitsuba: ModuleType, state: Any):
        self.mitsuba, self.state = mitsuba, state
        self.done: dict[int, Plugin] = {}

    def plugin(self, index: int) -> Plugin:
        """A node and those in it."""
        if index in self.done:
            return self.done[index]
        node = self.state.nodes[index]
        tag = str(node.type.name).lower()
        values: dict[str, Value] = {}
        for key in node.props.keys():  # noqa: SIM118  these are not a mapping
            value, place = self.value(node, key), key
            if isinstance(value, Plugin) and (key.startswith("_arg_") or value.tag in ROLES):
                place = next(name for name in numbered(value.tag) if name not in values)
            values[place] = value
        found = Plugin(TAGS.get(tag, tag), node.props.plugin_name(), node.props.id(), values)
        self.done[index] = found
        return found

    def value(self, node: Any, key: str) -> Value:
        """A property of a node; a spectrum has to be one number for all wavelengths, or daylight's, which is white."""
        value, kind = node.props[key], node.props.type(key).name
        if kind == "ResolvedReference":
            plugin = self.plugin(value.index())
            if plugin.tag != "texture" or plugin.kind not in SPECTRA:
                return plugin
            scale = plugin.values.get(GREY.get(plugin.kind, ""), 1.0)
            if plugin.kind not in GREY or not isinstance(scale, int | float):
                raise self.error(node, f"{key} is a spectrum of type {plugin.kind}")
            return _grey(scale)
        if kind == "Spectrum":
            if not value.is_uniform():
                raise self.error(node, f"{key} is a spectrum by wavelengths")
            return _grey(value.values[0])
        if kind in ("Color", "Vector"):
            x, y, z = (float(number) for number in value)
            return Color((x, y, z)) if kind == "Color" else Point((x, y, z))
        if kind == "Transform":
            return Matrix(np.array(value.matrix))
        return str(self.mitsuba.file_resolver().resolve(value)) if key == "filename" else value

    def error(self, node: Any, what: str) -> SceneError:
        place = self.mitsuba.parser.file_location(self.state, node)
        return SceneError(f"{place}: {what}; three numbers of an rgb are wanted.")


class Properties(NamedTuple):
    """The properties of one kind of plugin."""

    read: tuple[str, ...] = ()  # The import takes them, or names them itself where it cannot.
    idle: tuple[str, ...] = ()  # They do not change what a long render converges to.
    lost: tuple[str, ...] = ()  # They change it and have nothing like them here.


SHAPE = ("to_world", "flip_normals", "bsdf", "interior", "exterior", "emitter")
DIELECTRIC = ("int_ior", "ext_ior", "specular_reflectance", "specular_transmittance")
CONDUCTOR = ("material", "eta", "k", "specular_reflectance")
ROUGHNESS = ("distribution", "alpha", "alpha_u", "alpha_v")
CAMERA = ("to_world", "fov", "fov_axis", "focal_length", "principal_point_offset_x", "principal_point_offset_y", "film")
CAMERA_IDLE = ("sampler", "shutter_open", "shutter_close")
CAMERA_LOST = ("near_clip", "far_clip", "srf", "medium")
TEXTURE = ("filename", "raw", "filter_type", "wrap_mode", "to_uv")
LIGHT_LOST = ("sampling_weight",)
MEDIUM_IDLE = ("sample_emitters", "has_spectral_extinction", "phase")

TABLE: dict[tuple[str, str], Properties] = {
    ("shape", "sphere"): Properties((*SHAPE, "center", "radius"), ("silhouette_sampling_weight",)),
    ("shape", "rectangle"): Properties(SHAPE, ("silhouette_sampling_weight",)),
    ("bsdf", "diffuse"): Properties(("reflectance",)),
    ("bsdf", "dielectric"): Properties(DIELECTRIC),
    ("bsdf", "roughdielectric"): Properties((*DIELECTRIC, *ROUGHNESS), ("sample_visible",)),
    ("bsdf", "conductor"): Properties(CONDUCTOR),
    ("bsdf", "roughconductor"): Properties((*CONDUCTOR, *ROUGHNESS), ("sample_visible",)),
    ("bsdf", "twosided"): Properties(("bsdf",)),
    ("emitter", "area"): Properties(("radiance",), lost=LIGHT_LOST),
    ("emitter", "point"): Properties(("position", "to_world", "intensity"), lost=LIGHT_LOST),
    ("emitter", "constant"): Properties(("radiance",), lost=LIGHT_LOST),
    ("emitter", "envmap"): Properties(("filename", "scale", "to_world"), ("mis_compensation",), LIGHT_LOST),
    ("texture", "bitmap"): Properties(TEXTURE, ("format", "accel"), ("bitmap", "data")),
    ("texture", "checkerboard"): Properties(("color0", "color1", "to_uv")),
    ("medium", "homogeneous"): Properties(("sigma_t", "albedo", "scale"), MEDIUM_IDLE),
    ("sensor", "perspective"): Properties(CAMERA, CAMERA_IDLE, CAMERA_LOST),
    ("sensor", "thinlens"): Properties((*CAMERA, "aperture_radius", "focus_distance"), CAMERA_IDLE, CAMERA_LOST),
    ("film", "hdrfilm"): Properties(
        ("width", "height", "pixel_format", "rfilter", "crop_width", "crop_height", "crop_offset_x", "crop_offset_y"),
        ("file_format", "component_format", "sample_border", "compensate"),
    ),
    ("rfilter", "box"): Properties(),
    ("integrator", "path"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
    ("integrator", "volpath"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
    ("integrator", "volpathmis"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
}
"""The plugins that the import reads, by tag and kind (Mitsuba 3.9's documentation of plugins)."""


def check_properties(plugins: Iterable[Plugin], path: str, lost: list[str]) -> None:
    """Name the properties of some plugins, and of those within them, that have nothing like them here.

    Of a kind of plugin that is not in the table nothing is said: it is named as a whole where it is not read.

    Raises:
        SceneError: a plugin has a property that Mitsuba's has not; the nearest that it has is named.
    """
    # Each plugin once: those that are referred to stand in several places, and with references to references in many.
    left, seen = list(plugins), set[int]()
    while left:
        plugin = left.pop(0)
        known = TABLE.get((plugin.tag, plugin.kind))
        if known is None or id(plugin) in seen:
            continue
        seen.add(id(plugin))
        called = f"{plugin.tag} {plugin.name or plugin.kind}"
        for key in plugin.values:
            # A second plugin of a role has its number behind it: "bsdf 2".
            name = key.partition(" ")[0]
            if name in known.lost:
                lost.append(f"{called}: {name}")
            elif name not in (*known.read, *known.idle):
                have = (*known.read, *known.lost, *known.idle)
                raise SceneError(
                    f"{path}: {called}: it has no {name}.{did_you_mean(name, have)} There are {', '.join(have)}."
                )
        left += [value for value in plugin.values.values() if isinstance(value, Plugin)]
