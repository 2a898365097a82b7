"""Mitsuba's XML read as a tree of plugins."""

import os
import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import defusedxml
import defusedxml.ElementTree
import numpy as np
from scipy.spatial.transform import Rotation

from raytrace_jax.errors import SceneError
from raytrace_jax.exchange.mitsuba.plugins import Color, LookAt, Matrix, Plugin, Point, Ref, Value, numbered
from raytrace_jax.exchange.mitsuba.properties import TABLE
from raytrace_jax.images.colour_spaces import srgb_to_linear
from raytrace_jax.util.files import read_bytes
from raytrace_jax.util.text import parse_number

PLUGINS = {tag for tag, _ in TABLE} | {"sampler", "phase"}
"""Elements that are plugins: those that the import reads, and two that tell it nothing."""

REFERENCE = re.compile(r"\$(\w+)")
"""A default of the file, where an attribute has it."""


def read_plugins(path: str | os.PathLike[str]) -> list[Plugin | Ref]:
    """The plugins of a scene file, in its order.

    Raises:
        SceneError: the file cannot be read, is no XML, no scene of Mitsuba 3, has an entity or another file in it, or
            says what has no meaning.
    """
    data = read_bytes(path, error=SceneError)
    try:
        # Entities can grow without end or name other files.
        root = defusedxml.ElementTree.fromstring(data, forbid_dtd=True)
    except ParseError as cause:
        raise SceneError(f"{path}: is no XML: {cause}.") from cause
    except defusedxml.DefusedXmlException as cause:
        raise SceneError(f"{path}: has a document type or entities, which a scene has no use for.") from cause
    if root.tag != "scene":
        raise SceneError(f"{path}: is no scene of Mitsuba: its first element is {root.tag}.")
    if root.get("version", "3").split(".")[0] not in ("2", "3"):
        raise SceneError(f"{path}: is a scene of version {root.get('version')}; Mitsuba 3's are read.")
    return [value for _, value in _Reader(str(path)).children(root) if isinstance(value, Plugin | Ref)]


