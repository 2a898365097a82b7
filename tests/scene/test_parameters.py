"""Parameters by the names of the file: reach, list, change and differentiate them."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assert_same_scene

from raytrace_jax import list_parameters, load_scene, parse_scene, set_parameters
from raytrace_jax.scene.parameters import shared_with

VITREOUS = load_scene(Path(__file__).parents[2] / "data" / "vitreous.txt", dtype=np.float32)
SHARED = parse_scene(
    """
    camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }
    material glass { ior 1.5 } material ball { ior 1.2 } material my.red { ambient 1 0 0 }
    sphere last { material glass center 0 0 0 radius 1 }
    plane wall { material glass normal 0 0 1 point 0 0 0 }
    sphere ball { material glass center 1 2 -3 radius 2 }
    sphere dotted.x { material my.red center 1 2 -3 radius 2 }
    """,
    dtype=np.float32,
)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cyan.ior", 1.337),
        ("vitreous.ior", 1.337),
        ("vitreous.center", [4.3, 2.3, -1]),
        ("topright.emissivity.b", 1),
        ("cam1.worlddim.y", 6),
        ("red.diffuse.g", 0.7),
        ("rightwall.ambient", [5, 4, 0]),
    ],
)
def test_a_name_changes_only_its_value(name, value):
    np.testing.assert_array_equal(VITREOUS[name], np.float32(value))

    new = np.float32(value) * np.float32(0.5)
    changed = set_parameters(VITREOUS, {name: new})
    assert changed[name].dtype == np.float32
    np.testing.assert_array_equal(changed[name], new)
    differing = sum(
        int(np.sum(np.asarray(one) != np.asarray(other)))
        for one, other in zip(jax.tree.leaves(VITREOUS), jax.tree.leaves(changed), strict=True)
    )
    assert differing == np.count_nonzero(new)


def test_names_are_listed_as_written():
    names = list(list_parameters(VITREOUS))
    assert names[:4] == ["cam1.worlddim", "cam1.viewpoint", "cam1.center", "centerback.location"]
    assert names[-4:] == ["central.center", "central.radius", "vitreous.center", "vitreous.radius"]
    assert "cyan.ior" in names
    assert "vitreous.ior" not in names
    assert [name for name in list_parameters(SHARED) if name.endswith((".radius", ".point"))] == [
        "last.radius",
        "wall.point",
        "ball.radius",
        "dotted.x.radius",
    ]


def test_the_list_agrees_with_single_access():
    listed = list_parameters(VITREOUS)
    for name, value in listed.items():
        np.testing.assert_array_equal(value, VITREOUS[name])
    # every number of the scene is listed exactly once
    assert sum(value.size for value in listed.values()) == sum(leaf.size for leaf in jax.tree.leaves(VITREOUS))
    again = set_parameters(VITREOUS, listed)
    assert_same_scene(again, VITREOUS)


def test_sharing_shapes_are_in_file_order():
    assert shared_with(SHARED, "wall.ior") == ("last", "ball")
    assert shared_with(SHARED, "last.ambient.r") == ("wall", "ball")
    assert shared_with(SHARED, "last.center") == ()
    assert shared_with(SHARED, "glass.ior") == ()
    assert shared_with(VITREOUS, "vitreous.ior") == ()
    # A block's own attribute comes before that of a shape's material.
    assert float(SHARED["ball.ior"]) == np.float32(1.2) and shared_with(SHARED, "ball.ior") == ()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("value", [2, 2.0, (2.0,), np.float64(2), np.array([2], np.float32), jnp.asarray(2)])
def test_the_scene_keeps_its_dtype(dtype, value):
    with jax.enable_x64(True):
        scene = load_scene(Path(__file__).parents[2] / "data" / "vitreous.txt", dtype=dtype)
        changed = set_parameters(scene, {"vitreous.radius": value, "vitreous.center.x": value})
        assert {leaf.dtype for leaf in jax.tree.leaves(changed)} == {np.dtype(dtype)}
        assert float(changed["vitreous.radius"]) == 2


def test_values_and_scene_may_be_traced():
    def center_and_ior(scene, x, ior):
        changed = set_parameters(scene, {"vitreous.center": (x, 2 * x, -1.0), "vitreous.ior": ior})
        return changed["vitreous.center"], changed["cyan.ior"]

    center, ior = jax.jit(center_and_ior)(VITREOUS, jnp.float32(3), jnp.float32(1.5))
    assert center.tolist() == [3, 6, -1]
    assert float(ior) == 1.5


@pytest.mark.parametrize("differentiate", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_those_of_a_copy(differentiate):
    def numbers(values):
        changed = set_parameters(VITREOUS, {"vitreous.center": values[:3], "vitreous.ior": values[3]})
        return jnp.concatenate([leaf.ravel() for leaf in jax.tree.leaves(changed)])

    jacobian = np.asarray(differentiate(numbers)(jnp.float32([1, 2, 3, 4])))
    # each value lands in one number of the scene, unscaled; nothing else moves
    assert np.count_nonzero(jacobian) == 4
    np.testing.assert_array_equal(jacobian.sum(axis=0), 1)
