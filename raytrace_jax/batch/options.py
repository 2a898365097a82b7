"""Options in a plan: one of some words or numbers, a whole number, true or false; and the settings of a picture."""

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

from raytrace_jax.batch.plan_file import Keys, PlanFile, shown
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.text import listed

T = TypeVar("T", str, int)

SETTINGS = {field.name: field.default for field in dataclasses.fields(RenderSettings)}
"""The names in the table `[settings]`, and what holds where one is left out."""


ROWS = {"size": 2, "crop": 4}
"""Settings of several whole numbers, and how many."""


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


def read_settings(file: PlanFile) -> RenderSettings:
    """The table `[settings]`, by the names of `RenderSettings`.

    Raises:
        PlanError: an unknown name, a value of a wrong type or one that a picture cannot have.
    """
    table = file.table(("settings",), known=SETTINGS)
    given: dict[str, Any] = {}
    for name, value in table.items():
        given[name] = _setting(file, ("settings", name), value, SETTINGS[name])
        try:
            RenderSettings(**{name: given[name]})
        except ValueError as reason:
            raise file.error(("settings", name), f"{reason}.") from None
    try:
        return RenderSettings(**given)
    except ValueError as reason:
        raise file.error(("settings",), f"{reason}.") from None


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
    kind = int if default is None else type(default)
    if type(value) is not kind:
        wanted = {bool: "true or false", int: "a whole number", str: "a word in quotes"}[kind]
        raise file.error(keys, f"is {shown(value)}; {wanted} is wanted.")
    return value


def _value(file: PlanFile, keys: Keys, default: Any) -> Any:
    return file.table(keys[:-1]).get(keys[-1], default)
