"""The stages of a fit that are done: kept to the bit, whole or not at all, and only for the fit that they are of."""

import contextlib
import errno
import json
import os
import types
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_fit import linear_problem

from raytrace_jax import RaytraceError
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.journal import FileJournal, identity

OWNER = {"scene": "1a", "--free": "2b", "version": "1.0"}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "result" / "progress.json"


def kept(path, stages, owner=OWNER):
    """Write a journal with these stages."""
    journal = FileJournal(path, owner, resume="never")
    for name, stage in stages.items():
        journal[name] = stage
    return journal


def resumed(path, owner=OWNER):
    return FileJournal(path, owner, resume="always")


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@given(stages=st.dictionaries(st.text(), values, max_size=4))
def test_every_stage_is_read_back_as_it_was(stages, tmp_path_factory):
    path = tmp_path_factory.mktemp("journal") / "progress.json"
    kept(path, {"first": 0, **stages})
    assert json.dumps(dict(resumed(path))) == json.dumps({"first": 0, **stages})  # Also tells 0.0 from -0.0 and 0.


@given(number=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_bit(number, tmp_path_factory):
    path = tmp_path_factory.mktemp("journal") / "progress.json"
    kept(path, {"y": [number]})
    assert np.float64(resumed(path)["y"][0]).tobytes() == np.float64(number).tobytes()


def test_it_is_a_mapping_whose_every_change_is_in_the_file(path):
    journal = kept(path, {"scan": [1.5], "sampling": "box"})
    assert (list(journal), len(journal), "scan" in journal) == (["scan", "sampling"], 2, True)
    assert dict(resumed(path)) == {"scan": [1.5], "sampling": "box"}
    del journal["scan"]
    assert dict(resumed(path)) == {"sampling": "box"}
    with pytest.raises(KeyError):
        journal["scan"]


def test_it_is_started_anew_if_it_is_to_be(path):
    kept(path, {"scan": 1, "sampling": "box"})
    journal = FileJournal(path, OWNER, resume="never")
    assert len(journal) == 0
    assert dict(resumed(path)) == {"scan": 1, "sampling": "box"}  # The old one is there until there is a new one.
    journal["scan"] = 2
    assert dict(resumed(path)) == {"scan": 2}


def test_of_a_fit_with_an_end_only_the_same_goes_on_and_only_if_it_is_to(path):
    other = {**OWNER, "--free": "3c"}
    journal = kept(path, {"scan": 1})
    assert not journal.goes_on
    again = FileJournal(path, OWNER, resume="unfinished")
    assert again.goes_on and dict(again) == {"scan": 1}
    with pytest.raises(RaytraceError, match=r"another --free; .* --restart"):
        FileJournal(path, other, resume="unfinished")
    again.finish()
    for owner in (OWNER, other):
        fresh = FileJournal(path, owner, resume="unfinished")
        assert not fresh.goes_on and len(fresh) == 0
    assert dict(resumed(path)) == {"scan": 1}
    with pytest.raises(RaytraceError, match="another --free"):
        resumed(path, other)


def test_to_resume_what_is_not_there_is_to_start(path):
    journal = resumed(path)
    assert len(journal) == 0 and not path.parent.exists()
    journal["scan"] = 1  # Makes the folder.
    assert dict(resumed(path)) == {"scan": 1}


WHOLE = json.dumps({"belongs_to": OWNER, "stages": {"scan": 1}})


@pytest.mark.parametrize(
    "text",
    [
        *("", "x", "null", "[]", "{}", "3", WHOLE[:-3], "\x00" + WHOLE),
        '{"belongs_to": 1, "stages": {}}',
        '{"stages": {}}',
        json.dumps({"belongs_to": OWNER}),
        json.dumps({"belongs_to": OWNER, "stages": [1]}),
    ],
)
def test_a_broken_file_is_refused_with_what_to_do(text, path):
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(RaytraceError, match="is broken; --restart begins") as caught:
        resumed(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert path.read_text() == text
    assert len(FileJournal(path, OWNER, resume="never")) == 0


def test_what_is_not_text_is_refused(path):
    path.parent.mkdir()
    path.write_bytes(b"\xff\xfe\x00\xd8")
    with pytest.raises(RaytraceError, match="is broken"):
        resumed(path)


@pytest.mark.parametrize(
    ("owner", "words"),
    [
        ({**OWNER, "--free": "3c"}, "another --free;"),
        ({**OWNER, "scene": "x", "version": "1.1"}, "another scene and version;"),
        ({**OWNER, "--mask": "4d"}, "another --mask;"),
        ({"scene": "1a", "version": "1.0"}, "another --free;"),
    ],
)
def test_the_journal_of_another_fit_is_refused_and_what_differs_is_named(owner, words, path):
    kept(path, {"scan": 1})
    with pytest.raises(RaytraceError, match=words) as caught:
        resumed(path, owner)
    assert "go on with its own arguments" in str(caught.value)
    assert dict(resumed(path)) == {"scan": 1}


@pytest.mark.parametrize(
    ("failure", "raised"),
    [(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), None), (KeyboardInterrupt(), KeyboardInterrupt)],
)
def test_a_write_that_fails_half_way_leaves_the_old_file_whole(failure, raised, path, monkeypatch):
    journal = kept(path, {"scan": 1})
    write = Path.write_text

    def write_half(self, text, **options):
        write(self, text[: len(text) // 2], **options)
        raise failure

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", write_half)
        full = pytest.warns(UserWarning, match="the disk is full; should the fit be interrupted, it cannot go on")
        with full if raised is None else pytest.raises(raised):
            journal["candidate 0"] = [1.0] * 100
        once = warnings.catch_warnings(action="error")
        with once, contextlib.nullcontext() if raised is None else pytest.raises(raised):
            journal["candidate 1"] = 2
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert dict(resumed(path)) == {"scan": 1}
    journal["sampling"] = "box"
    assert set(resumed(path)) >= {"scan", "sampling"}


PARTS = {
    "target": np.arange(12.0).reshape(3, 2, 2),
    "--mask": None,
    "--free": ("a.ior",),
    "setting": ResolvedSettings(),
    "--sigma": 0.1,
}


def test_the_same_parts_have_the_same_identity():
    again = {**PARTS, "target": np.arange(12.0).reshape(3, 2, 2), "setting": ResolvedSettings()}
    assert identity(PARTS) == identity(again)
    assert set(identity(PARTS)) == {*PARTS, "version"}
    assert all(isinstance(value, str) for value in identity(PARTS).values())


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("target", np.nextafter(PARTS["target"], 100)),
        ("--mask", np.ones((2, 2))),
        ("--free", ("a.radius",)),
        ("setting", ResolvedSettings(max_bounces=4)),
        ("--sigma", np.nextafter(0.1, 1)),
    ],
)
def test_another_part_is_told_by_its_name_and_no_other(name, other):
    one, two = identity(PARTS), identity({**PARTS, name: other})
    assert [key for key in one if one[key] != two[key]] == [name]


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still unless it is told otherwise."""
    now = types.SimpleNamespace(time=1000.0)
    monkeypatch.setattr("raytrace_jax.inverse.solve.recorder.time", types.SimpleNamespace(monotonic=lambda: now.time))
    return now


def recorder(journal, on_step=None, on_phase=None, max_seconds=None):
    columns = np.random.default_rng(0).normal(size=(2, 3, 4, 4))
    return Recorder(linear_problem(columns, columns[0]), journal, on_step, on_phase, max_seconds)


def work(recorder, clock):
    """A stage of two steps and seven seconds."""

    def run():
        record = recorder.level(0, 1, 0.5)
        for step, y in enumerate([[0.1, 1 / 3], [1e-300, -2.5]]):
            clock.time += 3.5
            record(step, 4.0 / (step + 3), step == 0, jnp.asarray(y))
        return {"y": [0.1, 1 / 3], "settled": True}

    return run


def test_a_stage_that_is_done_is_not_done_again_but_remembered(path, clock):
    seen = []
    first = recorder(kept(path, {}), seen.append)
    clock.time += 2
    outcome = first.stage("candidate 0", work(first, clock))
    assert len(seen) == len(first.history) == 2 and first.seconds == 9

    clock.time += 1e6  # Until tomorrow.
    second = recorder(resumed(path), seen.append)
    assert second.seconds == 0
    found = second.stage("candidate 0", lambda: pytest.fail("worked again"))
    assert found == outcome
    assert second.seconds == 9
    assert len(seen) == 2  # What was shown is not shown again.
    for one, other in zip(first.history, second.history, strict=True):
        assert isinstance(other.value, np.ndarray)
        np.testing.assert_array_equal(one.value, other.value)
        assert {**vars(one), "value": 0} == {**vars(other), "value": 0}
    # Further steps of this level go on behind those that are remembered; those of others begin.
    for candidate, level in [(0, 1), (0, 0), (1, 1)]:
        second.level(candidate, level)(0, 1.0, True, jnp.asarray([0.1, 1 / 3]))
    assert [step.step for step in second.history] == [0, 1, 2, 0, 0]


def test_stages_go_on_after_those_that_are_remembered(path, clock):
    first = recorder(kept(path, {}))
    first.stage("candidate 0", work(first, clock))
    second = recorder(resumed(path))
    second.stage("candidate 0", lambda: pytest.fail("worked again"))
    second.stage("candidate 1", work(second, clock))
    assert (len(second.history), second.seconds) == (4, 14)
    third = recorder(resumed(path))
    for name in ("candidate 0", "candidate 1"):
        third.stage(name, lambda: pytest.fail("worked again"))
    assert [step.seconds for step in third.history] == [step.seconds for step in second.history] == [3.5, 7, 10.5, 14]
    assert third.seconds == 14


def test_a_stage_that_is_interrupted_is_not_kept(path, clock):
    journal = kept(path, {})
    stopped = recorder(journal, max_seconds=5.0)
    with pytest.raises(TimeoutError):
        stopped.stage("candidate 0", work(stopped, clock))
    assert len(journal) == 0 and len(stopped.history) == 2
    np.testing.assert_array_equal(stopped.findings.answer, [1e-300, -2.5])


def test_each_process_has_all_of_its_time(path, clock):
    """Else a fit that was stopped by the clock would be stopped at once when the same command goes on with it."""
    first = recorder(kept(path, {}))
    first.stage("candidate 0", work(first, clock))
    second = recorder(resumed(path), max_seconds=8.0)
    second.phase("scanning")
    second.stage("candidate 0", lambda: pytest.fail("worked again"))
    clock.time += 7.5
    second.phase("solving")
    assert second.seconds == 14.5
    clock.time += 1
    with pytest.raises(TimeoutError):
        second.phase("solving")


def test_only_what_is_kept_can_be_gone_on_with(path, clock):
    for journal, can in [(None, False), (kept(path, {}), True)]:
        one = recorder(journal)
        assert not one.can_go_on
        one.stage("candidate 0", work(one, clock))
        assert one.can_go_on == can


def test_what_was_asked_to_stop_tells_nothing_more_and_keeps_its_step(clock):
    steps, phases = [], []
    one = recorder(None, steps.append, phases.append)
    one.stop()
    for end in (lambda: one.phase("solving"), lambda: one.level(0, 0, 2.0)(0, 1.0, True, jnp.asarray([1.0, 2.0]))):
        with pytest.raises(TimeoutError):
            end()
    assert not steps and phases == ["stopping ..."]
    np.testing.assert_array_equal(one.findings.answer, [1, 2])


def test_a_step_that_does_not_lead_is_told_but_is_not_the_answer(clock):
    steps, phases = [], []
    one = recorder({}, steps.append, phases.append)
    one.phase("solving")
    one.level(0, 0, 2.0)(0, 1.0, True, jnp.asarray([1.0, 2.0]))
    one.level(1, 0, 2.0, leads=False)(1, 0.5, True, jnp.asarray([3.0, 4.0]))
    np.testing.assert_array_equal(one.findings.answer, [1, 2])
    assert [(step.candidate, step.step, step.blur) for step in steps] == [(0, 0, 2.0), (1, 1, 2.0)]
    assert phases == ["solving"]
