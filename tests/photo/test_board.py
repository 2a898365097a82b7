"""Calibration boards and lengths: OpenCV finds what was written, sizes are true, what cannot be is refused in words."""

import io
import math
import re
import sys

import cv2
import numpy as np
import pytest
from command_line import run
from photographed_boards import PATTERN, charuco, write_board
from PIL import Image

from raytrace_jax import RaytraceError, load_scene
from raytrace_jax.photo.boards import Pattern, opencv, read_board
from raytrace_jax.report import board_sheet
from raytrace_jax.util.text import PAPERS, millimetres, with_tolerance

CAMERA = "settings main { model physical } camera eye { pixeldim 8 6 viewpoint 0 0 500 lookat 0 0 0 fov 40 }\n"
SMALL = Pattern(7, 5, 10)


def found_markers(picture, dictionary="DICT_5X5_1000"):
    """The corners of the markers that OpenCV finds in a grey picture, by their ids."""
    aruco = cv2.aruco
    markers = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    parameters.adaptiveThreshWinSizeMax = parameters.adaptiveThreshWinSizeMin = 23  # One pass: the light is even.
    corners, ids, _ = aruco.ArucoDetector(markers, parameters).detectMarkers(np.ascontiguousarray(picture))
    return {int(k): c.reshape(4, 2) for k, c in zip(np.ravel(ids), corners, strict=True)}


def check_markers(picture, pattern, pixels, corner=(0.0, 0.0)):
    """All markers are found, each within a tenth of a module of its place; `pixels` a square, `corner` the board's."""
    found = found_markers(picture)
    assert set(found) == set(range(pattern.markers))
    white = [(row, column) for row in range(pattern.rows) for column in range(pattern.columns) if (row + column) % 2]
    for number, (row, column) in enumerate(white):
        low, high = (1 - pattern.marker_share) / 2, (1 + pattern.marker_share) / 2
        places = np.array([(low, low), (high, low), (high, high), (low, high)])
        # OpenCV counts from the centre of the first pixel.
        expected = pixels * np.add(places, (column, row)) + corner - 0.5
        module = pixels * pattern.marker_share / 7
        assert np.abs(found[number] - expected).max() < 0.1 * module


def loaded(folder, blocks):
    (folder / "scene.txt").write_text(CAMERA + blocks)
    return load_scene(folder / "scene.txt")


def grey(path):
    picture = Image.open(path)
    assert picture.mode == "L"
    return np.asarray(picture)


@pytest.mark.parametrize(
    "pattern", [SMALL, Pattern(3, 4, 2), Pattern(6, 3, 8, 0.75), Pattern(5, 3, 8, 0.5, "DICT_4X4_50")]
)
def test_the_lattice_holds_every_cell(pattern):
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
    size = pattern.columns, pattern.rows
    board = cv2.aruco.CharucoBoard(size, pattern.square, pattern.marker, markers)
    side = 6 * pattern.lattice
    drawn = board.generateImage((size[0] * side, size[1] * side), marginSize=0, borderBits=1)
    np.testing.assert_array_equal(board_sheet.pattern_picture(pattern, 6), drawn)


def test_a_board_has_page_texture_and_blocks(tmp_path, capsys):
    path = tmp_path / "new" / "board.pdf"
    assert run("board", "-o", path) == 0
    texture = path.with_name("board_texture.png")
    printed = capsys.readouterr().out.splitlines()
    sizes = "27 x 17 squares of 10 mm, markers 7 mm, DICT_5X5_1000, on A4"
    assert printed == [str(path), str(path.with_suffix(".txt")), str(texture), sizes]
    assert {file.name for file in path.parent.iterdir()} == {"board.pdf", "board.txt", "board_texture.png"}
    pattern = Pattern(27, 17, 10)
    check_markers(grey(texture), pattern, 80)
    text = path.with_suffix(".txt").read_text()
    assert sizes in text and "millimetres" in text
    scene = loaded(path.parent, text)
    np.testing.assert_array_equal(scene["board.right"], [135, 0, 0])
    np.testing.assert_array_equal(scene["board.up"], [0, 85, 0])
    np.testing.assert_array_equal(np.asarray(scene.images.texels[0])[0], grey(texture) / 255)


