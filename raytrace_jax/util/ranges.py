"""Ranges of numbers as decimals: 1.45 of 1.4 to 1.6 is 1.45, and not its neighbour 1.4500000000000002."""

from fractions import Fraction


def evenly_spaced(start: float, stop: float, count: int) -> list[float]:
    """So many numbers from `start` to `stop`, both included; the floats nearest to what the decimals mean.

    Args:
        start, stop: finite numbers, meant as they are written.
        count: how many, 1 or more; of one it is `start`.
    """
    first, last = Fraction(repr(float(start))), Fraction(repr(float(stop)))
    step = (last - first) / max(1, count - 1)
    return [float(first + k * step) for k in range(count)]
