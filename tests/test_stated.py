"""How well numbers are known, as a user says it: names of numbers, vectors, blocks and kinds of blocks."""

from pathlib import Path

import numpy as np
import pytest

from raytrace_jax import ParameterError, load_scene
from raytrace_jax.inverse.fixed import stated_uncertainties
from raytrace_jax.inverse.unknowns import make_unknowns

SCENE = load_scene(Path(__file__).parents[1] / "data" / "vitreous.txt")
FREE = make_unknowns(SCENE, ["vitreous.ior", "vitreous.center"])


def stated(**uncertain):
    return stated_uncertainties(SCENE, FREE, {name.replace("__", "."): amount for name, amount in uncertain.items()})


def test_a_number_a_share_of_it_and_a_vector():
    assert stated(vitreous__radius=0.002) == {"vitreous.radius": 0.002}
    assert stated(vitreous__radius="0.1%") == {"vitreous.radius": pytest.approx(0.0023)}
    assert stated(vitreous__radius="0.1 %") == stated(vitreous__radius="0.1%")
    length = float(np.linalg.norm([6, 4, 1]))
    expected = {f"topright.location.{letter}": pytest.approx(0.01 * length, rel=1e-6) for letter in "xyz"}
    assert stated(topright__location="1%") == expected
    assert stated(vitreous__alpha=0.01) == {"cyan.alpha": 0.01}, "by its canonical name"


def test_blocks_and_kinds_of_blocks_without_what_is_free():
    assert set(stated(cam1=0.1)) == {"cam1.worlddim.x", "cam1.worlddim.y", *(f"cam1.viewpoint.{x}" for x in "xyz")}
    assert {name.partition(".")[0] for name in stated(lights="1%")} == {"centerback", "backleft", "topright"}
    assert set(stated(vitreous=0.1)) == {"vitreous.radius"}, "its center is free"


def test_what_is_said_of_fewer_numbers_holds():
    found = stated(cam1=0.1, cam1__viewpoint__z=0.5)
    assert found["cam1.viewpoint.z"] == 0.5 and found["cam1.viewpoint.x"] == 0.1
    assert stated(cam1__viewpoint__z=0.5, cam1=0.1) == found


@pytest.mark.parametrize(
    ("uncertain", "message"),
    [
        ({"vitreous.ior": 0.1}, "uncertain vitreous.ior: vitreous.ior is free; .* prior"),
        ({"cyan.ior": 0.1}, "is free"),
        ({"vitreous.radius": 0.0}, "wanted a standard deviation above 0 .* share as 0.1%"),
        ({"vitreous.radius": "-1%"}, "wanted a standard deviation above 0"),
        ({"vitreous.radius": "much"}, "uncertain vitreous.radius=much"),
        ({"vitreous.radius": float("nan")}, "wanted a standard deviation"),
        ({"vitreous.radios": 1.0}, "radios.*Did you mean 'radius'"),
        (
            {"lamps": 1.0},
            "neither a number, as .* nor a block nor a kind of blocks. Blocks are .*cam1.*kinds are .*lights",
        ),
        ({"green.alpha": "1%"}, "it is 0, of which a share is nothing"),
    ],
)
def test_what_makes_no_sense_is_refused(uncertain, message):
    with pytest.raises(ParameterError, match=message):
        stated_uncertainties(SCENE, FREE, uncertain)
