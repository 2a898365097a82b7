"""The command `sweep`: ranges, frames and their times, one compile, MP4 by a stand-in for ffmpeg, what it refuses."""

import stat
import sys

import numpy as np
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scenes import DATA, assignment_scene

from raytrace_jax import RenderSettings, render, set_parameters
from raytrace_jax.cli.actions.pictures import decimals, parse_range
from raytrace_jax.cli.console import UsageError
from raytrace_jax.images.animation import label_frames
from raytrace_jax.images.transfer import encode_course
from raytrace_jax.util.digits import evenly_spaced

VITREOUS = DATA / "vitreous.txt"
SMALL = ["--size", "32", "24", "--max-bounces", "2"]
SETTINGS = RenderSettings(size=(32, 24), max_bounces=2)


def frames_of(path):
    with Image.open(path) as animation:
        frames = []
        for number in range(animation.n_frames):
            animation.seek(number)
            frames.append(np.asarray(animation.convert("RGB")).astype(int))
        return frames, animation.info


def expected(ior):
    image = render(set_parameters(assignment_scene(), {"vitreous.ior": ior, "vitreous.radius": 2}), SETTINGS).image
    return np.moveaxis(encode_course(np.asarray(image)), 0, -1).astype(int)


@pytest.mark.slow
def test_the_frames_are_the_renders(tmp_path, capsys):
    out = tmp_path / "new" / "sweep.gif"
    over = ("--over", "vitreous.ior=1.0:2.2:4", "-D", "vitreous.radius=2", "--fps", 10)
    assert run("sweep", VITREOUS, *over, "-o", out, *SMALL) == 0
    captured = capsys.readouterr()
    assert captured.out.split() == [str(out)] and captured.err.startswith("rendering 4 frames took")
    assert list(out.parent.iterdir()) == [out]
    frames, info = frames_of(out)
    assert (len(frames), info["duration"], info["loop"]) == (4, 100, 0)
    renders = [expected(ior) for ior in (1.0, 1.4, 1.8, 2.2)]
    for number, frame in enumerate(frames):
        # 256 colours and the pattern between them change a picture, but not to another one.
        error = [np.abs(frame - other).mean() for other in renders]
        assert error[number] < 4 and np.argmin(error) == number

    assert run("sweep", VITREOUS, *over, "-o", out, *SMALL, "--bounce", "--quiet") == 0
    assert capsys.readouterr().err == ""
    back, _ = frames_of(out)
    assert len(back) == 6
    for one, other in ((4, 2), (5, 1)):
        np.testing.assert_array_equal(back[one], back[other])


def test_a_sweep_has_labels(tmp_path):
    arguments = ("sweep", VITREOUS, "--over", "vitreous.ior=1.2:1.5:2", "--size", 160, 120, "--max-bounces", 0, "-o")
    assert run(*arguments, tmp_path / "without.gif") == 0
    assert run(*arguments, tmp_path / "with.gif", "--label") == 0
    assert frames_of(tmp_path / "with.gif")[1]["duration"] == 1000  # Two values are not over in a tenth of a second.
    without, labelled = (frames_of(tmp_path / name)[0][0] for name in ("without.gif", "with.gif"))
    assert len(labelled) == 133 and np.all(np.flatnonzero((labelled[120:] > 200).any(axis=(0, 2))) < 120)
    assert (np.abs(without - labelled[:120]).max(axis=-1) > 100).sum() < 20


LABELS = [((80, 60), "ball.ior", 13), ((80, 60), "vitreous.center.x", 26), ((16, 12), "vitreous.ior", 26)]


@pytest.mark.parametrize(("size", "name", "strip"), [*LABELS, ((640, 480), "ball.ior", 31)])
def test_a_frame_has_its_label_below(size, name, strip):
    grey = Image.new("RGB", size, "grey")
    frames = label_frames([grey, grey], name, ["9.5", "10.0"])
    for frame in frames:
        assert frame.size == (size[0], size[1] + strip)
        assert frame.crop((0, 0, *size)).tobytes() == grey.tobytes()
        below = np.asarray(frame)[size[1] :]
        assert below.max() > 200 and np.median(below) == 0
    assert frames[0].tobytes() != frames[1].tobytes()


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    """A program of that name on the PATH, which stores its input or fails."""

    def install(body):
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        (folder / "ffmpeg").write_text(f"#!{sys.executable}\nimport sys\n{body}\n")
        (folder / "ffmpeg").chmod(stat.S_IRWXU)
        monkeypatch.setenv("PATH", str(folder))

    return install


@pytest.mark.skipif(sys.platform == "win32", reason="a script is no program there")
def test_mp4_goes_through_ffmpeg(tmp_path, ffmpeg, capsys):
    ffmpeg("open(sys.argv[-1], 'wb').write(sys.stdin.buffer.read()); print(sys.argv, file=sys.stderr)")
    out = tmp_path / "a.mp4"
    arguments = ["sweep", VITREOUS, "--over", "vitreous.ior=1:2.2:4", "-D", "vitreous.radius=2", "-o", out, *SMALL]
    assert run(*arguments, "--fps", 60) == 0
    stored = np.frombuffer(out.read_bytes(), np.uint8).reshape(4, 24, 32, 3)
    np.testing.assert_array_equal(stored[2], expected(1.8))

    ffmpeg("sys.stdin.buffer.read(); print('no encoder', file=sys.stderr); sys.exit(1)")
    out.unlink()
    capsys.readouterr()
    assert run(*arguments, "--quiet") == 1
    assert capsys.readouterr().err == f"error: {out}: cannot be written: ffmpeg says: no encoder\n"
    assert not out.exists() and not list(tmp_path.glob("*part*"))


def test_ranges_have_both_ends():
    assert evenly_spaced(1.3, 1.6, 3) == [1.3, 1.45, 1.6]
    assert evenly_spaced(1.4, 1.6, 5) == [1.4, 1.45, 1.5, 1.55, 1.6]
    assert evenly_spaced(-0.3, 0.3, 7) == [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert evenly_spaced(1.0, 2.0, 4) == [1.0, 4 / 3, 5 / 3, 2.0]
    assert evenly_spaced(1.5, 2.0, 1) == [1.5]
    assert parse_range(" odd=name.ior = 1 : 2 : 3 ") == ("odd=name.ior", [1.0, 1.5, 2.0])
    with pytest.raises(UsageError):
        parse_range("=1:2:3")
    ranges = ([1.0, 2.0], 0), ([1.0, 1.1], 1), ([0.0, 0.024], 3), ([1.5, 1.5], 1), ([0, 1e-12], 9), ([1.0, 8 / 7], 3)
    for values, digits in ranges:
        assert decimals(values) == digits


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_the_ends_are_themselves(start, stop):
    values = evenly_spaced(start, stop, 11)
    assert (values[0], values[-1]) == (start, stop)
