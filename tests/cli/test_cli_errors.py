"""The command line's answers to bad input and to failures: one message and an exit code, never a traceback."""

from pathlib import Path

import numpy as np
import pytest
from command_line import run
from fake_fit import VITREOUS

from raytrace_jax import write_png

SMALL = ["--size", "40", "30", "--max-bounces", "2"]
FIT = ["fit", VITREOUS, "target.png", "-o", "out", "--free", "cyan.ior"]
TWO = ["fit", "--free", "glass.ior", "-o", "out", "two_views"]
SWEEP = ["sweep", VITREOUS, "-o", "a.gif", "--over"]
VIEW = ["view", "vitreous", "--over"]
BOARD = ["board", "-o", "board.pdf"]
SCREEN = ["board", "-o", "board.png", "--screen"]


BAD_INPUT = [
    (2, [], ["subcommand"]),
    (2, ["rendr"], ["'rendr'", "Did you mean 'render'?"]),
    (2, ["render", VITREOUS], ["--output"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--sampels", 2], ["--samples"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--samples", 0], ["--samples is 0", "1 to 64"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--samples", "two"], ["two"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--size", 40], ["--size W H", "expected argument count 2"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--crop", 600, 0, 100, 100], ["--crop (600, 0, 100, 100)", "640 x 480"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "--aov", "depht"], ["depht"]),
    (2, ["render", VITREOUS, "-o", "a.jpg"], ["a.jpg", ".exr or .png"]),
    (2, ["render", VITREOUS, "-o", "a.png", "--no-png"], ["--no-png"]),
    (2, ["render", VITREOUS, "-o", "a.png", "--aov", "depth"], ["--aov"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "-D", "vitreus.ior=1"], ["vitreus", "'vitreous'?"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "-D", "vitreous.ior"], ["name=value"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "-D", "vitreous.abbe=30"], ["no abbe", "write it into the block first"]),
    (2, [*TWO, "a.png"], ["a.png: it has to say which camera has seen it, as left=a.png", "left, right", "--camera"]),
    (2, [*TWO, "left=a.png", "lft=b.png"], ["lft=b.png", "Did you mean 'left'?"]),
    (2, [*TWO, "left=a.png", "left=b.png"], ["a.png and b.png are both given for the camera left"]),
    (2, [*TWO, "left=a.png"], ["no picture of the camera right"]),
    (2, [*TWO, "left=a.png", "right=b.png", "--transfer", "left=linear"], ["--transfer linear: course or srgb"]),
    (1, [*TWO, "left=target.png", "right=none.png"], ["none.png: there is no such file"]),
    (2, ["gallery", "physical.txt", "-o", "out"], ["physical.txt is for the physical model", "classic"]),
    (2, ["render", VITREOUS, "-o", "a.exr", "-Dcyan.ior=1", "-Dcyan.ior=2"], ["cyan.ior", "twice"]),
    (1, ["render", "none.txt", "-o", "a.exr"], ["none.txt", "no such file"]),
    (1, ["render", ".", "-o", "a.exr"], ["directory"]),
    (1, ["render", VITREOUS, "-o", "folder.exr"], ["folder.exr", "it is a folder"]),
    (1, ["render", VITREOUS, "-o", "."], [".: cannot be written: it is a folder"]),
    (1, ["render", VITREOUS, "-o", "/"], ["/: cannot be written: it is a folder"]),
    (1, ["rays", VITREOUS, "-o", ".", "--pixel", 1, 2], [".: cannot be written: it is a folder"]),
    (1, ["export", "vitreous", "-o", "/", "--to", "mitsuba", "--model", "physical"], ["/: cannot be written: it is a"]),
    (1, ["render", VITREOUS, "-o", "file/a.exr"], ["is not a folder"]),
    (1, ["info", "file"], ["file:1:1"]),
    (2, ["grad", VITREOUS, "-o", "a.exr"], ["--wrt"]),
    (2, ["grad", VITREOUS, "-o", "a.png", "--wrt", "cyan.ior"], ["a.png", ".exr"]),
    (2, ["grad", VITREOUS, "-o", "a.exr", "--wrt", "cyan.ior", "--check-samples", 0], ["--check-samples is 0"]),
    (2, ["grad", VITREOUS, "-o", "a.exr", "--wrt", "cyan.alpha", "--check", "--check-step", 30], ["step of 30"]),
    (2, ["rays", VITREOUS, "-o", "a.svg"], ["--pixel"]),
    (2, ["rays", VITREOUS, "-o", "a.exr", "--pixel", 1, 2], ["a.exr", ".svg or .png"]),
    (2, ["rays", VITREOUS, "-o", "a.svg", "--pixel", 640, 2], ["--pixel 640 2", "0 to 639", "0 to 479"]),
    (2, ["rays", VITREOUS, "-o", "a.svg", "--pixel", 1, 2, "--crop", 2, 2, 5, 5], ["--pixel 1 2", "2 to 6"]),
    (2, ["rays", VITREOUS, "-o", "a.svg", "--pixel", 1, 2, "--samples", 2], ["--samples is 2"]),
    (2, ["fit", VITREOUS, "target.png", "-o", "out"], ["--free"]),
    (2, [*FIT, "--max-steps", 0], ["--max-steps is 0"]),
    (2, [*FIT, "--sigma", -1], ["--sigma is -1", "greater than 0"]),
    (2, [*FIT, "--uncertain", "cam1"], ["--uncertain cam1", "NAME=SD or NAME=SHARE%"]),
    (2, [*FIT, "--uncertain", "cam1=1%", "--uncertain", "cam1=2%"], ["--uncertain cam1 is given twice"]),
    (1, [*FIT, "--mask", "none.png"], ["none.png", "no such file"]),
    (2, [*FIT, "--pdf", "--no-report"], ["--pdf is a figure of the report, which --no-report leaves out"]),
    (1, ["fit", VITREOUS, "none.png", "-o", "out", "--free", "cyan.ior"], ["none.png", "no such file"]),
    (1, ["fit", VITREOUS, "file", "-o", "out", "--free", "cyan.ior"], ["file", "JPEG, TIFF, PPM or Radiance HDR"]),
    (1, [*FIT, "--layer", "R"], ["no layers"]),
    (2, [*SWEEP, "vitreous.ior"], ["NAME=START:STOP:COUNT"]),
    (2, [*SWEEP, "vitreous.ior=1:2:1"], ["there are 1 frames", "2 to 10000"]),
    (2, [*SWEEP, "vitreous.ior=-1:2:3"], ["greater than 0"]),
    (2, [*SWEEP, "vitreous.center=1:2:3"], ["is a vector", "vitreous.center.x, vitreous.center.y"]),
    (2, [*SWEEP, "vitreous.ior=1:2:3", "--fps", 60], ["--fps is 60", "1 to 50"]),
    (2, [*SWEEP, "vitreous.ior=1:2:3", "-o", "a.avi"], ["a.avi", ".gif or .mp4", "'.avi'"]),
    (1, [*SWEEP, "vitreous.ior=1:2:3", "-o", "a.mp4"], ["ffmpeg", "name a .gif file"]),
    (2, [*VIEW, "vitreous.ior"], ["NAME=START:STOP"]),
    (2, [*VIEW, "vitreous.ior=2:1"], ["upwards"]),
    (2, [*VIEW, "vitreous.ior=2:3"], ["lies outside"]),
    (2, [*VIEW, "vitreous.center=0:9"], ["is a vector"]),
    (2, [*VIEW, "vitreous.iro=0:9"], ["ior"]),
    (2, [*VIEW, "vitreous.ior=1:2", "cyan.ior=1:2"], ["give it once"]),
    (2, ["view", "vitreous", "--save", "page.png"], [".html"]),
    (2, ["view", "vitreous", "--steps", 3], ["--steps is for --save"]),
    (2, [*VIEW, *(f"vitreous.center.{axis}=-9:9" for axis in "xyz"), "--save", "page.html"], ["one or two"]),
    (2, ["teach"], ["--output"]),
    (2, ["teach", "-o", "out", "--only", "snel"], ["snel"]),
    (1, ["teach", "-o", "file"], ["file is not a folder"]),
    (2, ["gallery", VITREOUS, "-o", "out", "--no-second-root"], ["--second-root is what the pictures"]),
    (2, ["board", "-o", "board.svg"], ["a board's name ends in .pdf or .png, not in '.svg'"]),
    (2, ["board", "-o", "board.png"], ["--screen and --pixels say how large it is"]),
    (2, ["board", "-o", "my board.pdf"], ["'my board_texture.png': the scene's file names this picture"]),
    (1, ["board", "-o", "file/board.pdf"], ["is not a folder"]),
    (2, [*SCREEN, "27in", "--pixels", 640, 480, "--paper", "a4"], ["--paper is for a board to"]),
    (2, [*SCREEN, "27", "--pixels", 640, 480], ["--screen: '27': it has no unit"]),
    (2, [*SCREEN, "27in", "--pixels", 30, 30], ["with 20 pixels a square and a margin, has room"]),
    (2, [*BOARD, "--square", "20cm"], ["A4 with a margin has room for 1 x 0 squares"]),
    (2, [*BOARD, "--squares", 28, 17], ["28 x 17 squares are too many: A4 with a margin has room for 27 x 17"]),
    (2, [*BOARD, "--squares", 1, 17], ["1 x 17 squares: a board has at least 2 a side"]),
]


@pytest.mark.parametrize(("code", "arguments", "words"), BAD_INPUT)
def test_bad_input_is_one_message(code, arguments, words, tmp_path, monkeypatch, replace_work, capsys):
    def never(*_, **__):
        raise AssertionError("work has begun")

    for work in ("render", "picture_derivatives"):
        replace_work(f"pictures.{work}", never)
    for work in ("scenes.render", "fit.fit", "explain.draw_tree", "explain.make_server"):
        replace_work(work, never)
    monkeypatch.setattr("raytrace_jax.report.differences.render", never)
    monkeypatch.setenv("PATH", "")  # Without ffmpeg.
    monkeypatch.chdir(tmp_path)
    Path("folder.exr").mkdir()
    Path("file").write_text("nothing useful")
    Path("physical.txt").write_text("settings main { model physical }" + VITREOUS.read_text())
    write_png("target.png", np.full((3, 4, 5), 0.5))
    before = sorted(Path().rglob("*"))
    assert run(*arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    if code == 1:
        assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    told = " ".join(captured.err.split())
    assert all(word in told for word in words)
    assert not any(word in told for word in ("Traceback", "AssertionError", "NoneType", "{None"))
    assert sorted(Path().rglob("*")) == before


WRITING = [
    ["render", VITREOUS, "-o", "new/a.exr"],
    ["grad", VITREOUS, "--wrt", "cyan.ior", "-o", "new/a.exr"],
    [*FIT[:3], "-o", "new", "--free", "cyan.ior"],
    ["gallery", VITREOUS, "-o", "new"],
    ["rays", VITREOUS, "--pixel", 1, 2, "-o", "new/a.svg"],
    ["sweep", VITREOUS, "--over", "cyan.ior=1:2:3", "-o", "new/a.gif"],
    ["batch", "plan.toml", "-o", "new"],
    ["teach", "-o", "new"],
]


REFUSALS = {13: "is not writable", 2: "no folder can be made in", 28: "full"}


@pytest.mark.parametrize("arguments", WRITING)
@pytest.mark.parametrize("number", REFUSALS)
def test_unwritable_folders_fail_early(arguments, number, tmp_path, monkeypatch, capsys):
    """As /proc, which root may write as far as its rights go, and in which no folder can be made."""

    def refuse(*_, **__):
        raise OSError(number, "no")

    monkeypatch.setattr("tempfile.TemporaryDirectory", refuse)
    monkeypatch.setattr("raytrace_jax.cli.preparation.load_scene", lambda *_, **__: pytest.fail("work has begun"))
    monkeypatch.chdir(tmp_path)
    write_png("target.png", np.full((3, 4, 5), 0.5))
    Path("plan.toml").write_text("nothing useful")
    assert run(*arguments) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("error: new: cannot be written: ")
    assert REFUSALS[number] in captured.err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (MemoryError(), 1, ["out of memory", "a crop"]),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."), 1, ["out of memory"]),
        (OSError(28, "No space left on device"), 1, ["No space left"]),
        (ZeroDivisionError("over nothing\nand more"), 1, ["ZeroDivisionError: over nothing", "RAYTRACE_JAX_TRACEBACK"]),
        (KeyboardInterrupt(), 130, ["interrupted"]),
    ],
)
def test_a_late_failure_is_one_message(error, code, words, tmp_path, monkeypatch, replace_work, capsys):
    def fail(*_):
        raise error

    replace_work("scenes.render", fail)
    assert run("render", VITREOUS, "-o", tmp_path / "a.exr", *SMALL) == code
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert all(word in captured.err for word in words)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("RAYTRACE_JAX_TRACEBACK", "1")
    run("render", VITREOUS, "-o", tmp_path / "a.exr", *SMALL)
    assert ("Traceback" in capsys.readouterr().err) == isinstance(error, Exception)


def test_a_range_in_place_of_a_value_names_the_commands_for_many(tmp_path, capsys):
    assert run("render", "vitreous", "-o", str(tmp_path / "x.exr"), "-D", "vitreous.ior=1.3:1.7:9") == 2
    message = capsys.readouterr().err
    assert "raytrace-jax batch" in message and "raytrace-jax sweep --over" in message and "in one process" in message
