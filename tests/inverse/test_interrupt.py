"""A fit that is stopped: it traces nothing more, has what was computed, and says of the rest that it is unknown."""

import json
import signal
import threading
import time

import numpy as np
import pytest
from linear_fit import PROGRAMS, linear_names, linear_problem
from scipy import ndimage

from raytrace_jax import FitOptions, fit
from raytrace_jax.report.fit_report.folder import TEXTS
from raytrace_jax.util.background import Clock

SIZE = (30, 40)
TRUTH = np.array([0.3, -0.2])


@pytest.fixture
def calls(monkeypatch):
    """A list that grows with each picture, of a scene whose pictures are linear in two numbers."""
    made = []

    def counted(function):
        def call(*arguments, **options):
            made.append(function)
            return function(*arguments, **options)

        return call

    for name, function in PROGRAMS.items():
        monkeypatch.setitem(PROGRAMS, name, counted(function))
    return made


def stopped_fit(calls, phase=lambda words: False, step=lambda step: False, **options):
    """A fit that is interrupted when a phase or a step says so, and how many pictures there were then."""
    columns = ndimage.gaussian_filter(np.random.default_rng([0, 3]).normal(size=(2, 3, *SIZE)), (0, 0, 3, 3))
    columns /= columns.std(axis=(1, 2, 3), keepdims=True)
    noise = 0.02 * np.random.default_rng(1).normal(size=(3, *SIZE))
    problem = linear_problem(columns, np.tensordot(TRUTH, columns, 1) + noise)
    calls.clear()
    seen = []

    def stop(wanted, what):
        if not seen and wanted(what):
            seen.append(len(calls))
            raise KeyboardInterrupt

    result = fit(
        problem.scene,
        problem.observation.target,
        linear_names(2),
        problem.base,
        options=FitOptions(edges="point", target_sampling="point", **options),
        on_phase=lambda words: stop(phase, words),
        on_step=lambda done: stop(step, done),
    )
    return result, seen


PHASES = ["scanning: compiling", "scanning, ", "solving from start 1", "solving from start 2"]


@pytest.mark.parametrize("begin", PHASES)
def test_stopped_early_it_has_only_values(begin, calls, tmp_path):
    result, seen = stopped_fit(calls, phase=lambda words: words.startswith(begin))
    assert seen == [len(calls)]
    assert result.status == "interrupted" and ("without error bars" in result.message or not result.steps)
    assert np.all(np.isfinite(result.value))
    sure = result.uncertainty
    for unknown in (sure.standard_error, sure.cramer_rao, sure.correlation, sure.sigma, result.rms_residual):
        assert np.all(np.isnan(unknown))
    assert result.image is None and result.start_image is None
    assert np.isnan(result.parameters["a.center.x"].error)


def test_stopped_in_a_level_it_has_its_step(calls):
    result, seen = stopped_fit(calls, step=lambda step: step.level == 3)
    assert seen == [len(calls)]
    np.testing.assert_array_equal(result.value, result.steps[-1].value)
    assert result.image is None


def test_stopped_late_it_keeps_the_solution(calls):
    result, seen = stopped_fit(calls, phase=lambda words: words.startswith("profile"), profiles=["a.center.x"])
    assert seen == [len(calls)]
    assert result.status == "interrupted" and "came to rest, but the model was not checked" in result.message
    np.testing.assert_allclose(result.value, TRUTH, atol=5e-3)
    assert np.all(result.standard_error > 0) and np.all(np.isfinite(result.uncertainty.correlation))
    np.testing.assert_allclose(result.image, result.target, atol=0.1)
    assert result.start_image.shape == result.image.shape and result.profiles == ()


@pytest.mark.parametrize("by_clock", [True, False])
def test_stopped_in_the_check_it_says_so(by_clock, calls, monkeypatch):
    """The time ends, or Ctrl-C comes, while the check renders; it renders nothing more."""
    checking, rendered, points, stop = [], [], PROGRAMS["points"], Clock.check

    def end(clock):
        if rendered and not clock.is_stopped:
            raise TimeoutError if by_clock else KeyboardInterrupt
        stop(clock)

    def phase(words):
        checking.extend([words] if words == "checking the model" else [])
        return False

    def watched(scenes, *arguments):
        rendered.extend(checking)
        return points(scenes, *arguments)

    monkeypatch.setattr(Clock, "check", end)
    monkeypatch.setitem(PROGRAMS, "points", watched)
    result, _ = stopped_fit(calls, phase=phase, max_seconds=100.0)
    assert len(rendered) == 1, "and nothing after it"
    reason = "stopped after 100 seconds" if by_clock else "interrupted by the user"
    assert result.status == "interrupted"
    assert result.message.startswith(f"{reason}; the solver came to rest, but the model was not checked")
    np.testing.assert_allclose(result.value, TRUTH, atol=5e-3)
    assert np.all(result.standard_error > 0) and not result.check.causes


@pytest.fixture
def ctrl_c():
    """Ctrl-C is what Python makes of it, whatever a test before has left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("by_clock", [True, False])
def test_uninterruptible_work_is_left_behind(by_clock, calls, monkeypatch):
    """As a compilation: it ends when it ends, and nothing comes after it."""
    go_on, phases, threads = threading.Event(), [], set(threading.enumerate())

    def press_until_heard():
        # As people do: an interrupt that comes in a callback of the garbage collector is lost.
        while not go_on.wait(0.5) and "stopping ..." not in phases:
            signal.raise_signal(signal.SIGINT)

    def compile_long(*arguments):
        if not by_clock:
            threading.Thread(target=press_until_heard).start()
        go_on.wait(20)
        raise AssertionError("nobody is left to see this")

    monkeypatch.setitem(PROGRAMS, "points", compile_long)
    began = time.monotonic()
    try:
        result, _ = stopped_fit(calls, phase=phases.append, max_seconds=0.3 if by_clock else None)
    finally:  # Whatever happens, nobody presses on into the tests that follow.
        go_on.set()
    assert time.monotonic() - began < 10
    *before, last = phases
    # The clock may end the comparison.
    both = ["comparing what nothing free changes", "scanning: compiling"]
    assert last == "stopping ..." and before in ([both, both[:1]] if by_clock else [both])
    reason = "stopped after 0.3 seconds" if by_clock else "interrupted by the user"
    assert result.status == "interrupted" and result.message == f"{reason}, before the first step: nothing was fitted"
    assert np.all(np.isnan(result.standard_error)) and not result.steps
    for thread in set(threading.enumerate()) - threads:
        thread.join(10)


def test_unknown_numbers_are_null_in_json(calls, tmp_path):
    result, _ = stopped_fit(calls, phase=lambda words: words.startswith("solving from"), sigma=0.02)
    for name in ("fit.exr", "residual.exr"):
        (tmp_path / name).write_bytes(b"of an earlier fit")
    result.save(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"fit.txt", "report.png", "report.html", "result.json", "result.npz", *TEXTS}
    numbers = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert numbers["rms_residual"] is None and numbers["sigma"] == 0.02
    assert numbers["parameters"]["a.center.x"]["standard_error"] is None
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<img") == 1 + 3 and "unknown" in page
