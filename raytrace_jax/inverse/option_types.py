"""Options of a fit that are of another type than is wanted: a number for a pair, a text for a list."""

from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import NamedTuple

from raytrace_jax.errors import ParameterError


class Wanted(NamedTuple):
    """What an option has to be: whether a value is, and the words for it."""

    holds: Callable[[object], bool]
    words: str


def is_number(value: object) -> bool:
    """Whether it is one number, also of NumPy or JAX."""
    return (isinstance(value, Real) and not isinstance(value, bool)) or getattr(value, "shape", None) == ()


def is_whole(value: object) -> bool:
    """Whether it is a whole number."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_row(value: object, holds: Callable[[object], bool]) -> bool:
    """Whether it is a row, and no text, whose entries all are something."""
    rows = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return (rows or len(getattr(value, "shape", ())) == 1) and all(map(holds, value))  # type: ignore[arg-type]


def is_table(value: object, holds: Callable[[object], bool]) -> bool:
    """Whether it goes from names to values that all are something."""
    return (
        isinstance(value, Mapping) and all(isinstance(name, str) for name in value) and all(map(holds, value.values()))
    )


def is_text(value: object) -> bool:
    """Whether it is a text."""
    return isinstance(value, str)


def is_pair(value: object) -> bool:
    """Whether it is two numbers."""
    return is_row(value, is_number) and len(value) == 2  # type: ignore[arg-type]


WANTED = {
    "ties": Wanted(lambda value: is_table(value, is_text), "the leader's name by the follower's"),
    "priors": Wanted(
        lambda value: is_table(value, is_pair),
        "(mean, standard deviation) by name, as {'glass.ior': (1.5, 0.1)}",
    ),
    "uncertain": Wanted(
        lambda value: is_table(value, lambda one: is_number(one) or is_text(one)),
        "a standard deviation, or a share as '0.1%', by name",
    ),
    "sigma": Wanted(is_number, "a number"),
    "blur": Wanted(lambda value: is_row(value, is_number), "a list of numbers"),
    "profiles": Wanted(lambda value: is_row(value, is_text), "a list of names"),
    "target_samples": Wanted(is_whole, "a whole number"),
    "max_steps": Wanted(is_whole, "a whole number"),
    "max_seconds": Wanted(is_number, "a number"),
}
"""What the options have to be, by their names; those that may be None are not asked."""


def check_types(options: object) -> None:
    """Refuse options of another type.

    Raises:
        ParameterError: says what it is and what is wanted.
    """
    for name, wanted in WANTED.items():
        value = getattr(options, name)
        if value is not None and not wanted.holds(value):
            raise ParameterError(f"{name} is {value!r}; wanted {wanted.words}.")
