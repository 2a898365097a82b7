"""The command line's answers to what `photo` and `calibrate` cannot use: a message and a code, before the work."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import run
from image_files import png_bytes, write_tiff
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from raytrace_jax import PictureError
from raytrace_jax.images.transfer import DECODERS
from raytrace_jax.photo.boards import Pattern
from raytrace_jax.photo.bundle import Prior
from raytrace_jax.photo.geometry import Ball, Camera, Setup, Tank
from raytrace_jax.photo.lens import LensPrior, write_lens
from raytrace_jax.photo.locate import Located, PhotoResult, Together
from raytrace_jax.photo.opinions import to_dict
from raytrace_jax.photo.outline import Disc
from raytrace_jax.photo.photograph import Corners
from raytrace_jax.report.board_sheet import board_blocks, pattern_picture
from raytrace_jax.report.photo_sheet import draw_refused

PATTERN = Pattern(6, 5, 10.0)
PHOTO = ["photo", "photo.png", "--board", "board.txt", "-o", "out"]
BALL = [*PHOTO, "--radius", "20mm"]
TANK = [*PHOTO, "--tank", "60mm", "--wall", "0mm"]
CALIBRATE = ["calibrate", "--board", "board.txt", "-o", "new/camera.toml"]


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
    (2, PHOTO, ["--radius of a ball or --tank, the thickness of a tank: one of the two is wanted"]),
    (2, [*BALL, "--tank", "60mm"], ["--radius of a ball or --tank"]),
    (2, [*BALL, "--wall", "3mm,1.49"], ["--wall: is of a tank, and --tank is missing"]),
    (2, [*PHOTO, "--tank", "60"], ["--tank", "it has no unit"]),
    (2, [*PHOTO, "--tank", "60mm", "--wall", "3mm"], ["--wall: an index above 1", "as 3+-0.1mm,1.49"]),
    (
        2,
        [*PHOTO, "--tank", "60mm", "--wall", "30mm,1.49"],
        ["--wall 30mm,1.49: two such walls leave no room"],
    ),
    (2, [*BALL, "--in", "0.9"], ["--in: an index above 1", "as 1.333+-0.001"]),
    (2, [*BALL, "--in", "1.333", "--fit"], ["--fit: is for a ball in air, and --in came"]),
    (2, [*PHOTO, "--tank", "60mm"], ["--wall: thickness and index", "write --wall 0mm for a tank without"]),
    (2, [*PHOTO, "--tank", "60mm", "--wall", "0+-0.1mm"], ["--wall: '0+-0.1mm' came, and a length greater than 0"]),
    (2, [*BALL, "--wedge", "0+-0.1deg"], ["--wedge: is of a tank, and --tank is missing"]),
    (2, [*TANK, "--wedge", "1deg"], ["--wedge: '1deg' came, and a standard deviation below 10 degrees is wanted"]),
    (2, [*TANK, "--in", "1.333"], ["--in: is for a ball, and --tank came"]),
    (2, [*TANK, "--fit"], ["--fit: is for a ball, and --tank came"]),
    (2, [*PHOTO[:4], "--radius", "20mm"], ["--output"]),
    (2, ["photo", "photo.png", "--radius", "20mm", "-o", "out"], ["--board"]),
    (2, ["photo", *BALL[2:]], ["PHOTO: no photograph came"]),
    (2, ["photo", "photo.png", *BALL[1:], "--ball", "9", "9", "9"], ["--ball: is for one photograph, and 2 came"]),
    (2, ["photo", "photo.png", *BALL[1:], "--in", "1.33"], ["--in: is for one photograph, and 2 came"]),
    (1, ["photo", "photo.png", "none.jpg", *BALL[2:]], ["none.jpg", "no such file"]),
    (2, [*PHOTO, "--radius", "20"], ["--radius", "it has no unit"]),
    (2, [*BALL, "--ball", "30", "20"], ["--ball X Y R", "input length 2 did not match"]),
    (1, [*BALL, "--board", "none.txt"], ["none.txt", "no such file"]),
    (1, [*BALL, "--board", "file"], ["file:1:1"]),
    (1, ["photo", "file", *BALL[2:]], ["file", "JPEG, TIFF, PPM or Radiance HDR"]),
    (1, [*BALL, "-o", "file"], ["file is not a folder"]),
    (1, [*BALL, "--board", "board.pdf"], ["board.pdf: is no text; the text that describes a board is wanted"]),
    (1, [*BALL, "--board", "board_texture.png"], ["board_texture.png: is no text;"]),
    (1, [*BALL, "--camera", "none.toml"], ["none.toml", "no such file"]),
    (1, [*BALL, "--camera", "file"], ["file: is no lens", "raytrace-jax calibrate"]),
    (2, ["calibrate", "photo.png", "-o", "camera.toml"], ["--board"]),
    (1, ["calibrate", "photo.png", "--board", "board.txt", "-o", "."], [".: cannot be written: it is a folder"]),
    (1, [*CALIBRATE[:1], "photo.png", "photo.png", *CALIBRATE[1:]], ["2 pictures are too few", "3 are wanted"]),
    (1, [*CALIBRATE[:1], "photo.png", "none.png", "photo.png", *CALIBRATE[1:]], ["none.png", "no such file"]),
]


@pytest.mark.parametrize(("code", "arguments", "words"), BAD_INPUT)
def test_bad_input_is_one_early_message(code, arguments, words, folder, monkeypatch, capsys):
    def never(*_, **__):
        raise AssertionError("work has begun")

    for work in ("cli.actions.photo.locate_together", "cli.actions.photo.fit", "photo.find_camera.find_camera"):
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
    assert "counts as" not in captured.err
    for word in words:
        assert word in message
    assert sorted(folder.rglob("*")) == before


def test_unmeasured_lengths_are_uncertain(folder, monkeypatch, capsys):
    given = seen_by_locate(monkeypatch)
    assert run(*BALL) == run(*PHOTO, "--radius", "20+-0.01mm", "--ruler", "99.9+-0.02mm") == 1
    warned = capsys.readouterr().err
    assert warned.count("counts as exact") == warned.count("counts as 100+-0.1 mm") == 1
    assert given[0][2]["radius"] == pytest.approx((20, 0.02))
    assert given[1][2]["radius"] == pytest.approx((20 * 100 / 99.9, 20 * 100 / 99.9 * np.hypot(5e-4, 0.02 / 99.9)))
    assert run(*PHOTO, "--tank", "6+-0.01cm", "--wall", "3+-0.05mm,1.49", "--ruler", "100+-0.1mm") == 1
    assert given[2][2]["thickness"] == pytest.approx((60, np.hypot(0.1, 0.06)))
    assert given[2][2]["wall"] == pytest.approx((3, np.hypot(0.05, 0.003))) and given[2][2]["wall_index"] == (1.49, 0)
    capsys.readouterr()
    assert run(*PHOTO, "--radius", "20+-0.01mm", "--ruler", "9.98cm") == 1
    warned = " ".join(capsys.readouterr().err.split())
    assert "--ruler has no standard deviation above 0 and counts as exact: state it as 99.93+-0.03mm" in warned
    assert "--radius has" not in warned
    assert run(*PHOTO, "--tank", "60+-0mm", "--wall", "3mm,1.49", "--ruler", "100+-0.1mm") == 1
    assert given[4][2]["wall"] == pytest.approx((3, 0.003)), "the ruler's share"
    warned = " ".join(capsys.readouterr().err.split())
    assert "--tank has no standard deviation above 0 and counts as exact: state it as 60.2+-0.05mm" in warned
    assert "--wall has no standard deviation above 0 and counts as exact: state it as 3+-0.1mm,1.49" in warned
    assert run(*TANK) == 1 and given[5][2].keys() == {"thickness", "wedge"}
    assert given[5][2]["wedge"] == (0, pytest.approx(np.radians(0.2)))
    assert "--wall" not in capsys.readouterr().err


COUNT = 16
"""How many numbers a camera and a ball have."""


def located_at(numbers, error, glass=None):
    """What is located by no corners."""
    none = Corners.none()
    adjusted = Setup(Camera(), glass or Ball()).at(numbers), error**2 * np.eye(len(numbers)), (0.0, 0.0), none, none
    return Located(*adjusted, None, (48, 32), 0.0)  # pyright: ignore


def corners_say(monkeypatch, known):
    """Corners that say half more than its place of each number of a ball, and what the sheets are drawn with."""
    located = located_at(np.arange(COUNT) + 0.5, 0.012)
    adjusted = SimpleNamespace(views=[located], joint=located.setup.vector, covariance=located.covariance, known=known)
    together = Together([PhotoResult(SimpleNamespace(name="photo.png"), located=located)], adjusted)  # pyright: ignore
    drawn = []

    def sheet(_, __, ___, long, otherwise):
        drawn.append((long, [one.name for one in otherwise]))
        return Figure()

    def too_dark(*_):
        raise PictureError("It is too dark.")

    for name, stand_in in {
        "locate_together": lambda *_: together,
        "flatten": too_dark,
        "together_to_dict": lambda *_: {},
        "draw_photo_sheet": sheet,
    }.items():
        monkeypatch.setattr(f"raytrace_jax.cli.actions.photo.{name}", stand_in)
    return drawn


@pytest.mark.parametrize("wall", [0.0, 3.0])
def test_walls_are_told_where_there_are_any(wall):
    numbers = Setup(Camera(), Tank(wall=wall)).vector
    assert ("wall" in to_dict(located_at(numbers, 0.012, Tank()))["parameters"]) == (wall > 0)  # pyright: ignore


def test_long_writes_errors_out(folder, monkeypatch, capsys):
    drawn = corners_say(monkeypatch, Prior(np.zeros(COUNT), np.zeros((0, COUNT)), np.zeros(COUNT)))
    assert run(*BALL) == 0
    captured = capsys.readouterr()
    rows = [line.split("  ") for line in captured.out.splitlines()]
    assert [row[0] for row in rows[2:8]] == ["index", "angle of view", "center.x", "center.y", "center.z", "radius"]
    assert [row[-1].strip() for row in rows[2:5]] == ["11.500(12)", "6.500(12)", "12.500(12)"]
    assert [[row[0], row[-1].strip()] for row in rows[10:13]] == [
        ["corners", "0.012"],
        ["lens", "0"],
        ["radius and ruler", "0"],
    ]
    assert "from and at other places: with four times as many, 0.006 of 0.012 would be left." in captured.out
    assert "It is too dark. There is no scene for a fit." in captured.err
    assert run(*BALL, "--long") == 0
    assert "11.500 +- 0.012" in capsys.readouterr().out and drawn == [(False, []), (True, [])]
    assert run(*BALL, "--fit") == 1
    assert "error: It is too dark." in capsys.readouterr().err


def test_contradictions_are_told_first(folder, monkeypatch, capsys):
    mean, root = np.full(COUNT, 6.5), np.zeros((2, COUNT))
    mean[15], root[0, 6], root[1, 15] = 15.9, 50, 1 / 0.02  # The angle of view is 6.5, and the radius 15.5.
    drawn = corners_say(monkeypatch, Prior(mean, root, np.zeros(COUNT)))
    assert run(*BALL) == 3
    captured = capsys.readouterr()
    words = (
        "the photograph contradicts what was taken as known of radius: 15.500(12), stated 15.9+-0.02 (25 times as far"
    )
    message = " ".join(captured.err.split())
    assert words in message and "measure ball and ruler again" in message and "calibrate" not in message
    assert drawn == [(False, ["radius"])] and "15.500(12)" in captured.out


def seen_by_locate(monkeypatch):
    """What `locate` is given; it refuses each."""
    asked = []

    def locate(*given):
        asked.append(given)
        raise PictureError("seen enough")

    monkeypatch.setattr("raytrace_jax.cli.actions.photo.locate_together", locate)
    return asked


def write_silent(path, codes, bits):
    """A picture of whole numbers that does not say how they were made from light."""
    codes = codes.astype(f"u{bits // 8}")
    if path.suffix == ".ppm":
        shape = b"P6 %d %d %d " % (*codes.shape[1::-1], 2**bits - 1)
        path.write_bytes(shape + codes.astype(f">u{bits // 8}").tobytes())
    elif path.suffix == ".png":
        rows = [(0, row.tobytes()) for row in codes.astype(f">u{bits // 8}")]
        path.write_bytes(png_bytes(*codes.shape[1::-1], bits, 2, rows))
    else:
        write_tiff(path, codes)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".ppm"])
@pytest.mark.parametrize(("bits", "transfer"), [(8, "srgb"), (16, "course")])
@pytest.mark.parametrize("asked", [None, "srgb", "course"])
def test_unmarked_8_bits_are_told_as_srgb(suffix, bits, transfer, asked, folder, monkeypatch, capsys):
    codes = np.random.default_rng(0).integers(1, 2**bits - 1, (6, 8, 3))
    path = Path(f"silent{suffix}")
    write_silent(path, codes, bits)
    taken = asked or transfer
    light = DECODERS[taken](codes.astype(f"u{bits // 8}")).mean(axis=-1)
    given, how = seen_by_locate(monkeypatch), [] if asked is None else ["--transfer", asked]
    assert run("photo", path, *BALL[2:], *how) == 1
    np.testing.assert_allclose(given[0][0][0].light, light, atol=1e-6)
    words = f"{path} does not say how its colours were stored: read with --transfer {taken}, "
    assert (words in " ".join(capsys.readouterr().err.split())) == (asked is None)

    def calibrate(photographs, _):
        np.testing.assert_allclose([one.light for one in photographs], [light] * 3, atol=1e-6)
        raise PictureError("seen enough")

    monkeypatch.setattr("raytrace_jax.cli.actions.photo.calibrate", calibrate)
    assert run("calibrate", path, path, path, *CALIBRATE[1:], *how) == 1
    message = " ".join(capsys.readouterr().err.split())
    assert message.count(words) == (asked is None) and "error: seen enough" in message


def test_a_refusal_shows_what_was_taken():
    corners = Corners(np.full((3, 2), 20.0), np.zeros((3, 2)), np.ones(3))
    discs = [Disc(np.array([30.0, 20.0]), 8.0), Disc(np.array([10.0, 20.0]), 9.0)]
    through = corners.where(np.array([True, False, True]))
    result = PhotoResult(None, np.zeros((5, 4, 2)), corners, through, discs, reason="because " * 60)  # pyright: ignore
    figure = draw_refused(np.full((3, 40, 60), 0.5), result)
    titles = [ax.get_title() for ax in figure.axes]
    assert "5 markers" in titles[0] and "3 corners of the board" in titles[0]
    assert "2 discs taken for the ball, 2 corners through it" in titles[1]
    assert sum(isinstance(one, Circle) for one in figure.axes[0].patches) == 2
    bare = draw_refused(np.full((3, 40, 60), 0.5), PhotoResult(None, reason="It is grey."))  # pyright: ignore
    assert len(bare.axes) == 1 and "0 markers" in bare.axes[0].get_title()


def test_the_balls_place_may_be_stated(folder, monkeypatch, capsys):
    given = seen_by_locate(monkeypatch)
    assert run(*BALL) == 1 and "underexposed" not in capsys.readouterr().err
    Image.fromarray((np.asarray(Image.open("photo.png")) * (40 / 255)).astype(np.uint8)).save("photo.png")
    assert run(*BALL, "--ball", "30", "20", "9") == 1
    words = "photo.png is underexposed: its brightest hundredth has 2.1 % of the light"
    assert words in " ".join(capsys.readouterr().err.split())
    nothing, (center, radius) = given[0][4], given[1][4]
    assert (*center, radius) == (30, 20, 9) and nothing is None


def test_a_mirrored_picture_is_mirrored_back(folder, monkeypatch, capsys):
    seen = seen_by_locate(monkeypatch)
    upright = np.asarray(Image.open("photo.png"))
    Image.fromarray(upright[:, ::-1]).save("photo.png")
    assert run(*BALL) == 1
    assert "photo.png is mirrored, as a front camera may save it" in " ".join(capsys.readouterr().err.split())
    np.testing.assert_allclose(seen[0][0][0].grey, upright, atol=1)


@pytest.mark.parametrize(("orientation", "center"), [(1, (0.02, -0.01)), (3, (-0.02, 0.01)), (6, (0.01, 0.02))])
@pytest.mark.filterwarnings("ignore::raytrace_jax.RaytraceWarning")
def test_a_lens_is_turned_by_exif(orientation, center, folder, monkeypatch):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.full((40, 40), 99, np.uint8)).save("turned.jpg", exif=exif)
    lens = LensPrior(np.array([40.0, 0, 0, 0.02, -0.01]), np.diag([1.0, 2, 3, 4, 5]))
    write_lens("camera.txt", lens, (40, 40), "By a test.")
    given = seen_by_locate(monkeypatch)
    assert run("photo", "turned.jpg", *BALL[2:], "--camera", "camera.txt") == 1
    np.testing.assert_allclose(given[0][3].mean, [40, 0, 0, *center])


@pytest.mark.parametrize("fails", [True, False])
def test_contradicted_exif_is_not_believed(fails, folder, monkeypatch, capsys):
    write_jpeg("zoomed.jpg", xA405=27)
    numbers = np.full(COUNT, 35.0)
    asked = []

    def locate(photographs, __, ___, lens, ____):
        asked.append(lens)
        if np.isfinite(lens.covariance[0, 0]) and fails:
            return Together([PhotoResult(photographs[0], reason="nothing fits")], None)
        located = located_at(numbers, 0.3)
        return Together([PhotoResult(photographs[0], located=located)], located)  # pyright: ignore

    def done(*_):
        raise PictureError("seen enough")

    monkeypatch.setattr("raytrace_jax.cli.actions.photo.locate_together", locate)
    monkeypatch.setattr("raytrace_jax.cli.actions.photo.contradictions", done)
    monkeypatch.setattr("raytrace_jax.cli.actions.photo.flatten", lambda *_: None)
    assert run("photo", "zoomed.jpg", *BALL[2:]) == 1
    message = " ".join(capsys.readouterr().err.split())
    words = "zoomed.jpg: its EXIF tells an angle of view of 67.38 degrees (focal length, digital zoom), and the board"
    assert f"{words} 35.00(30): EXIF is not believed." in message and len(asked) == 2
    numbers[:] = 66.0
    if not fails:
        assert run("photo", "zoomed.jpg", *BALL[2:]) == 1
        assert "EXIF" not in capsys.readouterr().err and len(asked) == 3


def write_jpeg(path, **exif_numbers):
    exif = Image.Exif()
    for tag, value in exif_numbers.items():
        exif.get_ifd(0x8769)[int(tag[1:], 16)] = value
    Image.fromarray(np.full((32, 48), 99, np.uint8)).save(path, exif=exif)


@pytest.mark.parametrize("command", [["photo", "a.jpg", "silent.jpg", "b.jpg", *BALL[2:]],
                                     ["calibrate", "a.jpg", "silent.jpg", "b.jpg", *CALIBRATE[1:]]])  # fmt: skip
def test_mixed_zooms_and_sizes_are_refused(command, folder, capsys):
    write_jpeg("a.jpg", x920A=35.0)
    write_jpeg("silent.jpg")
    write_jpeg("b.jpg", x920A=50.0)
    assert run(*command) == 1
    words = "b.jpg: its EXIF tells the focal length as 50.0, and that of a.jpg as 35.0: one camera and one zoom"
    assert words in " ".join(capsys.readouterr().err.split())
    Image.fromarray(np.full((32, 40), 99, np.uint8)).save("b.jpg")
    assert run(*command) == 1
    assert "b.jpg has 40 x 32 pixels on the sensor and a.jpg 48 x 32" in " ".join(capsys.readouterr().err.split())


def test_several_refusals_are_one_message(folder, capsys):
    for name in ("a.png", "b.png"):
        Image.fromarray(np.full((40, 60), 99, np.uint8)).save(name)
    Path("out").mkdir()
    Path("out/located.json").write_text("{}")
    assert run("photo", "a.png", "b.png", *BALL[2:]) == 1
    message = " ".join(capsys.readouterr().err.split())
    assert message.count("error: ") == 1 and "a.png: 8 markers" in message and "b.png: 8 markers" in message
    assert sorted(path.name for path in Path("out").iterdir()) == ["located_a.png", "located_b.png"]
