"""How large a scene is: what is counted in lengths follows it, in millimetres as in kilometres."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import DATA, assignment_scene, scaled_scene

from raytrace_jax import ParameterError, RenderSettings, list_parameters, load_scene, parse_scene, render
from raytrace_jax.inverse.problem.unknowns import Transform, make_unknowns, natural_scale
from raytrace_jax.scene.parameters import resolve, scalar_names
from raytrace_jax.scene.scene import world_length

LAB = """
camera eye { pixeldim 4 3 viewpoint 0 0 9 lookat 0 0 0 fov 40 }
light lamp { location 1 2 3 emissivity 1 .5 0 energy 20 }
material board { ambient 1 0 2 }
material glass { ior 1.5 alpha .5 }
plane floor { material board normal 0 1 0 point 0 0 0 }
rectangle backdrop { material board center 0 0 -2 right 6 0 0 up 0 4 0 }
sphere ball { material glass center 0 0 0 radius .5 }
"""


def lab_scene(dtype=jnp.float64):
    return parse_scene(LAB, dtype=dtype)


def image_plane(width, height, dtype=jnp.float64):
    text = f"camera eye {{ pixeldim 4 3 worlddim {width!r} {height!r} viewpoint 4 3 6 }}"
    return parse_scene(text, dtype=dtype)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_the_courses_scenes_measure_ten(dtype, factor):
    scene = scaled_scene(assignment_scene(dtype), factor)
    length = world_length(scene)
    assert length.dtype == dtype and length.shape == ()
    assert np.asarray(length) == np.asarray(10 * factor).astype(dtype)
    assert world_length(scaled_scene(lab_scene(dtype), factor)) == np.asarray(10 * factor).astype(dtype)


@given(st.integers(-30, 30), st.floats(0.33, 3.1), st.sampled_from([jnp.float32, jnp.float64]))
def test_the_length_is_a_power_of_ten(exponent, factor, dtype):
    side = factor * 10.0**exponent
    wanted = np.asarray(f"1e{exponent}", np.float64).astype(dtype)
    assert world_length(image_plane(0.6 * side, 0.8 * side, dtype)) == wanted
    for least, its in ((5e-324, 1e-307), (1e308, 1e308), (2e-308, 1e-307)):
        assert world_length(image_plane(least, least)) == its


def test_the_length_has_no_derivative():
    scene = assignment_scene()
    assert jax.jit(world_length)(scene) == 10
    slopes = jax.grad(lambda scene: world_length(scene))(scene)
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(slopes))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "factor", "model"),
    [
        (assignment_scene, 1e-3, "classic"),
        (assignment_scene, 1e3, "additive"),
        (lab_scene, 1e3, "classic"),
        (lab_scene, 1e-3, "additive"),
    ],
)
def test_a_scaled_scene_scales_transforms(make, factor, model):
    """Also those of parameters that are 0, and so have no size of their own."""
    scene = make()
    scaled = scaled_scene(scene, factor, model)
    names = scalar_names(scene, list_parameters(scene))
    assert len(names) > 30
    # The sides of a rectangle cannot all move alone.
    free = [name for name in names if not name.startswith(("backdrop.right.", "backdrop.up."))]
    ours, theirs = (make_unknowns(one, free, model=model) for one in (scene, scaled))
    by = np.array([factor ** resolve(scene, name).attribute.quantity.dimension_in(model) for name in free])
    scales = [[natural_scale(one, name, model) for name in free] for one in (scene, scaled)]
    np.testing.assert_allclose(scales[1], by * scales[0], rtol=1e-12)
    for y in (-3.0, -0.2, 0.0, 0.7, 12.0):
        at = jnp.full(len(free), y)
        np.testing.assert_allclose(theirs.values(at), by * ours.values(at), rtol=1e-12)
    start = ours.unknowns(ours.initial(scene))
    np.testing.assert_allclose(theirs.unknowns(theirs.initial(scaled)), start, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("start", [1e-3, 40.0, 179.9])
def test_an_angle_of_view_stays_below_180(start):
    quantity = resolve(lab_scene(), "eye.fov").attribute.quantity
    transform = Transform(*quantity.range_at(start))
    for dtype in (jnp.float32, jnp.float64):
        ends = [float(transform.to_value(jnp.asarray(y, dtype))) for y in (-1e3, -40, 40, 1e3)]
        assert min(ends) > 0 and max(ends) < 180
    assert float(transform.to_value(jnp.asarray(transform.to_unknown(40.0)))) == pytest.approx(40)


@pytest.mark.parametrize(
    ("name", "model", "words"),
    [
        ("backdrop.right.y", "classic", "where it moves alone, right and up must"),
        ("backdrop.up.x", "classic", "where it moves alone, right and up must"),
        ("glass.alpha", "physical", "alpha means nothing to the physical model"),
    ],
)
def test_what_cannot_move_alone_is_not_free(name, model, words):
    with pytest.raises(ParameterError, match=f"{name} cannot be free: {words}"):
        make_unknowns(lab_scene(), [name], model=model)


# In the course's mapping the first and the last column look along walls, where rounding decides.
SMALL = RenderSettings(size=(32, 24), mapping="center", max_bounces=2, path_limit=math.inf)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    ("model", "edges"),
    [
        ("classic", "point"),
        ("additive", "point"),
        pytest.param("classic", "aware", marks=pytest.mark.slow),
        pytest.param("additive", "aware", marks=pytest.mark.slow),
    ],
)
def test_a_scaled_scene_has_the_same_picture(model, edges):
    scene = load_scene(DATA / {"classic": "vitreous.txt", "additive": "checkpoints.txt"}[model], model=model)
    renderer = functools.partial(render, settings=dataclasses.replace(SMALL, model=model, edges=edges))
    expected = renderer(scene).image
    for factor in (1e-3, 1e3):
        image = renderer(scaled_scene(scene, factor, model)).image
        off = np.abs(np.asarray(image) - expected).max(axis=0)
        # Of a pixel that an edge passes to the last digit, rounding decides what it sees.
        assert np.mean(off > 1e-9) < 0.01, (factor, off.max())
