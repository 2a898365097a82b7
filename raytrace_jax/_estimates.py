"""A number with its standard error as text, both to the digits that mean something."""

import math

MOST_DECIMALS = 12


def value_and_error(value: float, standard_error: float) -> tuple[str, str]:
    """Write an estimate and its standard error, the error to two digits and the value to the same place.

    An error that is infinite, NaN, zero or beyond the digits of a float64 sets no place: the value then has eight
    digits, and the error is written in short (`inf`, `0`, `3e-15`).
    """
    if not math.isfinite(standard_error) or standard_error <= 0:
        return f"{value:.8g}", f"{standard_error:g}"
    # Rounding to two digits first: 0.0996 is 0.10, and its place is that of 0.10.
    rounded = float(f"{standard_error:.1e}")
    decimals = 1 - math.floor(math.log10(rounded))
    if decimals > MOST_DECIMALS:
        return f"{value:.8g}", f"{standard_error:.1g}"
    decimals = max(decimals, 0)
    return f"{value:.{decimals}f}", f"{rounded:.{decimals}f}"