@pytest.mark.parametrize("paper", PAPERS)
def test_the_same_board_is_the_same_file(paper, tmp_path):
    for name in ("a.pdf", "b.pdf"):
        assert run("board", "-o", tmp_path / name, "--paper", paper, "--square", "2cm", "--squares", 6, 4) == 0
    page, other = ((tmp_path / name).read_bytes() for name in ("a.pdf", "b.pdf"))
    assert page == other
    box = re.search(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", page)
    assert box and [float(side) for side in box.groups()] == pytest.approx([72 * s / 25.4 for s in PAPERS[paper]])


@pytest.mark.parametrize("square", [10, 0.8 * 25.4])
def test_the_page_is_decoded_at_true_size(square):
    pattern = Pattern(*board_sheet.squares_within(board_sheet.paper_room("a4"), square, None, "A4"), square)
    board_sheet.draw_sheet(pattern, "a4").savefig(file := io.BytesIO(), dpi=200, format="png")
    page = np.asarray(Image.open(file).convert("L"))
    scale = 200 / 25.4
    left = (PAPERS["a4"][0] - pattern.columns * square) / 2
    top = board_sheet.MARGIN + (board_sheet.paper_room("a4")[1] - pattern.rows * square) / 2
    # Matplotlib rounds a page to whole pixels, and counts places from its lower edge.
    shift = page.shape[0] - PAPERS["a4"][1] * scale
    check_markers(page, pattern, square * scale, (left * scale, top * scale + shift))
    # A black square has no hairlines, nor has a margin ink.
    at = np.array([left, top]) * scale + (0, shift)
    inner = page[
        round(at[1]) + 2 : round(at[1] + square * scale) - 2, round(at[0]) + 2 : round(at[0] + square * scale) - 2
    ]
    assert inner.size > 4000 and inner.max() == 0
    edge = math.floor(board_sheet.MARGIN * scale) - 3
    assert min(page[:edge].min(), page[-edge:].min(), page[:, :edge].min(), page[:, -edge:].min()) == 255


def test_the_ruler_is_100_mm_long():
    for paper in PAPERS:
        figure = board_sheet.draw_sheet(SMALL, paper)
        (ax,) = figure.axes
        line, *ticks = (np.asarray(segment) for ruler in ax.collections for segment in ruler.get_segments())
        assert np.ptp(line[:, 0]) == 100 and len(ticks) == 11
        np.testing.assert_allclose([tick[0, 0] - line[0, 0] for tick in ticks], np.arange(0, 101, 10))
        label, words = ax.texts
        assert label.get_text() == "check: 100 mm"
        assert words.get_text().startswith("raytrace-jax board: 7 x 5 squares of 10 mm, markers 7 mm, DICT_5X5_1000, ")
        assert words.get_text().endswith("; print at 100 %")
        for text in ax.texts:
            box = text.get_window_extent().transformed(ax.transData.inverted())
            assert (
                box.x1 < PAPERS[paper][0] - board_sheet.MARGIN and box.y1 < board_sheet.MARGIN + board_sheet.FOOTER - 2
            )


def test_a_screen_board_has_whole_pixels(tmp_path, capsys):
    path = tmp_path / "board.png"
    assert run("board", "-o", path, "--screen", "27in", "--pixels", 1280, 720, "--square", "25mm") == 0
    said = capsys.readouterr().out.splitlines()[-1]
    pitch = 27 * 25.4 / math.hypot(1280, 720)
    assert f"squares of {60 * pitch:.6g} mm" in said and said.endswith(
        "on a screen of 27in with 1280 x 720 pixels, 60 a square"
    )
    pattern = Pattern(20, 11, 60 * pitch)
    picture = grey(path)
    assert picture.shape == (720, 1280) and set(np.unique(picture)) == {0, 255}
    check_markers(picture, pattern, 60, (40, 30))
    check_markers(grey(tmp_path / "board_texture.png"), pattern, 80)
    scene = loaded(tmp_path, (tmp_path / "board.txt").read_text())
    assert float(scene["board.right.x"]) == pytest.approx(20 * 30 * pitch, rel=1e-9)
    assert float(scene["board.up.y"]) == pytest.approx(11 * 30 * pitch, rel=1e-9)


def test_a_large_screen_has_enough_markers(tmp_path, capsys):
    screen = "--screen", "27in", "--pixels", 2560, 1440
    assert run("board", "-o", tmp_path / "a.png", *screen) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("41 x 23 squares of 14.0092 mm")
    assert run("board", "-o", tmp_path / "b.png", *screen, "--square", "10mm") == 2
    assert "63 x 35 squares have 1102 markers, and DICT_5X5_1000 holds 1000: 60 x 33" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Pattern(3, 3, math.nan), "squares of nan mm"),
        (lambda: Pattern(3, 3, 1, 1.0), "a share between 0 and 1"),
        (lambda: Pattern(3, 3, 1, 0.7, "DICT_APRILTAG"), "one such as DICT_5X5_1000"),
        (lambda: Pattern(2002, 2, 1), "2002 x 2 squares have 2002 markers, .* holds 1000: 1000 x 2 squares fit"),
    ],
)
def test_a_pattern_that_cannot_be_is_refused(make, words):
    assert Pattern(29, 69, 1).markers == 1000  # As many as there are.
    with pytest.raises(RaytraceError, match=words):
        make()


