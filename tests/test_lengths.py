"""Lengths with units, and with a standard deviation; what is none is refused in words."""

import pytest

from raytrace_jax import RaytraceError
from raytrace_jax.util.text import millimetres, with_tolerance


@pytest.mark.parametrize(
    ("text", "value"),
    [("10mm", 10), ("1cm", 10), ("0.4in", 10.16), (" 1.5 CM ", 15), (".5m", 500), ("250um", 0.25), ("1e1mm", 10)],
)
def test_lengths_are_read(text, value):
    assert millimetres(text) == pytest.approx(value, rel=1e-12)
    assert with_tolerance(text) == (millimetres(text), 0)


@pytest.mark.parametrize("text", ["40+-0.02mm", "40 mm +- 0.02 mm", "4cm+-0.02mm", "40mm±20um", "40+/-0.02mm"])
def test_tolerances_are_read(text):
    assert with_tolerance(text) == pytest.approx((40, 0.02), rel=1e-12)
    assert with_tolerance("40+-0mm") == (40, 0)


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (millimetres, "", "'' came, and a length with its unit is wanted"),
        (millimetres, "ten", "'ten' came, and a length with its unit is wanted, as 10mm, 1cm or 0.4in"),
        (millimetres, "10", "'10': it has no unit"),
        (millimetres, "10ell", "'10ell': the unit 'ell' is unknown, .*; units are mm, cm, m, um, µm, in"),
        (millimetres, "0mm", "'0mm' came, and a length greater than 0 is wanted"),
        (millimetres, "-1mm", "a length greater than 0"),
        (millimetres, "1e999mm", "a length greater than 0"),
        (millimetres, "10mm+-1mm", "a length with its unit is wanted"),
        (with_tolerance, "40+-0.02", "'40.-0.02': it has no unit, and a length and its standard deviation are wanted"),
        (with_tolerance, "40mm+-", "a length and its standard deviation are wanted, as 40"),
        (with_tolerance, "40+-1mm+-1mm", "with one"),
        (with_tolerance, "40+--1mm", "a standard deviation is 0 or greater"),
        (with_tolerance, "0+-1mm", "a length greater than 0"),
    ],
)
def test_what_is_no_length_is_refused(read, text, words):
    with pytest.raises(RaytraceError, match=words):
        read(text)
