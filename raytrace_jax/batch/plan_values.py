"""The values in a plan: of parameters, alone or many; of options, by the type that they have to be; of settings."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, TypeVar

from raytrace_jax.batch.plan_file import Keys, PlanFile, shown
from raytrace_jax.errors import SettingsError
from raytrace_jax.tracer.settings import CHOICES, RenderSettings
from raytrace_jax.util.ranges import evenly_spaced
from raytrace_jax.util.words import listed

T = TypeVar("T", bound=str | int)

Value = float | tuple[float, ...]
"""A parameter's value: a number, or the numbers of a vector."""

RANGE = ("start", "stop", "count")
MOST_IN_RANGE = 1_000_000

SETTINGS = {field.name: field.default for field in dataclasses.fields(RenderSettings)}
"""The names in the table `[settings]`, and what holds where one is left out."""

ROWS = {"size": 2, "crop": 4}
"""Settings of several whole numbers, and how many."""

NUMBERS = ("path_limit", "least_weight")
"""Settings that need not be whole numbers."""


def read_value(file: PlanFile, keys: Keys, value: Any) -> Value:
    """A parameter's value: a number, or an array of numbers. Raises PlanError for anything else."""
    if _is_number(value):
        return float(value)
    if isinstance(value, list) and value and all(map(_is_number, value)):
        return tuple(map(float, value))
    raise file.error(keys, f"is {shown(value)}; a finite number is wanted, or an array of them for a vector.")


def read_values(file: PlanFile, keys: Keys, values: Any) -> tuple[Value, ...]:
    """Many values of a parameter: an array of them, or a table that spaces them evenly, both ends included.

    Raises:
        PlanError: it is neither, is empty, or one of the values is no value.
    """
    if isinstance(values, dict):
        return _evenly_spaced(file, keys, values)
    if not isinstance(values, list) or not values:
        wanted = "an array of values is wanted, or { start = 1.0, stop = 2.0, count = 11 }"
        raise file.error(keys, f"is {shown(values)}; {wanted}.")
    return tuple(read_value(file, keys, value) for value in values)


def read_numbers(file: PlanFile, keys: Keys, values: Any, wanted: str, least: float = -math.inf) -> tuple[float, ...]:
    """An array of finite numbers, none below `least`. Raises PlanError that says what was `wanted`."""
    values = values if isinstance(values, list) else [values]
    if not values or not all(_is_number(value) and value >= least for value in values):
        raise file.error(keys, f"is {shown(values)}; {wanted} is wanted.")
    return tuple(map(float, values))


def read_texts(file: PlanFile, keys: Keys, values: Any, wanted: str) -> tuple[str, ...]:
    """An array of texts, one at least, or a single text. Raises PlanError that says what was `wanted`."""
    values = [values] if isinstance(values, str) else values
    if not isinstance(values, list) or not values or not all(isinstance(value, str) and value for value in values):
        raise file.error(keys, f"is {shown(values)}; {wanted} is wanted.")
    return tuple(values)


def read_option(file: PlanFile, keys: Keys, known: Sequence[T], default: T) -> T:
    """An option that is one of some words or numbers. Raises PlanError for another one."""
    value = _value(file, keys, default)
    for one in known:
        if value == one and type(value) is type(one):
            return one
    raise file.error(keys, f"is {shown(value)}; it can be {listed(map(str, known))}.")


def read_count(file: PlanFile, keys: Keys, least: int, most: int, default: int) -> int:
    """An option that is a whole number. Raises PlanError for anything else."""
    value = _value(file, keys, default)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise file.error(keys, f"is {shown(value)}; a whole number from {least} to {most} is wanted.")
    return value


def read_switch(file: PlanFile, keys: Keys, default: bool) -> bool:
    """An option that is true or false. Raises PlanError for anything else."""
    value = _value(file, keys, default)
    if not isinstance(value, bool):
        raise file.error(keys, f"is {shown(value)}; true or false is wanted.")
    return value


def read_settings(file: PlanFile) -> dict[str, Any]:
    """The table `[settings]` by the names of `RenderSettings`; what it does not say is not in it.

    Raises:
        PlanError: an unknown name, a value of a wrong type or one that a picture cannot have.
    """
    table = file.table(("settings",), known=SETTINGS)
    given: dict[str, Any] = {}
    for name, value in table.items():
        given[name] = _setting(file, ("settings", name), value, SETTINGS[name])
        # Which model it will be may be a scene's to say: alone, a value has to be possible for one of them.
        try:
            RenderSettings(**{name: given[name]})
        except SettingsError as reason:
            raise file.error(("settings", name), str(reason)) from None
    return given


def _evenly_spaced(file: PlanFile, keys: Keys, table: dict[str, Any]) -> tuple[float, ...]:
    file.refuse_unknown(keys, table, RANGE)
    missing = [name for name in RANGE if name not in table]
    if missing:
        raise file.error(keys, f"has no {' and no '.join(missing)}; a range is {{ start, stop, count }}.")
    start, stop, count = (table[name] for name in RANGE)
    if not (_is_number(start) and _is_number(stop)):
        raise file.error(keys, f"goes from {shown(start)} to {shown(stop)}; finite numbers are wanted.")
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_IN_RANGE:
        raise file.error(keys, f"has count {shown(count)}; a whole number from 1 to {MOST_IN_RANGE} is wanted.")
    return tuple(evenly_spaced(start, stop, count))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _setting(file: PlanFile, keys: Keys, value: Any, default: object) -> object:
    """A setting of the type that its default has; where that is None, whole numbers."""
    if default is None and keys[-1] in ROWS:
        count = ROWS[keys[-1]]
        whole = isinstance(value, list) and all(type(number) is int for number in value)
        if not whole or len(value) != count:
            raise file.error(keys, f"is {shown(value)}; an array of {count} whole numbers is wanted.")
        return tuple(value)
    if isinstance(default, tuple):
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise file.error(keys, f"is {shown(value)}; an array of names is wanted.")
        return tuple(value)
    if keys[-1] in NUMBERS:
        [length] = read_numbers(file, keys, [value], "a finite number")
        return length
    kind = str if keys[-1] in CHOICES else int if default is None else type(default)
    if type(value) is not kind:
        wanted = {bool: "true or false", int: "a whole number", str: "a word in quotes"}[kind]
        raise file.error(keys, f"is {shown(value)}; {wanted} is wanted.")
    return value


def _value(file: PlanFile, keys: Keys, default: Any) -> Any:
    return file.table(keys[:-1]).get(keys[-1], default)
