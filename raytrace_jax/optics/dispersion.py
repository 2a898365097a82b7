"""The index of refraction by wavelength: the formulas of refractiveindex.info, in NumPy's float64.

Formulas have their numbers there ("Dispersion formulas", refractiveindex.info/about). Wavelengths are in nanometres,
within a formula in micrometres.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

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


def cauchy_index(n_d: Any, abbe: Any, wavelength: Any) -> Any:
    """The index of refraction by Cauchy's equation, `n(lambda) = A + B / lambda^2`.

    The index n_d at the helium line d and Abbe's number `V = (n_d - 1) / (n_F - n_C)` give both constants:

        n(lambda) = n_d + B (1 / lambda^2 - 1 / lambda_d^2),    B = (n_d - 1) / (V (1 / lambda_F^2 - 1 / lambda_C^2)).

    All may be numbers, or arrays of NumPy or JAX; the wavelength is in nanometres. (Cauchy 1836; Born and Wolf,
    "Principles of Optics", 2.3.4.)
    """
    line_d, line_f, line_c = 587.56, 486.13, 656.27  # Fraunhofer's lines in nanometres.
    b = (n_d - 1) / (abbe * (line_f**-2 - line_c**-2))
    return n_d + b * (wavelength**-2 - line_d**-2)


class Dispersion(NamedTuple):
    """The index at the line d and Abbe's number, with their covariance."""

    n_d: float
    abbe: float
    covariance: Float[np.ndarray, "2 2"]

    @property
    def errors(self) -> Float[np.ndarray, "2"]:
        """The standard deviations of both."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def is_told(self) -> bool:
        """Whether there is a dispersion, by three errors of Abbe's number."""
        return bool(3 * self.errors[1] < self.abbe)


def dispersion(
    index: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "3 3"],
    wavelengths: Sequence[tuple[float, float]] = tuple((length, 0.0) for length in CHANNEL_WAVELENGTHS),
) -> Dispersion:
    """The index at the line d and Abbe's number, from the indices of red, green and blue.

    Between the channels the index follows one oscillator, `1 / (n^2 - 1) = a + b / lambda^2` (Wemple and DiDomenico
    1971), by least squares with the errors of indices and wavelengths.

    Args:
        wavelengths: of each channel in nm, with its standard deviation.
    """
    # What the channels have in common says nothing of their differences: those alone weigh them.
    apart = np.trace((np.eye(3) - 1 / 3) @ covariance) / 3 + 1e-5**2
    deviation = np.array([spread for _, spread in wavelengths])

    def lines(inputs: Float[np.ndarray, "6"]) -> Float[np.ndarray, "2"]:
        """The index at d, and the dispersion n_F - n_C, of three indices and three wavelengths."""
        n, length = np.split(inputs, 2)
        rows, y, slope = np.stack([np.ones(3), length**-2], axis=1), 1 / (n**2 - 1), -2 * n / (n**2 - 1) ** 2
        of_y = apart * slope**2 + (np.linalg.lstsq(rows, y)[0][1] * 2 * length**-3 * deviation) ** 2
        weighted = (rows / of_y[:, None]).T
        a, b = np.linalg.solve(weighted @ rows, weighted @ y)
        d, f, c = np.sqrt(1 + 1 / (a + b * np.array(LINES) ** -2))
        return np.array([d, f - c])

    at = np.concatenate([index, [length for length, _ in wavelengths]])
    variance = np.zeros((6, 6))
    variance[:3, :3], variance[3:, 3:] = covariance, np.diag(deviation**2)
    steps = np.diag([1e-7] * 3 + [1e-3] * 3)
    jacobian = np.stack([(lines(at + step) - lines(at - step)) / (2 * step.sum()) for step in steps], axis=1)
    n_d, apart_f_c = map(float, lines(at))
    apart_f_c = apart_f_c if abs(apart_f_c) > 1e-12 else 1e-12
    abbe = (n_d - 1) / apart_f_c
    jacobian = np.array([[1, 0], [1 / apart_f_c, -abbe / apart_f_c]]) @ jacobian
    total = jacobian @ variance @ jacobian.T
    # One oscillator misses Abbe's number of 1,672 glasses in catalogues by so much, rms.
    total[1, 1] += (0.012 * abbe) ** 2
    return Dispersion(n_d, abbe, total)
