"""The plain tracer of the physical model against pictures by other programs, and against laws of optics."""

from pathlib import Path

import numpy as np
import pictured_scenes
import pytest
from numpy_physical import channel_iors, look, picture
from physical_scenes import Camera, Material, Plane, Rectangle, Scene, Sphere

from raytrace_jax import read_picture

PICTURES = Path(__file__).parents[1] / "physical_pictures"
EYE = Camera((9, 9), (0, 0, 5), (0, 0, 0), (0, 1, 0), 20)


def glass(ior, **more):
    return Material(transmission=1, ior=ior, **more)


@pytest.mark.parametrize("name", ["lights", "dispersion"])
def test_is_what_pov_ray_renders(name):
    ours, theirs = picture(getattr(pictured_scenes, name)()), read_picture(PICTURES / f"pov_{name}.exr")
    # POV-Ray writes 16 bits: 7.6e-6 is half a step.
    assert np.quantile(abs(ours - theirs), 0.999) < 1e-5


@pytest.mark.parametrize("name", ["sky", "nested", "absorption"])
def test_is_what_mitsuba_renders(name):
    """Means over blocks of 8 x 8 pixels, in which Mitsuba's noise is small."""
    ours, theirs = picture(getattr(pictured_scenes, name)(), 2), read_picture(PICTURES / f"mitsuba_{name}.exr")
    blocks = (ours - theirs).reshape(3, 9, 8, 12, 8).mean(axis=(2, 4))
    assert np.sqrt(np.mean(blocks**2)) < BLOCKS[name]
    assert abs(blocks).max() < 6 * BLOCKS[name]


BLOCKS = {"sky": 1e-3, "nested": 3e-3, "absorption": 2e-3}


def test_beer_and_lambert_absorb_a_chord():
    """Tinted air: through the centre the chord is a diameter, and within the ball half a chord and half another."""
    tint, r = np.array([0.3, 0.7, 1.1]), 0.8
    outer = Sphere(Material(transmission=1, ior=1, absorption=tuple(tint)), (0, 0, 0), r)
    wall = Rectangle(Material(emission=(1, 1, 1)), (0, 0, -3), (2, 0, 0), (0, 2, 0))
    np.testing.assert_allclose(look(Scene(EYE, [wall, outer]), 4, 4), np.exp(-tint * 2 * r), rtol=1e-12)
    bubble = Sphere(glass(1.0), (0, 0, 0), 0.5)
    np.testing.assert_allclose(look(Scene(EYE, [outer, wall, bubble]), 4, 4), np.exp(-tint * 0.6), rtol=1e-12)
    # A matt ball within ends the way through the tint: here the middle of the outer one's front half.
    lamp = Sphere(Material(emission=(1, 1, 1)), (0, 0, 0), 0.5)
    np.testing.assert_allclose(look(Scene(EYE, [outer, wall, lamp]), 4, 4), np.exp(-tint * 0.3), rtol=1e-12)


def test_the_smaller_overlapping_ball_wins():
    """Straight through both along their axis: the smaller one's tint counts where they overlap, in either order."""
    large = Sphere(Material(transmission=1, ior=1, absorption=(1, 0, 0)), (0, 0, 0), 1)
    small = Sphere(Material(transmission=1, ior=1, absorption=(0, 1, 0)), (0, 0, 1), 0.5)
    wall = Rectangle(Material(emission=(1, 1, 1)), (0, 0, -3), (2, 0, 0), (0, 2, 0))
    for shapes in ([wall, large, small], [small, wall, large]):
        np.testing.assert_allclose(look(Scene(EYE, shapes), 4, 4), np.exp([-1.5, -1, 0]), rtol=1e-12)


def test_a_glass_half_space_reflects():
    surface = Plane(glass(1.5, absorption=(0, 0, 2)), (0, 0, 0), (0, 0, 1))
    wall = Rectangle(Material(emission=(1, 1, 1)), (0, 0, -1), (2, 0, 0), (0, 2, 0))
    seen = look(Scene(EYE, [surface, wall]), 4, 4)
    np.testing.assert_allclose(seen, 0.96 * np.exp([0, 0, -2]), rtol=1e-12)


def test_catalogue_indices_lie_on_the_curve():
    """Schott's N-BK7 by two numbers; 1.5187 is the catalogue's at the mercury line of 546.07 nm."""
    red, green, blue = channel_iors(Material(ior=1.5168, abbe=64.17))
    assert 1.51432 < red < 1.5168 < 1.5184 < green < 1.51872 < 1.52238 < blue < 1.5245
