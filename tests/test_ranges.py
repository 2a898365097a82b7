"""Ranges of numbers: what they mean as decimals."""

from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax.batch.plan_file import PlanFile, read_values
from raytrace_jax.cli.actions.pictures import parse_range
from raytrace_jax.util.digits import evenly_spaced

NUMBERS = st.floats(-1e6, 1e6)


def test_decimals_stay_decimals():
    assert evenly_spaced(1.3, 1.6, 3) == [1.3, 1.45, 1.6]
    assert evenly_spaced(1.4, 1.6, 5) == [1.4, 1.45, 1.5, 1.55, 1.6]
    assert evenly_spaced(-0.3, 0.3, 7) == [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert evenly_spaced(1.0, 2.0, 4) == [1.0, 4 / 3, 5 / 3, 2.0]
    assert evenly_spaced(1.5, 2.0, 1) == [1.5]


@given(NUMBERS, NUMBERS)
def test_the_ends_are_themselves(start, stop):
    values = evenly_spaced(start, stop, 11)
    assert (values[0], values[-1]) == (start, stop)


def test_plans_and_sweeps_have_decimals(tmp_path):
    (tmp_path / "a.toml").write_text("start = 1.3\nstop = 1.6\ncount = 3")
    file = PlanFile(tmp_path / "a.toml")
    assert read_values(file, (), file.data)[1] == 1.45
    assert parse_range("glass.ior=1.3:1.6:3")[1][1] == 1.45
