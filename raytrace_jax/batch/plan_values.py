"""The values of parameters in a plan, alone or many."""

import dataclasses
import math
from typing import Annotated, Any

from raytrace_jax.batch.plan_file import Keys, PlanFile, shown
from raytrace_jax.util.checked import Checked, Wanted, suits
from raytrace_jax.util.ranges import evenly_spaced

Value = float | tuple[float, ...]
"""A parameter's value: a number, or the numbers of a vector."""

Finite = Annotated[float, Wanted("a finite number", above=-math.inf, below=math.inf)]


@dataclasses.dataclass(frozen=True)
class Range(Checked):
    """Numbers that are evenly spaced, both ends included."""

    start: Finite
    stop: Finite
    count: Annotated[int, Wanted(least=1, most=1_000_000)]


RANGE = tuple(field.name for field in dataclasses.fields(Range))


def read_value(file: PlanFile, keys: Keys, value: Any) -> Value:
    """A parameter's value: a number, or an array of numbers. Raises PlanError for anything else."""
    if suits(value, Finite):
        return float(value)
    if isinstance(value, list) and value and suits(value, tuple[Finite, ...]):
        return tuple(map(float, value))
    raise file.error(keys, f"is {shown(value)}; a finite number is wanted, or an array of them for a vector.")


def read_values(file: PlanFile, keys: Keys, values: Any) -> tuple[Value, ...]:
    """Many values of a parameter: an array of them, or a table that is a `Range`.

    Raises:
        PlanError: it is neither, is empty, or one of the values is no value.
    """
    if isinstance(values, dict):
        file.table(keys, known=RANGE)
        found = file.read(keys, Range)
        return tuple(evenly_spaced(found.start, found.stop, found.count))
    if not isinstance(values, list) or not values:
        wanted = "an array of values is wanted, or { start = 1.0, stop = 2.0, count = 11 }"
        raise file.error(keys, f"is {shown(values)}; {wanted}.")
    return tuple(read_value(file, keys, value) for value in values)
