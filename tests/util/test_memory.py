"""Pictures for which there is no memory are refused before work begins; what is free is asked of the system."""

import functools
import sys

import jax
import numpy as np
import pytest
from command_line import run
from fake_fit import VITREOUS
from scenes import resolved

from raytrace_jax import PictureError, fit, load_scene, picture_derivatives, render
from raytrace_jax.tracer.pixels import refuse_too_large
from raytrace_jax.util import session

LARGE = resolved(size=(32768, 32768))


@pytest.fixture
def free(monkeypatch):
    """Let ten gigabytes be free; `free(function)`: what it says."""
    set_free = functools.partial(monkeypatch.setattr, "raytrace_jax.util.session.free_memory")
    set_free(lambda: 10_000_000_000)
    return set_free


NEEDS = "a picture of 32768 x 32768 pixels{} needs about {} of memory, and 10 GB are free: render it in parts"


def test_a_too_large_picture_is_refused(free):
    scene = load_scene(VITREOUS)
    for use in (render, jax.jit(functools.partial(render, settings=LARGE))):
        with pytest.raises(PictureError, match=NEEDS.format("", "96.6 GB")):
            use(scene, LARGE) if use is render else use(scene)
    with pytest.raises(PictureError, match=NEEDS.format(" with derivatives by 4 numbers", "483 GB")):
        picture_derivatives(scene, ["vitreous.ior", "vitreous.center"], LARGE)
    target = np.broadcast_to(np.float32(0.5), (3, 32768, 32768))
    with pytest.raises(PictureError, match=NEEDS.format(" with derivatives by 2 numbers", "290 GB")):
        fit(scene, target, ["vitreous.ior", "vitreous.radius"], LARGE)


@pytest.mark.parametrize(
    "command", [["render"], ["grad", "--wrt", "vitreous.ior"], ["fit", str(VITREOUS), "--free", "vitreous.ior"]]
)
def test_the_command_names_the_crop_first(command, free, capsys, tmp_path):
    name, *more = command
    output = tmp_path / ("fit" if name == "fit" else "a.exr")
    assert run(name, str(VITREOUS), *more, "-o", str(output), "--size", "32768", "32768", "--quiet") == 1
    said = capsys.readouterr().err
    assert said.startswith("error: a picture of 32768 x 32768") and "--crop" in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_fits_is_not_refused(free):
    scene = load_scene(VITREOUS)
    refuse_too_large(scene, resolved(size=(8192, 8192)))
    refuse_too_large(scene, resolved(size=(32768, 32768), crop=(0, 0, 4096, 4096)))
    with pytest.raises(PictureError):
        refuse_too_large(scene, resolved(size=(8192, 8192), aov=("normal", "position")))
    free(lambda: None)
    refuse_too_large(scene, LARGE)
    free(lambda: pytest.fail("asked for a small picture"))
    refuse_too_large(scene, resolved(size=(640, 480)))


@pytest.mark.skipif(sys.platform != "linux", reason="the limits are Linux's")
def test_free_memory_obeys_the_container(monkeypatch, tmp_path):
    monkeypatch.setattr(session, "CGROUP", tmp_path)
    machine = session.free_memory()
    assert 1e6 < machine < 1e15
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("700\n")
    (tmp_path / "memory.stat").write_text("anon 600\nfile 50\n")
    assert session.free_memory() > 1e6  # No limit.
    (tmp_path / "memory.max").write_text("1000\n")
    assert session.free_memory() == 350
    monkeypatch.setattr(session, "CGROUP", tmp_path / "none")
    monkeypatch.setattr("resource.getrlimit", lambda _: (0, 0))
    assert session.free_memory() == 0
