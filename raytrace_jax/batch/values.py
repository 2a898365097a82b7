"""The values in a plan: of parameters, alone or many; of options, by the type that they have to be."""

import math
from typing import Any

import numpy as np

from raytrace_jax.batch.plan_file import Keys, PlanFile, shown

Value = float | tuple[float, ...]
"""A parameter's value: a number, or the numbers of a vector."""

RANGE = ("start", "stop", "count")
MOST_IN_RANGE = 1_000_000


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
    return tuple(np.linspace(start, stop, count).tolist())


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
