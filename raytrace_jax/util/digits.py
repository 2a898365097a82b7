"""Numbers in the fewest digits that read back to the same bits, estimates in the digits that count."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np

Measurement = tuple[float, float]
"""An estimate and its standard deviation."""

MOST_DIGITS = 16  # No float64 has more digits than these for certain.


def format_number(value: np.floating) -> str:
    """Write a finite number with the fewest digits that read back, through float64, to the same bits."""

    def shortest(value: np.floating) -> str:
        if value == 0 or 1e-5 <= abs(value) < 1e16:
            return np.format_float_positional(value, unique=True, trim="-")
        return np.format_float_scientific(value, unique=True, trim="-", exp_digits=1)

    text = shortest(value)
    # A float32 read through float64 is rounded twice; for a few numbers (7.038531e-26) the shortest text then
    # gives the neighbour. The number's own float64 text is exact and is rounded once.
    return text if type(value)(float(text)) == value else shortest(np.float64(value))


def with_error(value: float, error: float, long: bool = False) -> str:
    """Write an estimate with its error, the one way that it is done everywhere.

    The short form is `1.33701(23)`: the parentheses hold the error to two digits, in units of the value's last
    ones. An error from 1 to 9.9 keeps its point, `4.2(2.7)`; a power of ten follows, as `1.2345(12)e-7`. An error
    of up to five digits that is no smaller than its value is written out, `0(100)`. The long form is `1.33701 +-
    0.00023`, and both are `1.5 +- 3e-18` where an error is beyond a float64's digits. An error of infinity is not
    determined, NaN is unknown.
    """
    if not math.isfinite(value) or not math.isfinite(error):
        return f"{value:.8g}, {'not determined' if error == math.inf else 'error unknown'}"
    if error <= 0:
        return f"{value:.{MOST_DIGITS}g}" + (" +- 0" if long else "(0)")
    rounded = Decimal(f"{error:.1e}")
    place = rounded.adjusted() - 1
    first = max(Decimal(float(value)).adjusted() if value else place, place + 1)
    if first - place >= MOST_DIGITS:
        return f"{value:.{MOST_DIGITS}g} +- {error:.2g}"
    # The last digit must not lie left of the point, nor the first behind four zeros.
    power = first if first < -4 or (place > 0 and not first == place + 1 < 5) else 0
    rounded, place, behind = rounded.scaleb(-power), place - power, f"e{power}" if power else ""
    # `z` writes no minus sign before zero.
    text = f"{round(Decimal(float(value)).scaleb(-power), -place):z.{max(-place, 0)}f}"
    if long:
        return f"{text}{behind} +- {rounded:f}{behind}"
    digits = rounded if place > 0 or place < 0 <= rounded.adjusted() else rounded.scaleb(-place)
    return f"{text}({digits:f}){behind}"


def value_and_error(value: float, error: float) -> tuple[str, str]:
    """The two halves of the long form of `with_error`, for cells of their own; an unknown error is `inf` or `nan`."""
    if not math.isfinite(value) or not math.isfinite(error):
        return f"{value:.8g}", f"{error:g}"
    value_text, _, error_text = with_error(value, error, long=True).partition(" +- ")
    return value_text, error_text


def evenly_spaced(start: float, stop: float, count: int) -> list[float]:
    """So many numbers from `start` to `stop`, both included; the floats nearest to what the decimals mean.

    1.45 of 1.4 to 1.6 is 1.45, and not its neighbour 1.4500000000000002. Of one number it is `start`.
    """
    first, last = Fraction(repr(float(start))), Fraction(repr(float(stop)))
    step = (last - first) / max(1, count - 1)
    return [float(first + k * step) for k in range(count)]
