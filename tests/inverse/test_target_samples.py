"""Of how many samples a target's pixels are the mean: told from the target, used for its correction, and as noise."""

import dataclasses

import numpy as np
import pytest
from linear_pictures import state_at
from posing import posed_problem
from scenes import assignment_scene

from raytrace_jax import FitOptions, RenderSettings, fit
from raytrace_jax.inverse.judge.structure import block_scatter
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.detect import detect_samples
from raytrace_jax.inverse.problem.sampling import LATTICES, lattice_offsets, point_sampled, resampled
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.refine import settle
from raytrace_jax.inverse.status import shows_noise
from raytrace_jax.scene.scene import map_scenes
from raytrace_jax.tracer.pixels import pixel_colors, sample_offsets
from raytrace_jax.tracer.settings import ResolvedSettings

SMALL = ResolvedSettings(size=(48, 36), max_bounces=2)
AWARE = Stage("aware")


def posed(target):
    """The assignment's scene before a target, all at the truth."""
    return posed_problem(assignment_scene(), target, ["vitreous.ior"], SMALL)


@pytest.fixture(scope="module")
def problem():
    return posed(np.random.default_rng(0).uniform(size=(3, 36, 48)))


def told(problem, target, off=0.0):
    """The samples that are told of a target, at an index that is a little off."""
    one, y = posed(target), problem.start() + off
    return detect_samples(state_at(one, y, AWARE), point_sampled(one, y, 2)[1])


def settled(problem, begun, **options):
    """The end of the steps on the target's own samples."""
    progress = Progress(problem)
    return settle(problem, begun, progress, progress.of_level(0, 0), **options)


def jittered(problem, count):
    """Means of random samples, others in every pixel."""
    random = np.random.default_rng(3)
    column, row = problem.places()
    scene, total = map_scenes(lambda x: np.asarray(x)[None], problem.scene_at(problem.start())), 0.0
    for _ in range(count):
        right, down = random.uniform(-0.5, 0.5, (2, len(column)))
        places = problem.points(column + right, row + down)
        total = total + pixel_colors(scene, places, SMALL)[0]
    return (total / count).reshape(3, 36, 48)


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "noise", "off"), [(2, 0, 0), (5, 0, 3e-4), (8, 0, 0), (5, 1 / 255, 0), (13, 0, 0)])
def test_a_regular_grid_is_told(problem, samples, noise, off):
    target = point_sampled(problem, problem.start(), samples)[0]
    target = target + noise * np.random.default_rng(1).normal(size=target.shape)
    assert told(problem, target, off) == samples


@pytest.mark.parametrize("noise", [0, 1e-4])
def test_an_edge_aware_target_is_told(problem, noise):
    target = np.asarray(problem.picture(problem.start(), "aware").image)
    assert told(problem, target + noise * np.random.default_rng(1).normal(size=target.shape), 3e-4) == "aware"


@pytest.mark.slow
def test_box_and_random_means_are_no_grid(problem):
    assert told(problem, point_sampled(problem, problem.start(), 48)[0]) is None
    assert told(problem, jittered(problem, 25)) is None


@pytest.mark.slow
@pytest.mark.parametrize("samples", [3, 8])
def test_steps_on_the_target_grid_end(problem, samples):
    target = point_sampled(problem, problem.start(), samples)[0]
    one, y = posed(target), problem.start() + 3e-4
    begun = state_at(one, y, AWARE)
    found = settled(dataclasses.replace(one, samples=samples), begun)
    left = found.confusion[0, 0] + found.next_step[0] ** 2
    spread = float(np.sqrt(left))
    assert found.settled and found.problem.samples == samples
    assert abs(float(found.y[0] - problem.start()[0])) < 0.6 * spread < 0.01 / samples**2
    assert np.mean(np.abs(found.residual) > 1e-4) < 2e-3  # A sample or two that are on the other side of an edge.


