"""Trees of plugins, which Mitsuba's scenes are, written as XML and as a program in Python."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from raytrace_jax.errors import SceneError


class Color(NamedTuple):
    """Three numbers, red, green and blue, scene-linear."""

    values: tuple[float, float, float]


class Point(NamedTuple):
    """A place in the world."""

    values: tuple[float, float, float]


class LookAt(NamedTuple):
    """A camera's place, the point it looks at, and what is upright."""

    origin: tuple[float, ...]
    target: tuple[float, ...]
    up: tuple[float, ...]


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
    name: str  # Its id; empty where it has none.
    values: "Mapping[str, Value]"


def transform_of(plugin: Plugin, key: str = "to_world") -> np.ndarray:
    """A transform of a plugin, 4 x 4; the identity where it has none. Raises SceneError if it is something else."""
    found = plugin.values.get(key, Matrix(np.eye(4)))
    if not isinstance(found, Matrix):
        raise SceneError(f"its {key} is no transform.")
    return found.values


def number_of(plugin: Plugin, key: str, default: float) -> float:
    """A number of a plugin. Raises SceneError if it is something else."""
    found = plugin.values.get(key, default)
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise SceneError(f"{key} is {found!r}, and a number is wanted.")
    return float(found)


def color_of(plugin: Plugin, key: str, default: float) -> tuple[float, float, float]:
    """A colour of a plugin; one number is grey. Raises SceneError if it is something else."""
    found = plugin.values.get(key, default)
    if isinstance(found, int | float):
        return float(found), float(found), float(found)
    if not isinstance(found, Color):
        raise SceneError(f"{key} is {type(found).__name__.lower()}, and a colour is wanted.")
    return found.values


def place_of(plugin: Plugin, key: str) -> tuple[float, ...]:
    """Where a point of a plugin lies after its transform; that point is the origin where it says none."""
    point = plugin.values.get(key)
    place = point.values if isinstance(point, Point) else (0.0, 0.0, 0.0)
    return tuple(map(float, (transform_of(plugin) @ np.array([*place, 1.0]))[:3]))


def numbered(name: str, between: str = " ") -> Iterable[str]:
    """A name, and the same with a number where it comes again, as two materials of one blend."""
    return itertools.chain([name], (f"{name}{between}{k}" for k in itertools.count(2)))


UPSIDE_DOWN = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""The transform of a picture's coordinates that makes its first row the highest; in Mitsuba it is the lowest."""

Value = Plugin | Ref | Color | Point | LookAt | Matrix | bool | int | float | str


INDENT = "    "


def xml_text(plugins: Sequence[Plugin], lost: Iterable[str], path: str) -> str:
    """The XML of a scene, with the command in its head that renders `path`."""
    head = [
        "Written by raytrace_jax. Mitsuba 3 renders it, scene-linear:",
        f"mitsuba -m scalar_rgb -o {path.removesuffix('.xml')}.exr {path}",
        *(f"Not as it was: {words}." for words in lost),
    ]
    # Two hyphens in a row would end the comment.
    comment = "\n".join(line.replace("--", "- -") for line in head)
    body = "\n".join(_element(plugin, "", 1) for plugin in plugins)
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!--\n{comment}\n-->\n<scene version="3.0.0">\n{body}\n</scene>\n'


def _element(plugin: Plugin, role: str, depth: int) -> str:
    """A plugin as an element; `role` is its name in the one around it."""
    attributes = {"type": plugin.kind} | ({"id": plugin.name} if plugin.name else {}) | ({"name": role} if role else {})
    start = f"{INDENT * depth}<{plugin.tag} {_attributes(attributes)}"
    if not plugin.values:
        return f"{start}/>"
    lines = [_value(name, value, depth + 1) for name, value in plugin.values.items()]
    return "\n".join([f"{start}>", *lines, f"{INDENT * depth}</{plugin.tag}>"])


def _value(name: str, value: Value, depth: int) -> str:
    def simple(tag: str, **attributes: str) -> str:
        return f"{INDENT * depth}<{tag} {_attributes(attributes)}/>"

    if isinstance(value, Plugin):
        return _element(value, "" if name in (value.tag, "emitter", "bsdf") else name, depth)
    if isinstance(value, Ref):
        return simple("ref", id=value.name) if name == "bsdf" else simple("ref", name=name, id=value.name)
    if isinstance(value, bool | int | float | str):
        tag = {bool: "boolean", int: "integer", float: "float", str: "string"}[type(value)]
        return simple(tag, name=name, value=str(value).lower() if isinstance(value, bool) else str(value))
    if isinstance(value, Color):
        return simple("rgb", name=name, value=_row(value.values))
    if isinstance(value, Point):
        return simple("point", name=name, **dict(zip("xyz", map(repr, value.values), strict=True)))
    if isinstance(value, LookAt):
        inner = f"<lookat {_attributes({key: _row(vector) for key, vector in value._asdict().items()})}/>"
    else:
        inner = f"<matrix value={quoteattr(_row(value.values.ravel()))}/>"
    outer, within = INDENT * depth, INDENT * (depth + 1)
    return f"{outer}<transform name={quoteattr(name)}>\n{within}{inner}\n{outer}</transform>"


def _attributes(values: dict[str, str]) -> str:
    return " ".join(f"{key}={quoteattr(value)}" for key, value in values.items())


def _row(values: Iterable[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)


def python_text(plugins: Sequence[Plugin], lost: Iterable[str], path: str) -> str:
    """A program that has the scene as the dictionary that `mitsuba.load_dict` takes, and renders it."""
    lines = [f"# Not as it was: {words}." for words in lost]
    entries = [f"    {(plugin.name or plugin.tag)!r}: {_literal(plugin, 1)}," for plugin in plugins]
    body = "\n".join(["SCENE = {", "    'type': 'scene',", *entries, "}"])
    picture = path.removesuffix(".py") + ".exr"
    return f'''"""Written by raytrace_jax: SCENE is for `mitsuba.load_dict`.

`python {path}` renders {picture}, scene-linear.
"""

from pathlib import Path

import mitsuba as mi

if mi.variant() is None:
    mi.set_variant("scalar_rgb")  # On many cores: "llvm_ad_rgb", which needs LLVM.

HERE = Path(__file__).parent
{"".join(line + chr(10) for line in lines)}
{body}

if __name__ == "__main__":
    mi.util.write_bitmap(str(HERE / {picture!r}), mi.render(mi.load_dict(SCENE)), write_async=False)
'''


def _literal(value: Value, depth: int) -> str:
    """A value as Python writes it."""
    if isinstance(value, Plugin):
        inner = INDENT * (depth + 1)
        rows = [f"{inner}'type': {value.kind!r},"]
        rows += [
            f"{inner}{name!r}: {f'str(HERE / {entry!r})' if name == 'filename' else _literal(entry, depth + 1)},"
            for name, entry in value.values.items()
        ]
        return "\n".join(["{", *rows, INDENT * depth + "}"])
    if isinstance(value, Ref):
        return f"{{'type': 'ref', 'id': {value.name!r}}}"
    if isinstance(value, Color):
        return f"{{'type': 'rgb', 'value': {list(value.values)}}}"
    if isinstance(value, Point):
        return repr(list(value.values))
    if isinstance(value, LookAt):
        arguments = ", ".join(f"{key}={list(map(float, vector))}" for key, vector in value._asdict().items())
        return f"mi.ScalarTransform4f().look_at({arguments})"
    if isinstance(value, Matrix):
        return f"mi.ScalarTransform4f({np.asarray(value.values).tolist()})"
    return repr(value)
