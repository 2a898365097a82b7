"""Blurred levels of a search: what they cannot tell of the film stays as it was."""

import numpy as np
import pytest
from linear_fit import linear_problem
from posing import posed_problem
from scipy import ndimage

from raytrace_jax import FitOptions, set_parameters
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.search import find_minima

SIZE = (48, 64)
TRUTH = 0.5
LEVELS = (*(Stage("point", blur, 2) for blur in (8.0, 4.0, 2.0)), Stage("point"))
TIES = {f"film.{name}.{channel}": f"film.{name}.r" for name in ("gain", "offset") for channel in "gb"}
FREE = ["a.center.x", "film.gain.r", "film.offset.r", "film.blur"]


def searched(seed, film):
    """Steps from a right place, of a board under a shade that the scene lacks; and the minimum's values."""
    random = np.random.default_rng([seed, 6])
    board = 0.6 * np.kron(random.integers(0, 2, (8, 11)), np.ones((6, 6)))[: SIZE[0], : SIZE[1]] + 0.1
    light = np.stack([board] * 3)
    change = ndimage.gaussian_filter(random.normal(size=light.shape), (0, 1.5, 1.5))
    change *= 0.2 / change.std()
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    shade = 1 + 0.4 * (column / SIZE[1] - 0.5) * random.normal() + 0.4 * (row / SIZE[0] - 0.5) * random.normal()
    target = 0.9 * ndimage.gaussian_filter(light + TRUTH * change, (0, 1, 1)) * shade + 0.02
    linear = linear_problem(np.stack([change, light]), target, start=[TRUTH, 1.0])
    scene = set_parameters(linear.scene, film)
    problem = posed_problem(scene, target, FREE, linear.base, edges="point", ties=TIES)
    progress = Progress(problem)
    (best,) = find_minima(problem, LEVELS, FitOptions(search=False, edges="point"), progress)
    return progress.findings.steps, best.summary.value


@pytest.mark.parametrize("gain", [0.9, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_an_incomplete_scene_keeps_the_film(seed, gain):
    steps, found = searched(seed, {"film.gain": (gain,) * 3, "film.blur": 0.7})
    blurred = np.array([step.value for step in steps if step.blur > 0])
    np.testing.assert_array_equal(blurred[:, 1:], np.tile(blurred[0, 1:], (len(blurred), 1)))
    assert abs(blurred[0, 1] - 0.9) < 0.2, "that of the sharp picture"
    assert np.max(np.abs(blurred[:, 0] - TRUTH)) < 0.5
    np.testing.assert_allclose(found, [TRUTH, 0.9, 0.02, 1.0], atol=0.1)


def test_a_film_blur_above_a_levels_is_free():
    steps, found = searched(0, {"film.gain": (0.9,) * 3, "film.blur": 5.0})
    assert np.ptp([step.value[3] for step in steps if step.blur == 2.0]) > 0.5
    assert found[3] == pytest.approx(1, abs=0.1)
