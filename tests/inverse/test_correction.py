"""Some pixels of a picture, and the correction of edge-aware pictures by finely sampled ones."""

import dataclasses

import jax
import numpy as np
import pytest
from linear_fit import linear_problem
from posing import posed_problem
from scenes import assignment_scene, resolved

from raytrace_jax import render, set_parameters
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.sampling import resampled
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.refine import settle
from raytrace_jax.tracer import batches
from raytrace_jax.tracer.geometry.camera import picture_place
from raytrace_jax.tracer.pixels import pixel_colors

SMALL = resolved(size=(48, 36), max_bounces=2, crop=(5, 3, 30, 24))
AWARE = Stage("aware")


@pytest.fixture
def small_batches(monkeypatch):
    monkeypatch.setattr(batches, "QUEUE", {"point": 256, "aware": 256})
    monkeypatch.setattr(batches, "BATCHES", 2)


def window_pixels(image, count, seed=0):
    """Some of a window's pixels, by column and row in the window."""
    _, height, width = image.shape
    number = np.random.default_rng(seed).choice(height * width, count, replace=False)
    return np.stack([number % width, number // width])


def places(how, column, row):
    return np.stack(picture_place(assignment_scene().camera, how, column.astype(float), row.astype(float)))


def stacked(*scenes):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *scenes)


@pytest.mark.parametrize("count", [0, 1, 400])
def test_listed_points_match_the_pictures(count, small_batches):
    """Of more batches than there are slots, of which some stay empty."""
    scenes = [set_parameters(assignment_scene(), {"vitreous.ior": ior}) for ior in (1.337, 1.5, 1.2)]
    images = [np.asarray(render(scene, SMALL).image) for scene in scenes]
    column, row = window_pixels(images[0], count)
    found = pixel_colors(stacked(*scenes), places(SMALL, column + 5, row + 3), SMALL)
    assert found.shape == (3, 3, count) and found.dtype == images[0].dtype
    for one, image in zip(found, images, strict=True):
        np.testing.assert_allclose(one, image[:, row, column], atol=1e-12)


@pytest.mark.parametrize("binning", [1, 2])
def test_points_between_pixels_match_samples(binning, small_batches):
    scene, how = assignment_scene(), dataclasses.replace(SMALL, crop=None, binning=binning)
    image = np.asarray(render(scene, dataclasses.replace(how, samples=2)).image)
    row, column = np.divmod(np.arange(image[0].size), image.shape[2])
    offsets = 0.25 * np.array([[-1, -1, 1, 1], [-1, 1, -1, 1]])
    points = (np.stack([column, row])[:, None] + offsets[:, :, None]).reshape(2, -1)
    mean = pixel_colors(stacked(scene), places(how, *points), how).reshape(3, 4, -1).mean(axis=1)
    inside = (column > 0) & (column < image.shape[2] - 1)  # In the others rounding decides which wall is seen.
    np.testing.assert_allclose(mean[:, inside], image.reshape(3, -1)[:, inside], atol=1e-12)


@pytest.mark.slow
def test_the_edge_aware_bias_is_found():
    """With exposure, offset and a crop: the picture of lattices is the mean over 40 x 40 samples."""
    scene = assignment_scene()
    settings = SMALL
    mean = 0.5 * render(scene, dataclasses.replace(settings, samples=40)).image + 0.1
    problem = posed_problem(scene, mean, ["vitreous.ior"], settings, fit_exposure=True)
    y = problem.array(problem.unknowns.unknowns(np.array([1.337, 0.5, 0.1])))

    before = np.abs(np.asarray(problem.linearize(y, AWARE).image - problem.observation.target))
    after = np.abs(problem.observation.residual(np.asarray(resampled(problem, y, AWARE, 1597).at(y).image)))
    assert before.max() > 5e-3 and before.mean() > 1e-4
    assert after.max() < 2e-3 and after.mean() < 0.25 * before.mean()


def test_an_exact_picture_has_no_bias():
    columns = np.random.default_rng(0).normal(size=(2, 3, 12, 16))
    problem = linear_problem(columns, columns[0], start=np.array([0.99, 0.02]))
    problem, progress = dataclasses.replace(problem, samples=None), Progress(problem)
    found = settle(problem, FitState.at(problem, problem.start(), AWARE), progress, progress.of_level(0, 0))
    np.testing.assert_allclose(found.problem.observation.bias, 0, atol=1e-12)
    np.testing.assert_allclose(problem.values(found.y), [1, 0], atol=1e-12)
