"""The tree of plugins of a scene's file, by Mitsuba's own parser, and the properties that its plugins may have."""

import importlib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

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


def read_plugins(path: str | os.PathLike[str]) -> list[Plugin]:
    """The plugins of a scene file, in its order, with references replaced by what they refer to.

    Raises:
        SceneError: the file cannot be read, or is no scene, in Mitsuba's words.
        RaytraceError: Mitsuba is missing.
    """
    try:
        mitsuba = importlib.import_module("mitsuba")
        importlib.import_module("mitsuba.parser")
        importlib.import_module("mitsuba.scalar_rgb")  # has the types of properties; the process's variant stays
    except ImportError as cause:
        raise RaytraceError(f"a scene of Mitsuba needs Mitsuba 3.9 or newer ({cause}): {install('mitsuba')}") from None
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


class _Tree:
    """The nodes of a parsed file as plugins, each of them one however often it is referred to."""

    def __init__(self, mitsuba: ModuleType, state: Any):
        self.mitsuba, self.state = mitsuba, state
        self.done: dict[int, Plugin] = {}

    def plugin(self, index: int) -> Plugin:
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
            others = ("blackbody", "discrete", "irregular", "rawconstant", "regular", "srgb")
            if plugin.tag != "texture" or plugin.kind not in (*GREY, *others):
                return plugin
            scale = plugin.values.get(GREY[plugin.kind], 1.0) if plugin.kind in GREY else None
            return self.grey(scale, node, f"{key} is a spectrum of type {plugin.kind}")
        if kind == "Spectrum":
            scale = value.values[0] if value.is_uniform() else None
            return self.grey(scale, node, f"{key} is a spectrum by wavelengths")
        if kind in ("Color", "Vector"):
            numbers = tuple(map(float, value))
            return Color(numbers) if kind == "Color" else Point(numbers)
        if kind == "Transform":
            return Matrix(np.array(value.matrix))
        return str(self.mitsuba.file_resolver().resolve(value)) if key == "filename" else value

    def grey(self, scale: Any, node: Any, what: str) -> Color:
        if isinstance(scale, int | float):
            return Color((float(scale),) * 3)
        place = self.mitsuba.parser.file_location(self.state, node)
        raise SceneError(f"{place}: {what}; three numbers of an rgb are wanted.")


SHAPE = "to_world flip_normals bsdf interior exterior emitter silhouette_sampling_weight"
DIELECTRIC = "int_ior ext_ior specular_reflectance specular_transmittance"
CONDUCTOR = "material eta k specular_reflectance"
ROUGH = " distribution alpha alpha_u alpha_v sample_visible"
CAMERA = (
    "to_world fov fov_axis focal_length principal_point_offset_x principal_point_offset_y film "
    "sampler shutter_open shutter_close"
)
CAMERA_LOST = "near_clip far_clip srf medium"
FILM = (
    "width height pixel_format rfilter crop_width crop_height crop_offset_x crop_offset_y "
    "file_format component_format sample_border compensate"
)
PATH = "max_depth hide_emitters rr_depth"

TABLE: dict[str, tuple[str, str]] = {
    "shape sphere": (f"{SHAPE} center radius", ""),
    "shape rectangle": (SHAPE, ""),
    "bsdf diffuse": ("reflectance", ""),
    "bsdf dielectric": (DIELECTRIC, ""),
    "bsdf roughdielectric": (DIELECTRIC + ROUGH, ""),
    "bsdf conductor": (CONDUCTOR, ""),
    "bsdf roughconductor": (CONDUCTOR + ROUGH, ""),
    "bsdf twosided": ("bsdf", ""),
    "emitter area": ("radiance", "sampling_weight"),
    "emitter point": ("position to_world intensity", "sampling_weight"),
    "emitter constant": ("radiance", "sampling_weight"),
    "emitter envmap": ("filename scale to_world mis_compensation", "sampling_weight"),
    "texture bitmap": ("filename raw filter_type wrap_mode to_uv format accel", "bitmap data"),
    "texture checkerboard": ("color0 color1 to_uv", ""),
    "medium homogeneous": ("sigma_t albedo scale sample_emitters has_spectral_extinction phase", ""),
    "sensor perspective": (CAMERA, CAMERA_LOST),
    "sensor thinlens": (f"{CAMERA} aperture_radius focus_distance", CAMERA_LOST),
    "film hdrfilm": (FILM, ""),
    "rfilter box": ("", ""),
    "integrator path": (PATH, ""),
    "integrator volpath": (PATH, ""),
    "integrator volpathmis": (PATH, ""),
}
"""Properties of the plugins that the import reads (Mitsuba 3.9's documentation of plugins). The first ones it takes,
names itself where it cannot, or they do not change what a long render converges to; the second have nothing like them
here, and are named."""


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
        found = TABLE.get(f"{plugin.tag} {plugin.kind}")
        if found is None or id(plugin) in seen:
            continue
        seen.add(id(plugin))
        taken, gone = (names.split() for names in found)
        called = f"{plugin.tag} {plugin.name or plugin.kind}"
        for key in plugin.values:
            # A second plugin of a role has its number behind it: "bsdf 2".
            name = key.partition(" ")[0]
            if name in gone:
                lost.append(f"{called}: {name}")
            elif name not in taken:
                have = [*taken, *gone]
                raise SceneError(
                    f"{path}: {called}: it has no {name}.{did_you_mean(name, have)} There are {', '.join(have)}."
                )
        left += [value for value in plugin.values.values() if isinstance(value, Plugin)]
