"""Words for people, and the numbers and lengths that people write; free of NumPy, for the help of commands."""

import contextlib
import difflib
import math
import re
import shlex
from collections.abc import Iterable, Sequence
from typing import Literal

from ..errors import RaytraceError

LONGEST_QUOTE, LONGEST_LIST = 60, 30


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST_QUOTE else text[:LONGEST_QUOTE] + "…"


def quoted(text: str) -> str:
    """User input in quotes on one line, cut to a readable length."""
    return repr(_cut(text))


def listed(names: Iterable[str]) -> str:
    """Names with commas between, cut to a readable length; `none` if there are none."""
    names = list(names)
    rest = f" and {len(names) - LONGEST_LIST} more" if len(names) > LONGEST_LIST else ""
    return (", ".join(map(_cut, names[:LONGEST_LIST])) or "none") + rest


def is_unicode(text: str) -> bool:
    """Whether a text can be written: Python reads a file's name that is not UTF-8 as one that cannot."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def sentence(text: str) -> str:
    """The text with a full stop, unless it ends in a mark already."""
    return text if text.endswith((".", "?", "!")) else f"{text}."


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ` Did you mean 'x'?` for the known name closest to the word, or nothing if none is close."""
    # difflib takes quadratic time in a word's length: no name that a person mistyped is this long.
    if len(word) > LONGEST_QUOTE:
        return ""
    by_lower_case = {name.lower(): name for name in known if len(name) <= LONGEST_QUOTE}
    matches = difflib.get_close_matches(word.lower(), by_lower_case, n=1)
    return f" Did you mean {by_lower_case[matches[0]]!r}?" if matches else ""


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines of a table whose columns are as wide as their longest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


# Possessive quantifiers (++) keep a long run of digits linear. Python's own float() would also take
# underscores, other alphabets' digits, nan and infinity.
_NUMBER = re.compile(r"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")
_INTEGER = re.compile(r"[+-]?[0-9]++")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)


def looks_like_number(text: str) -> bool:
    """Whether the text was meant as a number, finite or not."""
    return bool(_NUMBER.fullmatch(text) or _NOT_FINITE.fullmatch(text))


def parse_number(text: str) -> float:
    """Read a finite decimal number as float64. Raises ValueError that says what is wrong with the text."""
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"{quoted(text)} is not a finite number")
    if not _NUMBER.fullmatch(text):
        hint = " (numbers have a decimal point and are separate, without commas)" if "," in text else ""
        raise ValueError(f"{quoted(text)} is not a number{hint}")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{quoted(text)} is too large, it is infinite in float64")
    return value


def parse_integer(text: str) -> float:
    """Read a whole number written without a decimal point or exponent. Raises ValueError as `parse_number`.

    The result is a float64, which is exact for every picture size and cannot be too long to convert.
    """
    value = parse_number(text)
    if not _INTEGER.fullmatch(text):
        raise ValueError(f"{quoted(text)} is not a whole number")
    return value


MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "µm": 1e-3, "in": 25.4}
"""Millimetres in one of a unit, by the words for it."""

PaperName = Literal["a4", "a3", "letter"]

PAPERS: dict[PaperName, tuple[float, float]] = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
"""Width and height of the papers that are printed on, in millimetres, lying on the longer side."""

MaterialKind = Literal["glass", "liquid", "plastic", "crystal"]

LENGTH = re.compile(rf"\s*({_NUMBER.pattern})\s*([A-Za-zµ]*)\s*")


LENGTH_WANTED = "a length with its unit is wanted, as 10mm, 1cm or 0.4in"


def millimetres(text: str) -> float:
    """The millimetres of a length such as `10mm`, `1 cm` or `0.4in`.

    Raises:
        RaytraceError: it is no number with a unit, or not greater than 0.
    """
    length, _ = _length(text, text, LENGTH_WANTED)
    return _positive(length, text)


def value_and_deviation(text: str) -> tuple[str, str | None]:
    """The parts of a text such as `1.5+-0.01`; `+/-` and `±` do as well. None stands for no deviation."""
    value, *deviation = re.split(r"\+-|\+/-|±", text, maxsplit=1)
    return value, deviation[0] if deviation else None


def with_tolerance(text: str, may_be_zero: bool = False) -> tuple[float, float]:
    """A length and its standard deviation, both in millimetres, of a text such as `40+-0.02mm` or `4cm+-0.2mm`.

    `+/-` and `±` do as well, and the length may leave its unit to the deviation, which is 0 if none is given. With
    `may_be_zero` the length may be 0, without a deviation.

    Raises:
        RaytraceError: a part is no number with a unit, the length is not greater than 0, or the deviation is below 0.
    """
    value, deviation = value_and_deviation(text)
    wanted, sigma, unit = LENGTH_WANTED, 0.0, ""
    if deviation is not None:
        wanted = "a length and its standard deviation are wanted, as 40+-0.02mm, with one +-"
        sigma, unit = _length(deviation, text, wanted)
    if sigma < 0:
        raise RaytraceError(f"{quoted(text)}: a standard deviation is 0 or greater.")
    length, _ = _length(value, text, wanted, unit)
    return length if may_be_zero and length == sigma == 0 else _positive(length, text), sigma


def _length(text: str, whole: str, wanted: str, unit: str = "") -> tuple[float, str]:
    """The millimetres of a part of the text that messages quote, and its unit, which is `unit` if it has none."""
    match = LENGTH.fullmatch(text)
    if match is None:
        raise RaytraceError(f"{quoted(whole)} came, and {wanted}.")
    unit = match[2].lower() or unit
    if unit not in MILLIMETRES:
        what = f"the unit {quoted(match[2])} is unknown" if unit else "it has no unit"
        raise RaytraceError(f"{quoted(whole)}: {what}, and {wanted}; units are {', '.join(MILLIMETRES)}.")
    return float(match[1]) * MILLIMETRES[unit], unit


def _positive(length: float, whole: str) -> float:
    if not (length > 0 and math.isfinite(length)):
        raise RaytraceError(f"{quoted(whole)} came, and a length greater than 0 is wanted.")
    return length


def install(extra: str) -> str:
    """The command that installs what an extra needs, wherever this package came from: a checkout or a wheel."""
    import importlib.metadata  # It takes as long as all else that --help imports of ours.

    needed: list[str] = []
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # A checkout on the path that is not installed.
        rows = (row.replace('"', "'").partition(";") for row in importlib.metadata.requires("raytrace-ior") or ())
        needed = [package.strip() for package, _, when in rows if when.split()[-1:] == [repr(extra)]]
    return shlex.join(["pip", "install", *needed]) if needed else f"pip install '.[{extra}]' in the checkout"
