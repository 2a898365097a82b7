"""Lengths as people write them, with their unit; free of NumPy, for the command line's help."""

import math
import re
from typing import Literal

from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.words import quoted

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "µm": 1e-3, "in": 25.4}
"""Millimetres in one of a unit, by the words for it."""

PaperName = Literal["a4", "a3", "letter"]

PAPERS: dict[PaperName, tuple[float, float]] = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
"""Width and height of the papers that are printed on, in millimetres, lying on the longer side."""

WANTED = "a length with its unit is wanted, as 10mm, 1cm or 0.4in"
NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LENGTH = re.compile(rf"\s*([+-]?{NUMBER})\s*([A-Za-zµ]*)\s*")
APART = re.compile(r"\+-|\+/-|±")


def millimetres(text: str) -> float:
    """The millimetres of a length such as `10mm`, `1 cm` or `0.4in`.

    Args:
        text: a number and one of the units of `MILLIMETRES`.

    Raises:
        RaytraceError: it is no number with a unit, or not greater than 0.
    """
    return _positive(*_parts(text, text, WANTED), text)


def with_tolerance(text: str) -> tuple[float, float]:
    """A length and its standard deviation, both in millimetres, of a text such as `40+-0.02mm` or `4cm+-0.2mm`.

    Args:
        text: a length; or two with `+-`, `+/-` or `±` between them, where the first may leave its unit to the second.

    Returns:
        The length, and its standard deviation: 0 if none is given.

    Raises:
        RaytraceError: a part is no number with a unit, the length is not greater than 0, or the deviation is below 0.
    """
    value, *others = APART.split(text)
    if not others:
        return millimetres(text), 0.0
    wanted = "a length and its standard deviation are wanted, as 40+-0.02mm"
    if len(others) > 1:
        raise RaytraceError(f"{quoted(text)}: {wanted}, with one +-.")
    sigma, unit = _parts(others[0], text, wanted)
    bare = re.fullmatch(rf"\s*[+-]?{NUMBER}\s*", value)
    length, length_unit = _parts(value + unit if bare else value, text, wanted)
    if sigma < 0:
        raise RaytraceError(f"{quoted(text)}: a standard deviation is 0 or greater.")
    return _positive(length, length_unit, text), sigma * MILLIMETRES[unit]


def _parts(text: str, whole: str, wanted: str) -> tuple[float, str]:
    """The number and the unit of a text, which is a part of the `whole` that messages quote."""
    match = LENGTH.fullmatch(text)
    if match is None:
        raise RaytraceError(f"{quoted(whole)} came, and {wanted}.")
    number, unit = float(match[1]), match[2].lower()
    if unit not in MILLIMETRES:
        what = f"the unit {quoted(match[2])} is unknown" if unit else "it has no unit"
        raise RaytraceError(f"{quoted(whole)}: {what}, and {wanted}; units are {', '.join(MILLIMETRES)}.")
    return number, unit


def _positive(number: float, unit: str, whole: str) -> float:
    length = number * MILLIMETRES[unit]
    if not (length > 0 and math.isfinite(length)):
        raise RaytraceError(f"{quoted(whole)} came, and a length greater than 0 is wanted.")
    return length
