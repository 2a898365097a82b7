"""The command line's answers to what `photo` and `calibrate` cannot use: a message and a code, before the work."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax import PictureError
from raytrace_jax.cli import main
from raytrace_jax.photo.board_pattern import Pattern
from raytrace_jax.report.board_sheet import board_blocks, pattern_picture

PATTERN = Pattern(6, 5, 10.0)
PHOTO = ["photo", "photo.png", "--board", "board.txt", "-o", "out"]
BALL = [*PHOTO, "--radius", "20mm"]
CALIBRATE = ["calibrate", "--board", "board.txt", "-o", "new/camera.toml"]


def run(*arguments):
    return main([str(argument) for argument in arguments])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A board and a photograph, in which there is no ball."""
    monkeypatch.chdir(tmp_path)
    picture = pattern_picture(PATTERN)
    Image.fromarray(picture).save("board_texture.png")
    Path("board.txt").write_text(board_blocks(PATTERN, "board_texture.png", "A4"))
    Image.fromarray(np.pad(picture, 40, constant_values=255)).save("photo.png")
    Path("file").write_text("nothing useful")
    Path("board.pdf").write_bytes(b"%PDF-1.4\n1 0 obj")
    return tmp_path


BAD_INPUT = [
    (2, PHOTO, ["--radius"]),
    (2, [*PHOTO[:4], "--radius", "20mm"], ["--output"]),
    (2, ["photo", "photo.png", "--radius", "20mm", "-o", "out"], ["--board"]),
    (2, [*PHOTO, "--radius", "20"], ["--radius", "it has no unit"]),
    (2, [*PHOTO, "--radius", "20 parsec"], ["--radius", "parsec", "unknown"]),
    (2, [*PHOTO, "--radius", "much"], ["--radius", "much"]),
    (2, [*PHOTO, "--radius", "0mm"], ["--radius", "greater than 0"]),
    (2, [*PHOTO, "--radius", "20+-0.1+-0.1mm"], ["--radius", "one +-"]),
    (2, [*BALL, "--ruler", "99.9"], ["--ruler", "it has no unit"]),
    (2, [*BALL, "--ruler", "long"], ["--ruler", "long"]),
    (2, [*BALL, "--ruler", "0mm"], ["--ruler", "greater than 0"]),
    (2, [*BALL, "--transfer", "log"], ["log", "srgb"]),
    (2, [*BALL, "--quik"], ["--quik"]),
    (1, [*BALL, "--board", "none.txt"], ["none.txt", "no such file"]),
    (1, [*BALL, "--board", "file"], ["file:1:1"]),
    (1, ["photo", "none.jpg", *BALL[2:]], ["none.jpg", "no such file"]),
    (1, ["photo", "file", *BALL[2:]], ["file", "JPEG, TIFF, PPM or Radiance HDR"]),
    (1, [*BALL, "-o", "file"], ["file is not a folder"]),
    (1, [*BALL, "--board", "board.pdf"], ["board.pdf: is a PDF; the text", "beside it: board.txt."]),
    (1, [*BALL, "--board", "board_texture.png"], ["board_texture.png: is no text;", "beside it: board.txt."]),
    (1, [*BALL, "--board", "photo.png"], ["photo.png: is no text;", "beside it: BOARD.txt."]),
    (1, [*BALL, "--camera", "none.toml"], ["none.toml", "no such file"]),
    (1, [*BALL, "--camera", "file"], ["file: is no lens", "raytrace-jax calibrate"]),
    (1, [*BALL, "--camera", "board.txt"], ["board.txt: is no lens", "raytrace-jax calibrate"]),
    (1, CALIBRATE, ["0 pictures are too few", "3 are wanted"]),
    (2, ["calibrate", "photo.png", "-o", "camera.toml"], ["--board"]),
    (2, ["calibrate", "photo.png", "--board", "board.txt"], ["--output"]),
    (1, [*CALIBRATE[:1], "photo.png", "photo.png", *CALIBRATE[1:]], ["2 pictures are too few", "3 are wanted"]),
    (1, [*CALIBRATE[:1], "photo.png", "none.png", "photo.png", *CALIBRATE[1:]], ["none.png", "no such file"]),
]


