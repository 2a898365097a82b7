"""How long the next step is in standard errors, and what a fit tells on its way until the clock or the user ends it."""

import jax.numpy as jnp
import numpy as np
import pytest
from linear_fit import linear_problem
from linear_pictures import POINT, state_at

from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.solvers import GaussNewton, minimise, step_in_errors

COLUMNS = np.random.default_rng(1).normal(size=(3, 3, 24, 32))


def move(columns, target):
    problem = linear_problem(columns, target)
    return step_in_errors(problem.linearize(problem.start(), POINT))


@pytest.mark.slow
def test_random_residuals_move_by_one_error():
    random = np.random.default_rng(2)
    sizes = np.where(random.uniform(size=COLUMNS.shape[1:]) < 0.01, 100.0, 0.01)
    for scale in (1.0, sizes):
        found = [move(COLUMNS, scale * random.normal(size=COLUMNS.shape[1:])) for _ in range(40)]
        assert 0.8 < np.sqrt(np.mean(np.square(found))) < 1.2


def test_only_a_common_pull_moves_far():
    noise = 0.01 * np.random.default_rng(3).normal(size=COLUMNS.shape[1:])
    assert move(COLUMNS, np.tensordot([0.1, 0, 0], COLUMNS, 1) + noise) > 10
    assert move(np.zeros_like(COLUMNS), noise) == 0


def test_equal_columns_stay_finite():
    same = np.stack([COLUMNS[0], COLUMNS[0], 2 * COLUMNS[0]])
    assert np.isfinite(move(same, np.random.default_rng(4).normal(size=COLUMNS.shape[1:])))


def to_and_fro(apart):
    """Steps on problems whose answers are in turns so far apart; and these answers."""
    truth = np.array([0.7, 0.6, 0.9])
    far = truth * (1 + apart)
    noise = 0.01 * np.random.default_rng(5).normal(size=COLUMNS.shape[1:])
    problems = [linear_problem(COLUMNS, np.tensordot(at, COLUMNS, 1) + noise, start=truth) for at in (far, truth)]
    seen = []

    def look(y):
        seen.append(y)
        return state_at(problems[len(seen) % 2], y)

    ended = minimise(GaussNewton(), state_at(problems[0]), look, Progress(problems[0]).of_level(0, 0))
    return ended, len(seen), truth, far


@pytest.mark.parametrize("apart", [np.finfo(float).eps, 1e-5])
def test_a_zigzag_ends_within_its_error(apart):
    ended, looks, truth, far = to_and_fro(apart)
    assert ended.settled and looks <= 4
    left = np.abs(ended.next_step)
    assert np.all(left <= 1.01 * np.abs(far - truth) + 0.01 * apart + 1e-3 * apart**0.5)


def test_a_far_answer_is_not_settled():
    ended, looks, _, _ = to_and_fro(2.0)
    assert not ended.settled and looks == 0 and ended.next_move > 10


def test_steps_are_counted_by_level():
    columns, steps, phases = np.random.default_rng(0).normal(size=(2, 3, 4, 4)), [], []
    progress = Progress(linear_problem(columns, columns[0]), steps.append, phases.append)
    progress.phase("solving")
    for candidate, level in [(0, 1), (0, 1), (0, 0), (1, 1)]:
        progress.of_level(candidate, level, 2.0, leads=candidate == 0)(1.0, True, jnp.asarray([candidate, 1 / 3]))
    np.testing.assert_array_equal(progress.findings.answer, [0, 1 / 3])
    assert [(step.step, step.blur) for step in steps] == [(0, 2.0), (1, 2.0), (0, 2.0), (0, 2.0)]
    assert phases == ["solving"] and tuple(steps) == progress.findings.steps
