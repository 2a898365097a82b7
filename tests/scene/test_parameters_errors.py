"""Parameters by name: refused names, values and assignments, and the text `name=value`."""

import operator
import re
from pathlib import Path

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from hypothesis import given, settings

from raytrace_jax import ParameterError, load_scene, parse_scene, set_parameters
from raytrace_jax.scene.parameters import parse_assignment, scalar_names, shared_with

VITREOUS = load_scene(Path(__file__).parents[2] / "data" / "vitreous.txt", dtype=np.float32)
BACKDROP = parse_scene(
    """
    camera eye { pixeldim 4 3 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
    material board { }
    rectangle backdrop { material board center 0 0 -2 right 6 0 0 up 0 4 0 }
    """,
    dtype=np.float32,
)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("cyan.ior", "vitreous.ior"),
        ("vitreous.center", "vitreous.center.x"),
        ("vitreous.center.x", "vitreous.center"),
        ("cyan.ambient.g", "vitreous.ambient"),
    ],
)
def test_two_names_of_a_number_are_refused(one, other):
    message = re.escape(f"{one!r} and {other!r} both give the number")
    with pytest.raises(ParameterError, match=message):
        scalar_names(VITREOUS, ["cyan.alpha", one, other])
    with pytest.raises(ParameterError, match=message):
        set_parameters(VITREOUS, {name: VITREOUS[name] for name in (one, other)})


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("vitreus.ior", ["'vitreus.ior'", "'vitreous'?", "centerback", "vitreous"]),
        ("vitreous.iorr", ["'iorr'", "'ior'?", "center, radius", "material 'cyan'", "ambient"]),
        ("topright.radius", ["unknown attribute 'radius'", "location, emissivity"]),
        ("vitreous.center.r", ["center has no component 'r'", "x, y, z"]),
        ("vitreous.ior.x", ["ior has no component 'x'", "single number"]),
        ("cam1.pixeldim", ["size option"]),
        ("vitreous.material", ["not a continuous parameter", "file"]),
        ("vitreous", ["one of its numbers: vitreous.center, vitreous.radius, "]),
        ("ior", ["block.attribute", "cam1.viewpoint"]),
        ("", ["block.attribute"]),
        ("..x", ["'..x'"]),
    ],
)
def test_unknown_names_say_what_exists(name, words):
    for access in (operator.getitem, shared_with, lambda scene, name: scalar_names(scene, [name])):
        with pytest.raises(ParameterError) as caught:
            access(VITREOUS, name)
        for word in words:
            assert word in str(caught.value)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"vitreous.radius": 0}, ["'vitreous.radius'", "greater than 0"]),
        ({"cyan.alpha": 1.01}, ["alpha must be from 0 to 1"]),
        ({"leftwall.normal": (0, 0, 0)}, ["normal must be", "0 0 0"]),
        ({"leftwall.normal.x": 0, "leftwall.normal.z": 0}, ["normal must be"]),
        ({"vitreous.center.x": np.nan}, ["finite", "nan"]),
        ({"vitreous.center": (1, 2, np.inf)}, ["finite", "inf"]),
        ({"vitreous.center.x": 1e39}, ["finite in float32", "1e+39"]),
        ({"vitreous.center.x": 10**400}, ["finite in float32", "'1000"]),
        ({"vitreous.center": np.ma.array([1.0, 2.0, 3.0], mask=[0, 0, 1])}, ["finite in float32", "--"]),
        ({"vitreous.center": 1.0}, ["takes 3 numbers, got 1 number."]),
        ({"vitreous.radius": (1, 2)}, ["takes 1 number", "got 2 numbers"]),
        ({"vitreous.center": [1, np.ones(2), 3]}, ["row of numbers"]),
        ({"eye.fov": 180}, ["'eye.fov'", "less than 180", "got 180.0"]),
        ({"eye.lookat.z": 5}, ["'eye.lookat.z'", "another point than viewpoint"]),
        ({"eye.up": (0, 0, 3)}, ["'eye.up'", "must not be parallel"]),
        ({"backdrop.up.x": 1}, ["'backdrop.up.x'", "orthogonal", "75.9638 degrees"]),
        ({"eye.worlddim": (8, 6)}, ["has no worlddim", "viewpoint, lookat, up, fov"]),
    ],
)
def test_concrete_values_obey_limits_in_jit(values, words):
    is_course = not any(name.startswith(("eye.", "backdrop.")) for name in values)
    scene, other = (VITREOUS, "topright.location.y") if is_course else (BACKDROP, "backdrop.center.z")
    in_jit = jax.jit(lambda traced: set_parameters(scene, values | {other: traced}))
    for setter in (lambda: set_parameters(scene, values), lambda: in_jit(1.0)):
        with pytest.raises(ParameterError) as caught:
            setter()
        for word in words:
            assert word in str(caught.value)


def test_joint_values_are_set_together():
    turned = set_parameters(BACKDROP, {"backdrop.right": (0, 6, 0), "backdrop.up": (4, 0, 0), "eye.fov": 50})
    assert turned["backdrop.up"].tolist() == [4, 0, 0]


@pytest.mark.parametrize("name", ["backdrop.up.x", "eye.viewpoint"])
def test_traced_values_are_not_checked(name):
    value = BACKDROP[name]
    changed = jax.jit(lambda x: set_parameters(BACKDROP, {name: x}))(value)
    np.testing.assert_array_equal(changed[name], value)


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3))
@settings(max_examples=100, deadline=None)
def test_an_assignment_keeps_its_numbers(numbers):
    text = "vitreous.center=" + ",".join(map(repr, numbers))
    assert parse_assignment(text) == ("vitreous.center", numbers)
    assert parse_assignment(" vitreous.center = 4.2, 2.3 ,-1 ") == ("vitreous.center", (4.2, 2.3, -1.0))
    assert parse_assignment("a=b.ior=1.4") == ("a=b.ior", (1.4,))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("vitreous.ior", "name=value"),
        ("=1.4", "name=value"),
        ("vitreous.center=1,,2", "'' is not a number"),
        ("vitreous.ior=glass", "'glass' is not a number"),
        ("vitreous.ior=nan", "not a finite number"),
        ("vitreous.ior=1e999", "too large"),
    ],
)
def test_bad_assignments_say_why(text, word):
    with pytest.raises(ParameterError) as caught:
        parse_assignment(text)
    assert word in str(caught.value)
    assert repr(text) in str(caught.value)


def test_a_block_is_told_its_numbers():
    with pytest.raises(ParameterError) as error:
        VITREOUS["vitreous"]
    told = str(error.value)
    assert told.startswith("'vitreous' is a whole sphere, and a parameter is one of its numbers: vitreous.center, ")
    assert "Did you mean" not in told
    names = re.findall(r"vitreous\.\w+", told)
    assert len(names) == len(set(names)) > 2 and {"vitreous.radius", "vitreous.ior"} <= set(names)
    assert "vitreous.emission" not in names  # Of another model.
    assert all(VITREOUS[name].size for name in names)
    words = "'vitreus' is no parameter .* Did you mean 'vitreous'?"
    with pytest.raises(ParameterError, match=words):
        VITREOUS["vitreus"]
