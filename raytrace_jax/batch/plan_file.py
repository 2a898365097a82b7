"""The file of a plan, TOML, whose tables become dataclasses; an error names the file and the key."""

import dataclasses
import math
from collections.abc import Collection, Container, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_origin

from ..errors import ParameterError, RaytraceError, SettingsError, reworded
from ..util.checked import Checked, Wanted, core, hints, in_words, is_row, suits
from ..util.digits import evenly_spaced
from ..util.files import read_toml
from ..util.text import did_you_mean, listed, quoted

T = TypeVar("T")

Keys = tuple[str, ...]  # The place of a value: the names of the tables that it is in, and its own.


class PlanError(RaytraceError):
    """A plan that makes no sense; the message starts with `file: key:`."""


class PlanFile:
    """The contents of a plan file, which is also the place that its relative paths start from."""

    def __init__(self, path: Path):
        self.path = path
        self.data = read_toml(path, PlanError)

    def error(self, keys: Keys, message: str) -> PlanError:
        """Return (for the caller to raise) the error about a value, or about the file where there are no `keys`."""
        place = ".".join(f'"{key}"' if "." in key else key for key in keys)
        return PlanError(": ".join(filter(None, (str(self.path), place, message))))

    def read(self, keys: Keys, kind: type[T], names: Collection[str] = ()) -> T:
        """A table as a dataclass, which checks it. One value alone serves as a row of it.

        Args:
            names: the fields to read; without them all, and the table may have no other names.
        """
        table, given = self.table(keys, known=() if names else hints(kind)), {}
        for field in dataclasses.fields(kind):  # pyright: ignore[reportArgumentType]
            name, hint = field.name, hints(kind)[field.name]
            if name in table and (name in names or not names):
                value = table[name]
                if get_origin(core(hint)) is Mapping:
                    value = {one: found for one, (_, found) in self.parameters((*keys, name)).items()}
                elif is_row(hint) and not isinstance(value, list):
                    value = [value]
                given[name] = value
            elif field.default is field.default_factory is dataclasses.MISSING:
                raise self.error(keys, f"needs {name}: {in_words(hint)}.")

        def refused(words: str) -> PlanError:
            name, _, rest = words.partition(" ")
            return self.error((*keys, name), rest)

        with reworded(refused, (ParameterError, SettingsError)):
            return kind(**given)

    def table(self, keys: Keys, known: Collection[str] = ()) -> dict[str, Any]:
        """The table of that name, empty if it is missing; if some names are `known`, there may be no others in it."""
        found: Any = self.data
        for key in keys:
            found = found.get(key, {})
        if not isinstance(found, dict):
            raise self.error(keys, f"is {shown(found)}; a table of names and values is wanted.")
        for name in found if known else ():
            if name not in known:
                close = did_you_mean(name, known)
                raise self.error((*keys, name), f"there is no such name.{close} There are {listed(known)}.")
        return found

    def parameters(self, keys: Keys, leaf: Container[str] = ()) -> dict[str, tuple[Keys, Any]]:
        """A table of parameters: where each stands and what it is, by name.

        A name may be written as it is, which TOML takes for tables in tables, or in quotes: `vitreous.ior = 1.5` and
        `"vitreous.ior" = 1.5` are the same. A table that has a name of `leaf` is a value.

        Raises:
            PlanError: it is not a table, or a parameter comes in both spellings.
        """
        found: dict[str, tuple[Keys, Any]] = {}

        def walk(place: Keys, table: Mapping[str, Any]) -> None:
            for key, value in table.items():
                name = ".".join((*place[len(keys) :], key))
                if isinstance(value, dict) and value and not any(word in leaf for word in value):
                    walk((*place, key), value)
                elif name in found:
                    raise self.error((*place, key), "is given twice.")
                else:
                    found[name] = ((*place, key), value)

        walk(keys, self.table(keys))
        return found


def shown(value: object) -> str:
    """A value as an error message quotes it."""
    return quoted(value) if isinstance(value, str) else str(value)[:60]


Value = float | tuple[float, ...]  # Of a parameter: a number, or the numbers of a vector.

Finite = Annotated[float, Wanted("a finite number", above=-math.inf, below=math.inf)]


@dataclasses.dataclass(frozen=True)
class EvenRange(Checked):
    start: Finite
    stop: Finite
    count: Annotated[int, Wanted(least=1, most=1_000_000)]


RANGE = tuple(field.name for field in dataclasses.fields(EvenRange))


def read_value(file: PlanFile, keys: Keys, value: Any) -> Value:
    """A parameter's value: a number, or an array of numbers. Raises PlanError for anything else."""
    if suits(value, Finite):
        return float(value)
    if isinstance(value, list) and value and suits(value, tuple[Finite, ...]):
        return tuple(map(float, value))
    raise file.error(keys, f"is {shown(value)}; a finite number is wanted, or an array of them for a vector.")


def read_values(file: PlanFile, keys: Keys, values: Any) -> tuple[Value, ...]:
    """Many values of a parameter: an array of them, or a table that is a `EvenRange`."""
    if isinstance(values, dict):
        found = file.read(keys, EvenRange)
        return tuple(evenly_spaced(found.start, found.stop, found.count))
    if not isinstance(values, list) or not values:
        wanted = "an array of values is wanted, or { start = 1.0, stop = 2.0, count = 11 }"
        raise file.error(keys, f"is {shown(values)}; {wanted}.")
    return tuple(read_value(file, keys, value) for value in values)
