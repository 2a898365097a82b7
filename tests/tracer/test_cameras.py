"""Cameras: the rays of pixels, their derivatives, and the pictures of the perspective camera."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import camera_rays, resolved

from raytrace_jax import FitOptions, RenderSettings, fit, parse_scene, picture_derivatives, render
from raytrace_jax.report.differences import correlation, finite_differences, relative_error

rays_of = jax.jit(camera_rays, static_argnames="settings")
WORLD = (
    "material wall { ambient 3 2 4 } material ball { ambient 5 6 3 } "
    "plane back { material wall normal 0 0 1 point 0 0 -4 } sphere ball { material ball center 0.2 0.1 -1 radius 1 }"
)


def perspective(viewpoint="0 0 5", lookat="0 0 0", up="0 1 0", fov=40, pixeldim="24 18"):
    return f"camera eye {{ pixeldim {pixeldim} viewpoint {viewpoint} lookat {lookat} up {up} fov {fov} }} "


def test_footprints_are_ray_differences():
    scene = parse_scene(perspective("1 2 6", "0.5 0 0", "0.2 1 0"))
    looks = resolved(mapping="center", edges="aware")
    column, row = jnp.asarray([3.0, 20.0]), jnp.asarray([5.0, 11.0])
    rays = rays_of(scene.camera, looks, column, row)
    step = 1e-5
    for k, (across, down) in enumerate(((step, 0), (0, step))):
        ahead = rays_of(scene.camera, looks, column + across, row + down).d
        behind = rays_of(scene.camera, looks, column - across, row - down).d
        np.testing.assert_allclose(rays.footprint.d[k], (ahead - behind) / (2 * step), atol=1e-9)
        np.testing.assert_array_equal(rays.footprint.o[k], 0)


@pytest.mark.slow
def test_camera_derivatives_are_differences():
    scene = parse_scene(perspective("0.5 0.3 5", "0.1 0 0", fov=35) + WORLD)
    steps = {"eye.fov": 0.5, "eye.lookat.x": 0.02, "eye.viewpoint.y": 0.03, "eye.center.x": 0.2}
    steps["eye.distortion.k1"] = 0.1
    names, aware = tuple(steps), resolved(edges="aware", max_bounces=0)
    found = picture_derivatives(scene, names, aware)
    for k, (name, step) in enumerate(steps.items()):
        (difference,) = finite_differences(scene, [name], aware, step=step, samples=32)
        assert correlation(found.values[k], difference) > 0.95, name
        assert relative_error(found.values[k], difference) < 0.35, name


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["worlddim 8 6 viewpoint 4 3 8", "viewpoint 0 0 5 lookat 0 0 0 fov 40"])
def test_a_subpixel_shift_moves_the_center(camera):
    """It is cut from a picture of eight times as many pixels, at whole ones of these."""
    middle = "4 3 -2" if "worlddim" in camera else "0.2 0.1 -1"
    scene = parse_scene(f"camera eye {{ pixeldim 24 18 {camera} }} " + WORLD.replace("0.2 0.1 -1", middle))
    fine = np.asarray(render(scene, RenderSettings(size=(192, 144), mapping="center")).image)
    right, down, by = 3, -2, 8
    moved = np.roll(fine, (down, right), (1, 2)).reshape(3, 18, by, 24, by).mean((2, 4))
    inside = np.pad(np.ones((16, 22)), 1)
    found = fit(
        scene, moved, ["eye.center"], RenderSettings(mapping="center"), weights=inside, options=FitOptions(search=False)
    )
    np.testing.assert_allclose(found.value, [11.5 + right / by, 8.5 + down / by], atol=0.02)


@pytest.mark.parametrize("size", [(24, 18), (12, 9), (6, 9)])
def test_another_size_shows_the_same_view(size):
    """As the course's camera does; so that a preview has the borders of the picture."""
    camera = parse_scene(perspective()).camera
    looks = resolved(size=size)
    corners = rays_of(camera, looks, jnp.asarray([0.0, size[0] - 1]), jnp.asarray([0.0, size[1] - 1]))
    whole = rays_of(camera, resolved(), jnp.asarray([0.0, 23]), jnp.asarray([0.0, 17]))
    np.testing.assert_allclose(corners.d, whole.d, atol=1e-15)
