"""The tree of plugins of a scene's file, by Mitsuba's own parser, and the properties that its plugins may have."""

import importlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...errors import RaytraceError, SceneError
from ...util.files import StrPath
from ...util.text import install
from .plugins import Color, Matrix, Plugin, Point, Value, numbered

TAGS = {"reconstructionfilter": "rfilter", "phasefunction": "phase"}
"""The tags of Mitsuba's types of objects that are not the types' own names."""

ROLES = {"bsdf", "emitter", "film", "sampler", "rfilter", "phase"}
"""Plugins whose role in another one is their tag, whatever name they are given."""

GREY = {"uniform": "value", "d65": "scale"}
"""Spectra that are white times a number, with that number's name; daylight is white."""


def read_plugins(path: StrPath) -> list[Plugin]:
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
        scene = _Tree(mitsuba, state, Path(path).parent).plugin(0)
    except (RuntimeError, UnicodeDecodeError) as cause:
        # A line without the places in Mitsuba's source.
        words = " ".join(re.sub(r"\[\w+\.(cpp|h):\d+\] (Error while loading )?", "", str(cause)).split()).rstrip(".")
        raise SceneError(f"{words if str(path) in words else f'{path}: {words}'}.") from cause
    finally:
        mitsuba.set_file_resolver(before)
    return [value for value in scene.values.values() if isinstance(value, Plugin)]


class _Tree:
    """The nodes of a parsed file as plugins, each of them one however often it is referred to."""

    def __init__(self, mitsuba: ModuleType, state: Any, folder: Path):
        self.mitsuba, self.state, self.folder = mitsuba, state, folder
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
        found = Plugin(TAGS.get(tag, tag), node.props.plugin_name(), values, node.props.id())
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
        return str(self.folder / str(self.mitsuba.file_resolver().resolve(value))) if key == "filename" else value

    def grey(self, scale: Any, node: Any, what: str) -> Color:
        if isinstance(scale, int | float):
            return Color((float(scale),) * 3)
        place = self.mitsuba.parser.file_location(self.state, node)
        raise SceneError(f"{place}: {what}; three numbers of an rgb are wanted.")


KNOWN = {
    "shape": (
        "sphere rectangle cube cylinder disk",
        "to_world flip_normals bsdf interior exterior emitter silhouette_sampling_weight center radius p0 p1",
    ),
    "bsdf": (
        "diffuse dielectric roughdielectric conductor roughconductor twosided",
        "reflectance int_ior ext_ior specular_reflectance specular_transmittance material eta k bsdf "
        "distribution alpha alpha_u alpha_v sample_visible",
    ),
    "emitter": (
        "area point constant envmap",
        "radiance position to_world intensity filename scale mis_compensation",
    ),
    "texture": ("bitmap checkerboard", "filename raw filter_type wrap_mode to_uv format accel color0 color1"),
    "medium": ("homogeneous", "sigma_t albedo scale sample_emitters has_spectral_extinction phase"),
    "sensor": (
        "perspective thinlens",
        "to_world fov fov_axis focal_length principal_point_offset_x principal_point_offset_y film sampler medium "
        "shutter_open shutter_close aperture_radius focus_distance",
    ),
    "film": (
        "hdrfilm",
        "width height pixel_format rfilter crop_width crop_height crop_offset_x crop_offset_y "
        "file_format component_format sample_border compensate",
    ),
    "integrator": ("path volpath volpathmis", "max_depth hide_emitters rr_depth"),
}
"""Plugins that the import reads, by their tag: their kinds, and properties (Mitsuba 3.9's documentation of plugins)
that it takes, names itself where it cannot, or that do not change what a long render converges to."""


def unread_properties(plugins: Iterable[Plugin]) -> Iterator[str]:
    """The properties of some plugins that are read, and of those within them, that have nothing like them here."""
    # Each plugin once: those that are referred to stand in several places, and with references to references in many.
    left, seen = list(plugins), set[int]()
    while left:
        plugin = left.pop(0)
        kinds, names = KNOWN.get(plugin.tag, ("", ""))
        # A plugin of another kind is named as a whole where it is not read.
        if plugin.kind not in kinds.split() or id(plugin) in seen:
            continue
        seen.add(id(plugin))
        for key, value in plugin.values.items():
            # A second plugin of a role has its number behind it: "bsdf 2".
            name = key.partition(" ")[0]
            if name not in names.split():
                yield f"{plugin.tag} {plugin.called}: {name}"
            if isinstance(value, Plugin):
                left.append(value)