def test_without_opencv_the_extra_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert run("board", "-o", tmp_path / "board.pdf") == 1
    assert "`board` needs OpenCV: pip install 'opencv-python-headless>=" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_bad_opencv_is_told(tmp_path, monkeypatch):
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1 is missing')")
    monkeypatch.delitem(sys.modules, "cv2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RaytraceError, match=r"cannot be loaded \(libGL\.so\.1 is missing\): pip install"):
        opencv("a board")
    old = type(sys)("cv2")
    old.__version__ = "4.5.0"
    monkeypatch.setitem(sys.modules, "cv2", old)
    with pytest.raises(RaytraceError, match=r"4\.10 or newer, and 4\.5\.0 is here"):
        opencv("a board")


def test_lengths_and_tolerances_are_read():
    lengths = {"10mm": 10, "1cm": 10, "0.4in": 10.16, " 1.5 CM ": 15, ".5m": 500, "250um": 0.25, "1e1mm": 10}
    for text, value in lengths.items():
        assert millimetres(text) == pytest.approx(value, rel=1e-12)
        assert with_tolerance(text) == (millimetres(text), 0)
    for text in ("40+-0.02mm", "40 mm +- 0.02 mm", "4cm+-0.02mm", "40mm±20um", "40+/-0.02mm"):
        assert with_tolerance(text) == pytest.approx((40, 0.02), rel=1e-12)
    assert with_tolerance("40+-0mm") == (40, 0)


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (millimetres, "ten", "'ten' came, and a length with its unit is wanted, as 10mm, 1cm or 0.4in"),
        (millimetres, "10", "'10': it has no unit"),
        (millimetres, "10ell", "'10ell': the unit 'ell' is unknown, .*; units are mm, cm, m, um, µm, in"),
        (millimetres, "0mm", "'0mm' came, and a length greater than 0 is wanted"),
        (millimetres, "10mm+-1mm", "a length with its unit is wanted"),
        (with_tolerance, "40+-0.02", "'40.-0.02': it has no unit, and a length and its standard deviation are wanted"),
        (with_tolerance, "40+-1mm+-1mm", "with one"),
        (with_tolerance, "40+--1mm", "a standard deviation is 0 or greater"),
    ],
)
def test_what_is_no_length_is_refused(read, text, words):
    with pytest.raises(RaytraceError, match=words):
        read(text)


