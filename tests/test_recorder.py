"""What a fit tells on its way: steps and phases, until the clock or the user ends it."""

import types

import jax.numpy as jnp
import numpy as np
import pytest
from linear_fit import linear_problem

from raytrace_jax.inverse.steps import Recorder


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still unless it is told otherwise."""
    now = types.SimpleNamespace(time=1000.0)
    monkeypatch.setattr("raytrace_jax.inverse.steps.time", types.SimpleNamespace(monotonic=lambda: now.time))
    return now


def recorder(on_step=None, on_phase=None, max_seconds=None):
    columns = np.random.default_rng(0).normal(size=(2, 3, 4, 4))
    return Recorder(linear_problem(columns, columns[0]), on_step, on_phase, max_seconds)


def test_what_the_clock_ends_keeps_its_steps_and_the_answer_so_far(clock):
    one = recorder(max_seconds=5.0)
    record = one.level(0, 1, 0.5)
    clock.time += 3.5
    record(0, 4.0, True, jnp.asarray([0.1, 1 / 3]))
    clock.time += 3.5
    with pytest.raises(TimeoutError):
        record(1, 1.0, False, jnp.asarray([1e-300, -2.5]))
    with pytest.raises(TimeoutError):
        one.phase("solving")
    assert [step.seconds for step in one.history] == [3.5, 7] and one.seconds == 7
    np.testing.assert_array_equal(one.findings.answer, [1e-300, -2.5])


def test_further_steps_of_a_level_go_on_behind_its_own_and_those_of_others_begin(clock):
    one = recorder()
    for candidate, level in [(0, 1), (0, 1), (0, 0), (1, 1)]:
        one.level(candidate, level)(0, 1.0, True, jnp.asarray([0.1, 1 / 3]))
    assert [step.step for step in one.history] == [0, 1, 0, 0]


def test_what_was_asked_to_stop_tells_nothing_more_and_keeps_its_step(clock):
    steps, phases = [], []
    one = recorder(steps.append, phases.append)
    one.stop()
    for end in (lambda: one.phase("solving"), lambda: one.level(0, 0, 2.0)(0, 1.0, True, jnp.asarray([1.0, 2.0]))):
        with pytest.raises(TimeoutError):
            end()
    assert not steps and phases == ["stopping ..."]
    np.testing.assert_array_equal(one.findings.answer, [1, 2])


def test_a_step_that_does_not_lead_is_told_but_is_not_the_answer(clock):
    steps, phases = [], []
    one = recorder(steps.append, phases.append)
    one.phase("solving")
    one.level(0, 0, 2.0)(0, 1.0, True, jnp.asarray([1.0, 2.0]))
    one.level(1, 0, 2.0, leads=False)(1, 0.5, True, jnp.asarray([3.0, 4.0]))
    np.testing.assert_array_equal(one.findings.answer, [1, 2])
    assert [(step.candidate, step.step, step.blur) for step in steps] == [(0, 0, 2.0), (1, 1, 2.0)]
    assert phases == ["solving"]