@pytest.mark.parametrize(("code", "arguments", "words"), BAD_INPUT)
def test_bad_input_is_one_message_before_the_work(code, arguments, words, folder, monkeypatch, capsys):
    def never(*_, **__):
        raise AssertionError("work has begun")

    for work in ("cli.actions.photo.locate", "cli.actions.photo.fit", "photo.calibrate.find_camera"):
        monkeypatch.setattr(f"raytrace_jax.{work}", never)
    before = sorted(folder.rglob("*"))
    # tyro takes the last of an option that is given twice.
    assert run(*arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err and "AssertionError" not in captured.err
    assert "NoneType" not in captured.err and "{None" not in captured.err
    if code == 1:
        assert captured.err.count("error: ") == 1
    message = " ".join(captured.err.replace("│", " ").split())
    for word in words:
        assert word in message
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("command", ["photo", "calibrate"])
def test_the_help_names_the_options_and_an_example(command, capsys):
    run(command, "--help")
    out = capsys.readouterr().out
    assert "--board" in out and "Example: raytrace-jax" in out and "Traceback" not in out


def test_lengths_that_were_not_measured_are_told_and_count_as_uncertain(folder, monkeypatch, capsys):
    asked = []

    def located(_, __, radius, ___):
        asked.append(radius)
        raise PictureError("seen enough")

    monkeypatch.setattr("raytrace_jax.cli.actions.photo.locate", located)
    assert run(*BALL) == run(*PHOTO, "--radius", "20+-0.01mm", "--ruler", "99.9+-0.02mm") == 1
    warned = capsys.readouterr().err
    assert warned.count("counts as exact") == warned.count("counts as 100+-0.1 mm") == 1
    assert asked[0] == pytest.approx((20, 0.02))
    assert asked[1] == pytest.approx((20 * 100 / 99.9, 20 * 100 / 99.9 * np.hypot(5e-4, 0.02 / 99.9)))
    assert run(*PHOTO, "--radius", "20+-0.01mm", "--ruler", "9.98cm") == 1
    warned = " ".join(capsys.readouterr().err.split())
    assert "--ruler has no standard deviation and counts as exact: state it as 99.93+-0.03mm" in warned
    assert "--radius has" not in warned


def test_long_writes_errors_out_in_the_table_and_on_the_sheet(folder, monkeypatch, capsys):
    located = SimpleNamespace(numbers=np.arange(16) + 0.5, covariance=0.012**2 * np.eye(16))
    drawn = []

    def sheet(_, __, ___, long):
        drawn.append(long)
        return Figure()

    def too_dark(*_):
        raise PictureError("It is too dark.")

    for name, stand_in in {
        "locate": lambda *_: located,
        "flatten": too_dark,
        "told": lambda _: {},
        "draw_photo_sheet": sheet,
    }.items():
        monkeypatch.setattr(f"raytrace_jax.cli.actions.photo.{name}", stand_in)
    assert run(*BALL) == 0
    captured = capsys.readouterr()
    rows = [line.split("  ") for line in captured.out.splitlines()]
    assert [row[0] for row in rows[2:8]] == ["index", "angle of view", "center.x", "center.y", "center.z", "radius"]
    assert [row[-1].strip() for row in rows[2:5]] == ["11.500(12)", "6.500(12)", "12.500(12)"]
    assert "It is too dark. There is no scene for a fit." in captured.err
    assert run(*BALL, "--long") == 0
    assert "11.500 +- 0.012" in capsys.readouterr().out and drawn == [False, True]
    assert run(*BALL, "--fit") == 1
    assert "error: It is too dark." in capsys.readouterr().err