def test_digits_below_the_noise_are_not_computed(problem):
    """Beside noise fewer pixels are sampled, with fewer samples, and a step that is short beside the error is none."""
    y, sigma = problem.start(), 0.03
    target = point_sampled(problem, y, 8)[0]
    one = posed(target + sigma * np.random.default_rng(2).normal(size=target.shape))
    noise = sigma * float(np.max(one.observation.root_weight))
    plain, less = (resampled(one, y, AWARE, 89, noise=size) for size in (0.0, noise))
    assert len(less.row) < len(plain.row)
    left_out = np.abs(np.asarray(less.at(y).image) - np.asarray(plain.at(y).image))
    assert 0 < left_out.max() < 3 * sigma and np.sqrt(np.mean(left_out**2)) < 0.1 * sigma
    # Of one whose error is said to be large the coarsest lattice is fine enough, and the start is the end.
    exact = posed(target)
    picture = resampled(exact, y, AWARE, 89)
    state = picture.state(y, AWARE)
    assert picture.needed_size(state, np.array([1.0])) == LATTICES[0] < picture.needed_size(state)
    assert picture.needed_size(state, np.array([0.0])) == picture.needed_size(state)
    begun = state_at(exact, y + 3e-4, AWARE)
    assert settled(exact, begun, error=np.array([1.0])).y == begun.y
    assert settled(exact, begun, error=np.array([1e-6])).y != begun.y


@pytest.mark.parametrize("size", LATTICES)
def test_a_lattice_knows_the_area_of_an_edge(size):
    """Of a half plane through the pixel, in any direction and nearly along its rows."""
    random, places = np.random.default_rng(0), lattice_offsets(size)
    assert places.shape == (size, 2) and np.all(np.abs(places) < 0.5)
    np.testing.assert_allclose(places.mean(axis=0), 0, atol=0.5 / size)
    fine = sample_offsets(300)
    for angle, most in ((random.uniform(0, 2 * np.pi, 200), 0.35), (random.normal(0, 0.03, 200), 0.25)):
        normal, middle = np.stack([np.cos(angle), np.sin(angle)]), random.uniform(-0.5, 0.5, 200)
        off = np.mean(places @ normal < middle, axis=0) - np.mean(fine @ normal < middle, axis=0)
        assert np.sqrt(np.mean(off**2)) < most / size**0.75


def test_block_scatter_is_that_of_estimates():
    """White noise as ever, and structure over blocks of 16 pixels, which is four times as bad as it seems."""
    random = np.random.default_rng(5)
    columns = np.repeat(np.repeat(random.normal(size=(2, 3, 16, 16)), 8, axis=2), 8, axis=3)
    weight = np.ones(columns.shape[1:])
    flat = columns.reshape(2, -1)

    def ratio(make):
        estimates, predicted = [], []
        for _ in range(60):
            residual = make().reshape(-1)
            estimate = np.linalg.lstsq(flat.T, residual, rcond=None)[0]
            left = (residual - estimate @ flat).reshape(weight.shape)
            estimates.append(estimate)
            predicted.append(np.diagonal(block_scatter([(columns, weight, left)])))
        return np.sqrt(np.mean(predicted, axis=0)) / np.std(estimates, axis=0)

    def structure():
        return np.repeat(np.repeat(random.normal(size=(3, 8, 8)), 16, axis=1), 16, axis=2)

    for make in (lambda: random.normal(size=weight.shape), structure):
        found = ratio(make)
        assert np.all(found > 0.75) and np.all(found < 1.7)


def test_unknown_samples_obscure_noise_at_edges(problem):
    """Where pixels vary inside, four samples may err by more than a tenth of the noise."""
    variance = np.zeros((3, 36, 48))
    variance[1, 2, 3], variance[0, 4, 5] = 0.05 * 0.01**2, 0.03 * 0.01**2
    state = state_at(problem, stage=AWARE)
    seen = shows_noise(dataclasses.replace(state, within=variance), 0.01)
    assert seen.shape == variance.shape and np.argwhere(~seen).tolist() == [[1, 2, 3]]
    assert shows_noise(state, 0.01).all()


@pytest.mark.slow
def test_random_samples_are_no_wrong_model(problem):
    """Means of 16 random samples, other ones in each pixel, with noise that was stated: only edges show the samples."""
    target = jittered(problem, 16) + np.random.default_rng(1).normal(scale=0.004, size=(3, 36, 48))
    settings = RenderSettings(size=(48, 36), max_bounces=2)
    result = fit(assignment_scene(), target, ["vitreous.ior"], settings, options=FitOptions(sigma=0.004, search=False))
    estimate, chi_square = result["vitreous.ior"], result.uncertainty.reduced_chi_square
    assert result.status == "converged" and result.target_samples is None and chi_square > 1.1
    assert abs(estimate.value - 1.337) < 3 * estimate.error
