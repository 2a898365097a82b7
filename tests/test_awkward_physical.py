"""Glass in awkward places: pictures and derivatives are finite, and both modes of differentiation agree."""

import pytest
from awkward_physical import AWKWARD, both_modes, faults

SEEDS = range(len(AWKWARD), len(AWKWARD) + 20)
"""`experiments/physical/fuzz.py` has hundreds."""


@pytest.fixture(scope="module")
def aware():
    return both_modes("aware")


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_pictures_with_edges_are_finite(aware, seed):
    assert faults(aware, seed, AWKWARD[seed % len(AWKWARD)]) == []


@pytest.mark.slow
def test_pictures_of_points_are_finite():
    program = both_modes("point")
    assert [faults(program, seed, AWKWARD[seed % len(AWKWARD)]) for seed in SEEDS] == [[]] * len(SEEDS)
