"""A fit looks at a window of the picture with pixels of many sizes: all of them lie where the target's own do."""

import dataclasses

import numpy as np
import pytest
from posing import posed_problem
from scenes import assignment_scene

from raytrace_jax import RenderSettings, parse_scene
from raytrace_jax.images.filters import bin_pixels
from raytrace_jax.scene.response import apply_response
from raytrace_jax.scene.setting_words import PixelConvention

WHOLE = RenderSettings(size=(60, 42), max_bounces=1)
CROP = (13, 7, 24, 20)
CAMERA = "camera eye { pixeldim 60 42 worlddim 8 6 viewpoint 4 3 6 }"


def posed(settings, free=("vitreous.ior",)):
    width, height = settings.crop[2:] if settings.crop else (side // settings.binning for side in settings.size)
    target = np.random.default_rng(0).uniform(size=(3, height, width))
    return posed_problem(assignment_scene(), target, list(free), settings)


@pytest.mark.parametrize("binning", [1, 2, 3, 5])
@pytest.mark.parametrize("base_binning", [1, 2])
@pytest.mark.parametrize("mapping", ["corner", "center"])
@pytest.mark.parametrize("crop", [None, CROP])
def test_a_binned_pixel_is_centred(binning: int, base_binning: int, mapping: PixelConvention, crop):
    window = None if crop is None else tuple(number // base_binning for number in crop)
    problem = posed(dataclasses.replace(WHOLE, binning=base_binning, mapping=mapping, crop=window))
    own, large = problem.pixels(), problem.pixels(binning)
    of_target = own.points.reshape(2, *problem.binned(1).target.shape[1:])
    np.testing.assert_allclose(large.points.reshape(2, -1), bin_pixels(of_target, binning).reshape(2, -1), atol=1e-12)
    np.testing.assert_allclose(large.step, binning * own.step)


@pytest.mark.slow
def test_shades_and_binning_commute():
    problem = posed(dataclasses.replace(WHOLE, crop=CROP))
    light = np.ones((3, 20, 24))
    film = parse_scene(f"film f {{ light 0.2 0.1 0.1 0.1 -0.1 vignetting 0.4 }} {CAMERA}").film
    own = np.asarray(apply_response(light, film, problem.frame()))
    large = np.asarray(apply_response(bin_pixels(light, 4), film, problem.frame(4)))
    np.testing.assert_allclose(large, bin_pixels(own, 4), atol=1e-3)
