"""Trees of plugins, which Mitsuba's scenes are, written as XML."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from ...errors import SceneError
from ..described import Triple


class Color(NamedTuple):
    """Three numbers, red, green and blue, scene-linear."""

    values: Triple


class Point(NamedTuple):
    """A `<point>` of Mitsuba's."""

    values: Triple


class LookAt(NamedTuple):
    """A `<lookat>` of Mitsuba's: from where, to where, and which way is up."""

    origin: Triple
    target: Triple
    up: Triple


class Matrix(NamedTuple):
    """A transform, 4 x 4, that is applied to columns."""

    values: np.ndarray


class Ref(NamedTuple):
    """The plugin of a name, which stands elsewhere."""

    name: str


class Plugin(NamedTuple):
    """A plugin with its values by name; of a plugin within another one the name tells its role, or is its tag."""

    tag: str  # As `shape`, `bsdf`, `texture` or `emitter`.
    kind: str
    values: "Mapping[str, Value]"
    name: str = ""  # Its id; empty where it has none.

    @property
    def called(self) -> str:
        """What people know it by: its id, or its kind where it has none."""
        return self.name or self.kind

    def value(self, key: str, kinds: Any, default: Any) -> Any:
        """A property. Raises SceneError if its value is of another kind."""
        found = self.values.get(key, default)
        if isinstance(found, bool) or not isinstance(found, kinds):
            wanted = {Matrix: "a transform", Point: "a point", int | float: "a number"}.get(kinds, "a colour")
            raise SceneError(f"{key} is {found!r}, and {wanted} is wanted.")
        return found

    def number(self, key: str, default: float) -> float:
        return float(self.value(key, int | float, default))

    def color(self, key: str, default: float) -> Triple:
        """A colour; one number is grey."""
        found = self.value(key, Color | int | float, default)
        return found.values if isinstance(found, Color) else (float(found),) * 3

    def transform(self, key: str = "to_world") -> np.ndarray:
        """A transform, 4 x 4; the identity without the property."""
        return self.value(key, Matrix, Matrix(np.eye(4))).values

    def place(self, key: str) -> np.ndarray:
        """Where a point lies after the plugin's transform; that point is the origin where none is given."""
        point = self.value(key, Point, Point((0.0, 0.0, 0.0))).values
        return (self.transform() @ [*point, 1.0])[:3]


def numbered(name: str, between: str = " ") -> Iterable[str]:
    """A name, and the same with a number where it comes again, as two materials of one blend."""
    return itertools.chain([name], (f"{name}{between}{k}" for k in itertools.count(2)))


UPSIDE_DOWN = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""The transform of a picture's coordinates that makes its first row the highest; in Mitsuba it is the lowest."""

Value = Plugin | Ref | Color | Point | LookAt | Matrix | bool | int | float | str


def xml_text(plugins: Sequence[Plugin], lost: Iterable[str], path: str) -> str:
    """The XML of a scene, with the command in its head that renders `path`."""
    head = [
        "Written by raytrace_jax. Mitsuba 3 renders it, scene-linear:",
        f"mitsuba -m scalar_rgb -o {path.removesuffix('.xml')}.exr {path}",
        *(f"Not as it was: {words}." for words in lost),
    ]
    # Two hyphens in a row would end the comment.
    comment = "\n".join(line.replace("--", "- -") for line in head)
    scene = Element("scene", version="3.0.0")
    for plugin in plugins:
        _add(scene, "", plugin)
    indent(scene, "    ")
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!--\n{comment}\n-->\n{tostring(scene, encoding="unicode")}\n'


def _add(parent: Element, name: str, value: Value) -> None:
    """Add a value to an element, by its name there."""
    if isinstance(value, Plugin):
        role = "" if name in (value.tag, "emitter", "bsdf") else name
        said = {"type": value.kind, "id": value.name, "name": role}
        element = SubElement(parent, value.tag, {key: word for key, word in said.items() if word})
        for key, inner in value.values.items():
            _add(element, key, inner)
    elif isinstance(value, Ref):
        SubElement(parent, "ref", {} if name == "bsdf" else {"name": name}, id=value.name)
    elif isinstance(value, LookAt):
        rows = {key: _row(vector) for key, vector in value._asdict().items()}
        SubElement(SubElement(parent, "transform", name=name), "lookat", rows)
    elif isinstance(value, Matrix):
        SubElement(SubElement(parent, "transform", name=name), "matrix", value=_row(value.values.ravel()))
    elif isinstance(value, Color):
        SubElement(parent, "rgb", name=name, value=_row(value.values))
    elif isinstance(value, Point):
        SubElement(parent, "point", {"name": name, **dict(zip("xyz", map(repr, value.values), strict=True))})
    else:
        tag = {bool: "boolean", int: "integer", float: "float", str: "string"}[type(value)]
        SubElement(parent, tag, name=name, value=str(value).lower() if isinstance(value, bool) else str(value))


def _row(values: Iterable[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)
