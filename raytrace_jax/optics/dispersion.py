"""The index of refraction by wavelength: the formulas of refractiveindex.info, in NumPy's float64.

Formulas have their numbers there ("Dispersion formulas", refractiveindex.info/about). Wavelengths are in nanometres,
within a formula in micrometres.
"""

from collections.abc import Sequence

import numpy as np

Numbers = float | Sequence[float | int] | np.ndarray

LINE_D, LINE_F, LINE_C = LINES = (587.5618, 486.1327, 656.2725)
"""Helium's yellow line d and hydrogen's blue F and red C, in nanometres."""

CHANNEL_WAVELENGTHS = (610.0, 550.0, 465.0)
"""The wavelengths for which red, green and blue stand in a picture, in nanometres."""


def formula_index(formula: int, coefficients: Sequence[float | int], wavelength: Numbers) -> np.ndarray:
    """The index by one of the formulas 1 to 9, of the shape of `wavelength`.

    1 and 2 are Sellmeier's (1871), 3 a polynomial of n^2, 4 their sum, 5 Cauchy's (1836), 6 that of gases, 7
    Herzberger's (1959), 8 is "Retro" and 9 "Exotic".

    Args:
        coefficients: C1, C2 ... in the order of the formula, as many as it has; those at the end that are 0 may lack.
    """
    x = np.asarray(wavelength, np.float64) / 1000
    c = np.zeros(max(len(coefficients), 9) // 2 * 2 + 1)  # C1, and pairs.
    c[: len(coefficients)] = coefficients
    x2, b, e = x**2, *(column.reshape(-1, *[1] * x.ndim) for column in (c[1::2], c[2::2]))
    if formula in (1, 2):
        n = np.sqrt(1 + c[0] + np.sum(b * x2 / (x2 - (e**2 if formula == 1 else e)), 0))
    elif formula in (3, 5):
        n = c[0] + np.sum(b * x**e, 0)
        n = np.sqrt(n) if formula == 3 else n
    elif formula == 4:
        # A term without a coefficient is left out: 0^0 could make its denominator 0.
        terms = [c[k] * x ** c[k + 1] / (x2 - c[k + 2] ** c[k + 3]) for k in (1, 5) if c[k]]
        n = np.sqrt(c[0] + sum(terms) + np.sum(b[4:] * x ** e[4:], 0))
    elif formula == 6:
        n = 1 + c[0] + np.sum(b / (e - 1 / x2), 0)
    elif formula == 7:
        pole = 1 / (x2 - 0.028)
        n = c[0] + c[1] * pole + c[2] * pole**2 + c[3] * x2 + c[4] * x2**2 + c[5] * x2**3
    elif formula == 8:
        ratio = c[0] + c[1] * x2 / (x2 - c[2]) + c[3] * x2  # (n^2 - 1) / (n^2 + 2)
        n = np.sqrt((1 + 2 * ratio) / (1 - ratio))
    elif formula == 9:
        shifted = x - c[4]
        n = np.sqrt(c[0] + c[1] / (x2 - c[2]) + c[3] * shifted / (shifted**2 + c[5]))
    else:
        raise ValueError(f"formula is {formula}; it can be 1 to 9")
    return np.asarray(n)


def abbe_number(n_d: float, n_f: float, n_c: float) -> float:
    """Abbe's number `V_d = (n_d - 1) / (n_F - n_C)`, for n_F other than n_C."""
    return (n_d - 1) / (n_f - n_c)
