"""A scene in millimetres and one in kilometres: the same picture, the same derivative, the same fit."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import DATA

from raytrace_jax import RenderSettings, list_parameters, load_scene, make_renderer, picture_derivatives, set_parameters

# In the course's mapping the first and the last column look along walls, where rounding decides.
SMALL = RenderSettings(size=(32, 24), mapping="center", max_bounces=2, path_limit=math.inf)
LENGTHS = ("worlddim", "viewpoint", "location", "point", "center", "radius")
POWERS = {"classic": {"emissivity": 1, "ambient": 1}, "additive": {"energy": 2}}
"""What has to grow with a scene, and as which power of lengths, so that as much light arrives: light falls off with the
distance in the classic model, with its square in the additive one; the classic ambient light with the path."""


def scaled(scene, model, factor):
    powers = dict.fromkeys(LENGTHS, 1) | POWERS[model]
    return set_parameters(
        scene,
        {
            name: np.asarray(value) * factor ** powers.get(name.rpartition(".")[2], 0)
            for name, value in list_parameters(scene).items()
        },
    )


def scene_and_settings(model, edges):
    scene = load_scene(DATA / {"classic": "vitreous.txt", "additive": "checkpoints.txt"}[model], model=model)
    return scene, dataclasses.replace(SMALL, model=model, edges=edges)


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
    scene, settings = scene_and_settings(model, edges)
    renderer = make_renderer(scene, settings)
    expected = renderer(scene).image
    for factor in (1e-3, 1e3):
        image = renderer(scaled(scene, model, factor)).image
        off = np.abs(np.asarray(image) - expected).max(axis=0)
        # Of a pixel that an edge passes to the last digit, rounding decides what it sees.
        assert np.mean(off > 1e-9) < 0.01, (factor, off.max())


@pytest.mark.slow
def test_derivatives_scale_with_the_parameter():
    scene, settings = scene_and_settings("classic", "point")
    names = ("vitreous.ior", "vitreous.center.x", "vitreous.radius")
    found = picture_derivatives(scene, names, settings).values
    for factor in (1e-3, 1e3):
        other = picture_derivatives(scaled(scene, "classic", factor), names, settings).values
        units = jnp.asarray([1.0, factor, factor])[:, None, None, None]
        off = np.abs(np.asarray(other * units - found)).max(axis=(0, 1))
        assert np.mean(off > 1e-7 * np.abs(found).max()) < 0.01, factor