def test_a_board_is_read_as_the_pattern(board):
    assert board.dictionary == PATTERN.dictionary and board.square == pytest.approx(PATTERN.square, rel=1e-3)
    np.testing.assert_allclose(board.half, [70, 50])
    assert set(board.ids.tolist()) == set(range(PATTERN.markers))
    white = [(row, column) for row in range(PATTERN.rows) for column in range(PATTERN.columns) if (row + column) % 2]
    low, high = 0.15, 0.85
    for number, corners in zip(board.ids, board.markers, strict=True):
        row, column = white[number]
        wanted = np.array([(column + x, row + y) for x, y in [(low, low), (high, low), (high, high), (low, high)]])
        # OpenCV finds whole pixels without refinement, and one pixel of the texture is 0.125 mm.
        np.testing.assert_allclose(corners, (wanted * PATTERN.square - board.half) * [1, -1], atol=0.01)
    inner = [(10 * x - 70, 10 * y - 50) for x in range(1, PATTERN.columns) for y in range(1, PATTERN.rows)]
    assert len(board.corners) == len(inner)
    order = np.lexsort(np.round(board.corners).T)
    np.testing.assert_allclose(board.corners[order], sorted(inner, key=lambda at: (at[1], at[0])), atol=0.01)
    # Squares begin with a black one at the upper left; beyond the border there is nothing.
    np.testing.assert_array_equal(
        board.brightness(np.array([[-69.5, 49.5], [-59.5, 49.5], [-70.5, 0]])), [0, 1, np.nan]
    )


def test_a_file_without_a_board_is_refused(tmp_path):
    (tmp_path / "ball.txt").write_text("material m { emission 1 1 1 } sphere a { material m center 0 0 0 radius 1 }")
    with pytest.raises(RaytraceError, match=r"ball\.txt: has 0 pictures and 0 rectangles.*raytrace-jax board"):
        read_board(tmp_path / "ball.txt")
    path = write_board(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("right 70 ", "right 80 "))
    with pytest.raises(RaytraceError, match=r"markers would be 8 wide and 7 high: the rectangle has other proportions"):
        read_board(path)
    path.write_text(text.replace("board_texture", "gone_texture"))
    with pytest.raises(RaytraceError, match="gone_texture"):
        read_board(path)


def grid_of_markers():
    """OpenCV's picture of a board of markers without squares."""
    board = cv2.aruco.GridBoard((6, 4), 30.0, 10.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    return board.generateImage((680, 460), marginSize=20)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (charuco(8, 6, "DICT_APRILTAG_36h11"), "0 markers of the sets that are read, DICT_4X4"),
        (grid_of_markers(), "24 markers of DICT_4X4_1000 that no squares lie between: it is no ChArUco board"),
        (np.full((80, 112), 255, np.uint8), "its picture shows 0 markers.*raytrace-jax board"),
        (charuco(5, 4, "DICT_5X5_50"), "too small: 12 corners lie between the squares of its 10 markers, and 20 are"),
    ],
)
def test_an_unusable_board_says_why(picture, words, tmp_path):
    path = write_board(tmp_path)
    Image.fromarray(picture).save(tmp_path / "board_texture.png")
    height, width = picture.shape
    path.write_text(
        "texture t { kind image file board_texture.png transfer course filter nearest }"
        "material p { emission 1 1 1 texture t }"
        f"rectangle b {{ material p center 0 0 0 right {width} 0 0 up 0 {height} 0 }}"
    )
    with pytest.raises(RaytraceError, match=rf"board\.txt: .*{words}"):
        read_board(path)
