"""Mitsuba's scenes as a tree of plugins, whatever they are written in."""

import itertools
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from raytrace_jax.errors import SceneError


class Color(NamedTuple):
    """Three numbers, red, green and blue, scene-linear."""

    values: tuple[float, float, float]


class Point(NamedTuple):
    """A point."""

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
    """A plugin.

    Args:
        tag: `shape`, `bsdf`, `texture`, `emitter`, `medium`, `sensor`, `film`, `sampler`, `rfilter`, `integrator`.
        kind: its type.
        name: its id; empty where it has none.
        values: what it is given, by name. Of a plugin within another one the name tells its role, or is its tag.
    """

    tag: str
    kind: str
    name: str
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
