"""Numbers as text: strict reading, and the shortest writing that reads back to the same bits."""

import math
import re

import numpy as np

from raytrace_jax._words import quoted

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


def cast(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Cast float64 to the scene's dtype; what is too large becomes infinite, what is too small zero."""
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(dtype)


def format_number(value: np.floating) -> str:
    """Write a finite number with the fewest digits that read back, through float64, to the same bits."""
    text = _shortest(value)
    # A float32 read through float64 is rounded twice; for a few numbers (7.038531e-26) the shortest text then
    # gives the neighbour. The number's own float64 text is exact and is rounded once.
    return text if type(value)(float(text)) == value else _shortest(np.float64(value))


def _shortest(value: np.floating) -> str:
    if value == 0 or 1e-5 <= abs(value) < 1e16:
        return np.format_float_positional(value, unique=True, trim="-")
    return np.format_float_scientific(value, unique=True, trim="-", exp_digits=1)
