"""Whole pictures: against another program's, and what size, crop, samples and output variables do to them."""

import dataclasses
import threading

import jax.numpy as jnp
import numpy as np
import pytest
from compiles import counted_compiles
from numpy_tracer import NumpyTracer
from scenes import DATA, assignment_scene, resolved, rows_last

from raytrace_jax import parse_scene, read_picture, render, set_parameters, write_exr

SIZE = (48, 36)
SMALL = resolved(size=SIZE, max_bounces=2, edges="point")
MOVED = {"vitreous.center": [4.15, 2.45, -1.25], "vitreous.ior": 1.45}


def inside(image):
    """Without the first and the last column, where both walls meet the image plane and rounding decides."""
    return image[:, 1:-1]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("dtype", "threshold", "most"), [(jnp.float64, 1e-6, 20), (jnp.float32, 1 / 255, 50)])
@pytest.mark.parametrize(
    ("name", "reflectance", "changes"), [("course_alpha", "none", {}), ("course_schlick_moved", "schlick", MOVED)]
)
def test_it_is_another_programs_picture(name, reflectance, changes, dtype, threshold, most, tmp_path):
    scene = set_parameters(assignment_scene(dtype), changes)
    film = render(scene, resolved(reflectance=reflectance))
    assert film.image.dtype == dtype and not film.overflow
    error = np.asarray(film.image, np.float64) - read_picture(DATA / f"{name}.exr")
    error[..., [0, -1]] = 0  # there both walls meet z = 0 exactly, and rounding decides
    count = np.sum(np.abs(error).max(0) > threshold)
    print(f"{name}, {dtype.__name__}: {count} pixels differ by more than {threshold:.3g}")
    if count > most:
        write_exr(tmp_path / "error.exr", dict(zip("RGB", error, strict=True)))
        pytest.fail(f"{count} pixels differ by up to {np.abs(error).max():.3g}; see {tmp_path / 'error.exr'}")


def picture(scene, settings=SMALL):
    return rows_last(render(scene, settings).image)


def test_a_crop_is_a_window_of_the_picture():
    whole = picture(assignment_scene())
    x, y, width, height = 11, 5, 30, 17
    window = picture(assignment_scene(), dataclasses.replace(SMALL, crop=(x, y, width, height)))
    assert window.shape == (height, width, 3)
    np.testing.assert_allclose(window, whole[y : y + height, x : x + width], atol=1e-12)


@pytest.mark.slow
def test_center_looks_at_pixel_middles():
    """`center` at w x h is `corner` at (2 w + 1) x (2 h + 1), every second pixel."""
    scene = assignment_scene()
    corner = picture(scene, dataclasses.replace(SMALL, size=(2 * SIZE[0] + 1, 2 * SIZE[1] + 1)))
    center = picture(scene, dataclasses.replace(SMALL, mapping="center"))
    np.testing.assert_allclose(center, corner[1::2, 1::2], atol=1e-12)


@pytest.mark.slow
def test_output_variables():
    scene = assignment_scene()
    names = ("depth", "normal", "position", "shape_index", "bounce_count")
    film = render(scene, dataclasses.replace(SMALL, aov=names))
    np.testing.assert_allclose(inside(rows_last(film.image)), inside(picture(scene)), atol=1e-12)
    depth, normal, position, shape, bounces = (np.asarray(film.aov[name]) for name in names)
    hit = shape >= 0
    hit[:, [0, -1]] = False  # there both walls meet z = 0 exactly, and rounding decides

    # What NumPy sees along the same rays.
    reference = NumpyTracer(scene, SMALL)
    viewpoint = np.asarray(scene.camera.viewpoint)
    to_point = np.moveaxis(position, 0, -1) - viewpoint
    np.testing.assert_allclose(np.linalg.norm(to_point, axis=-1)[hit], depth[hit], rtol=1e-12)
    directions = to_point[hit] / depth[hit][:, None]
    t, nearest = reference.nearest_hit(np.broadcast_to(viewpoint, directions.shape), directions)
    np.testing.assert_allclose(depth[hit], t, atol=1e-9)
    np.testing.assert_array_equal(shape[hit], nearest)
    np.testing.assert_allclose(np.sum(normal**2, axis=0)[hit], 1, atol=1e-12)

    # Known pixels: the glass ball in the middle, the floor below, the walls left and right; nothing in between.
    index = scene.shape_order.index
    known = {(18, 26): "vitreous", (35, 24): "floor", (18, 2): "leftwall", (18, 45): "rightwall"}
    for (row, column), name in known.items():
        assert shape[row, column] == index(name)
    missed = shape < 0
    assert missed.any()
    for values in (depth, *normal, *position, bounces, *np.asarray(film.image)):
        np.testing.assert_array_equal(values[missed], 0)
    assert bounces.max() == SMALL.max_bounces
    np.testing.assert_array_equal(bounces[shape == index("floor")], 0)  # matt: it sends no rays on


def test_moved_parameters_compile_nothing():
    scene = assignment_scene()
    moved = set_parameters(scene, MOVED | {"topright.location": [5.5, 4.2, 0.9], "cam1.viewpoint": [4.1, 3, 6]})
    with counted_compiles(thread=threading.current_thread()) as compiles:
        render(scene, dataclasses.replace(SMALL, path_limit=77.0))
        assert compiles  # The listener hears: no other test has these settings.
        compiles.clear()
        for size, crop in (((43, 31), None), ((200, 150), (3, 5, 190, 140))):
            render(moved, dataclasses.replace(SMALL, path_limit=77.0, size=size, crop=crop, mapping="center"))
        assert not compiles


def test_an_empty_scene_is_black():
    scene = parse_scene("camera eye { pixeldim 12 9 worlddim 8 6 viewpoint 4 3 6 }")
    film = render(scene, resolved(aov=("depth", "shape_index")))
    assert film.image.shape == (3, 9, 12) and not np.any(film.image)
    assert np.all(np.asarray(film.aov["shape_index"]) == -1) and not np.any(film.aov["depth"])