class _Reader:
    """Reads elements; its defaults are those of the `default` elements so far."""

    def __init__(self, path: str):
        self.path = path
        self.defaults: dict[str, str] = {}
        # Where files are looked for: beside the scene, and where `path` elements say.
        self.folders = [Path(path).parent]

    def error(self, element: Element, what: str) -> SceneError:
        name = element.get("name") or element.get("id") or element.get("type")
        return SceneError(f"{self.path}: {element.tag}{f' {name}' if name else ''}: {what}.")

    def text(self, element: Element, key: str, default: str | None = None) -> str:
        """An attribute, with `$names` replaced by what the file's defaults say."""
        found = element.get(key, default)
        if found is None:
            raise self.error(element, f"has no {key}")

        def value(match: re.Match[str]) -> str:
            if match[1] not in self.defaults:
                raise self.error(element, f"{key} is {match[0]}, for which the file has no default")
            return self.defaults[match[1]]

        return REFERENCE.sub(value, found)

    def numbers(self, element: Element, key: str, default: str | None = None) -> tuple[float, ...]:
        """The numbers of an attribute, with commas or spaces between them."""
        words = self.text(element, key, default).replace(",", " ").split()
        try:
            return tuple(map(parse_number, words))
        except ValueError as cause:
            raise self.error(
                element, f"{key} is {self.text(element, key, default)!r}, and numbers are wanted"
            ) from cause

    def number(self, element: Element, key: str = "value", default: str | None = None) -> float:
        """One number."""
        found = self.numbers(element, key, default)
        if len(found) != 1:
            raise self.error(element, f"{key} is {self.text(element, key, default)!r}, and one number is wanted")
        return found[0]

    def children(self, element: Element) -> Iterable[tuple[str, Value]]:
        """What is in an element, each with its name; what has none has its tag."""
        for child in element:
            if child.tag == "default":
                self.defaults.setdefault(self.text(child, "name"), self.text(child, "value"))
            elif child.tag == "path":
                self.folders.append(self.folders[0] / self.text(child, "value"))
            elif child.tag == "include":
                raise self.error(child, "other files are not read")
            else:
                yield child.get("name") or child.tag, self.value(child)

    def value(self, element: Element) -> Value:
        tag = element.tag
        if tag in PLUGINS:
            values: dict[str, Value] = {}
            for name, value in self.children(element):
                values[next(key for key in numbered(name) if key not in values)] = value
            return Plugin(tag, self.text(element, "type"), element.get("id", ""), values)
        if tag == "ref":
            return Ref(self.text(element, "id"))
        if tag == "integer":
            return round(self.number(element))
        if tag == "float":
            return self.number(element)
        if tag == "boolean":
            word = self.text(element, "value")
            if word not in ("true", "false"):
                raise self.error(element, f"value is {word!r}, and true or false is wanted")
            return word == "true"
        if tag == "string":
            said = self.text(element, "value")
            found = [folder / said for folder in self.folders[1:] if (folder / said).is_file()]
            is_elsewhere = element.get("name") == "filename" and not (self.folders[0] / said).exists() and found
            return str(found[0].absolute()) if is_elsewhere else said
        if tag in ("rgb", "spectrum"):
            return self.color(element)
        if tag in ("point", "vector"):
            return Point(self.vector(element, "0"))
        if tag == "transform":
            return self.transform(element)
        raise self.error(element, "there is no such element in a scene that can be read")

    def color(self, element: Element) -> Color:
        """A colour; a spectrum has to be one number for all wavelengths, or daylight's, which is white."""
        kind = element.get("type", "uniform")
        if element.tag == "spectrum" and kind == "d65":
            scales = [self.number(child) for child in element if child.get("name") == "scale"]
            scale = scales[0] if scales else 1.0
            return Color((scale, scale, scale))
        if element.tag == "spectrum" and kind != "uniform":
            raise self.error(element, f"a spectrum of type {kind}; three numbers of an rgb are wanted")
        inner = [child for child in element if child.get("name") == "value"]
        said = self.text(inner[0] if inner else element, "value")
        if re.fullmatch("#[0-9a-fA-F]{6}", said):
            # As Mitsuba takes them: sRGB.
            red, green, blue = srgb_to_linear(np.array(list(bytes.fromhex(said[1:]))) / 255).tolist()
            return Color((red, green, blue))
        if element.tag == "spectrum" and ":" in said:
            raise self.error(element, "a spectrum by wavelengths; three numbers of an rgb are wanted")
        return Color(self.three(element, self.numbers(element, "value")))

    def three(self, element: Element, numbers: tuple[float, ...]) -> tuple[float, float, float]:
        """Three numbers; one stands for all."""
        if len(numbers) not in (1, 3):
            raise self.error(element, f"has {len(numbers)} numbers, and 3 are wanted, or 1 for all")
        first, second, third = numbers * (3 // len(numbers))
        return first, second, third

    def vector(self, element: Element, default: str, key: str = "value") -> tuple[float, float, float]:
        """Three numbers, from one attribute or from x, y and z."""
        if element.get(key) is not None:
            return self.three(element, self.numbers(element, key))
        x, y, z = (self.number(element, axis, default) for axis in "xyz")
        return x, y, z

    def transform(self, element: Element) -> Matrix | LookAt:
        """The product of the steps of a transform, the first applied first; a camera's single one as it was said."""
        children = list(element)
        if len(children) == 1 and children[0].tag == "lookat":
            return self.look_at(children[0])
        matrix = np.eye(4)
        for child in children:
            matrix = self.matrix(child) @ matrix
        return Matrix(matrix)

    def look_at(self, element: Element) -> LookAt:
        """Where a camera is, where it looks, and what is upright."""
        origin, target = (self.vector(element, "0", key) for key in ("origin", "target"))
        up = self.vector(element, "0", "up") if element.get("up") is not None else (0.0, 1.0, 0.0)
        if not np.any(np.cross(up, np.subtract(target, origin))):
            raise self.error(element, "its target is its origin, or lies along its up")
        return LookAt(origin, target, up)

    def matrix(self, element: Element) -> np.ndarray:
        """One of the steps of a transform."""
        found = np.eye(4)
        if element.tag == "translate":
            found[:3, 3] = self.vector(element, "0")
        elif element.tag == "scale":
            found[[0, 1, 2], [0, 1, 2]] = self.vector(element, "1")
        elif element.tag == "rotate":
            axis = np.array(self.vector(element, "0"))
            length = float(np.linalg.norm(axis))
            if not length > 0:
                raise self.error(element, "has no axis")
            angle = np.radians(self.number(element, "angle"))
            found[:3, :3] = Rotation.from_rotvec(angle * axis / length).as_matrix()
        elif element.tag == "matrix":
            numbers = self.numbers(element, "value")
            if len(numbers) not in (9, 16):
                raise self.error(element, f"has {len(numbers)} numbers, and 9 or 16 are wanted")
            side = 4 if len(numbers) == 16 else 3
            found[:side, :side] = np.reshape(numbers, (side, side))
        elif element.tag == "lookat":
            found = self.look_at(element).matrix
        else:
            raise self.error(element, "there is no such transform")
        return found
