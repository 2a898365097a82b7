"""The formulas of refractiveindex.info against values published for materials that they describe."""

import numpy as np
import pytest

from raytrace_jax.optics.dispersion import LINE_D, LINES, abbe_number, formula_index

N_BK7 = (0, 1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653)
SILICA = (0, 0.6961663, 0.0684043, 0.4079426, 0.1162414, 0.8974794, 9.896161)


def test_sellmeier_of_bk7_and_of_silica():
    n_d, n_f, n_c = formula_index(2, N_BK7, LINES)
    assert (n_d, n_f, n_c) == pytest.approx((1.51680, 1.52238, 1.51432), abs=5e-6)  # SCHOTT's data sheet.
    assert abbe_number(n_d, n_f, n_c) == pytest.approx(64.17, abs=5e-3)
    assert formula_index(1, SILICA, LINE_D) == pytest.approx(1.45846, abs=5e-6)  # Malitson 1965, table 1.


def test_polynomial_is_hoyas_bsc7():
    bsc7 = (2.27093, -0.00947304, 2, 0.0108913, -2, 0.000150928, -4)
    lower = formula_index(3, bsc7, 700.0)
    squared = 2.27093 - 0.00947304 * 0.49 + 0.0108913 / 0.49 + 0.000150928 / 0.49**2
    assert lower == pytest.approx(np.sqrt(squared), abs=1e-12)


def test_cauchy_gases_and_herzberger():
    assert formula_index(5, (1.5, 0.004, -2), 500.0) == pytest.approx(1.516)
    air = (0, 0.05792105, 238.0185, 0.00167917, 57.362)  # Ciddor 1996: 1.000277 at 15 degrees.
    assert formula_index(6, air, LINE_D) == pytest.approx(1.00027717, abs=5e-8)
    # Silicon by Herzberger's formula: 3.42 in the infrared (Edwards and Ochoa 1980).
    silicon = (3.41983, 0.159906, -0.123109, 1.26878e-6, -1.95104e-9)
    assert formula_index(7, silicon, 10000.0) == pytest.approx(3.4215, abs=1e-3)


def test_mixed_forms():
    """Beta barium borate's ordinary index (Eimerl 1987), 1.6749 at 532 nm; the other two by their definitions."""
    bbo = (2.7405, 0.0184, 0, 0.0179, 1, 0, 0, 0, 1, -0.0155, 2)
    assert formula_index(4, bbo, 532.0) == pytest.approx(1.6749, abs=1e-3)
    n = formula_index(8, (0.2, 0.05, 0.01, -0.001), 600.0)
    assert (n**2 - 1) / (n**2 + 2) == pytest.approx(0.2 + 0.05 * 0.36 / 0.35 - 0.001 * 0.36)
    exotic = formula_index(9, (2.3, 0.01, 0.02, 0.03, 0.4, 0.05), 600.0)
    assert exotic**2 == pytest.approx(2.3 + 0.01 / 0.34 + 0.03 * 0.2 / (0.2**2 + 0.05))


def test_shape_and_the_place_where_padding_would_divide_by_zero():
    assert formula_index(2, N_BK7, np.full((2, 3), 500.0)).shape == (2, 3)
    assert np.isfinite(formula_index(4, (2.0, 0, 0, 0, 0, 0, 0, 0, 0, 0.01, 2), 1000.0))
    with pytest.raises(ValueError, match="1 to 9"):
        formula_index(10, N_BK7, 500.0)
