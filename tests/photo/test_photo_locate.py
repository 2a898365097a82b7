"""From a photograph that the package itself made to camera, ball and index; and pictures that show no such thing."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cv2 import aruco
from PIL import Image
from scipy import ndimage

from raytrace_jax import (
    FitOptions,
    FitResult,
    PictureError,
    RaytraceError,
    RenderSettings,
    build,
    get_parameter,
    make_scene,
    read_exr,
    render,
    write_png,
)
from raytrace_jax.cli import main
from raytrace_jax.images.exif import TURNS
from raytrace_jax.photo.alignment import align
from raytrace_jax.photo.board_pattern import Pattern
from raytrace_jax.photo.boards import read_board
from raytrace_jax.photo.bundle import TRUE_TO, Corners, PhotoView
from raytrace_jax.photo.calibrate import calibrate
from raytrace_jax.photo.find_ball import find_ball
from raytrace_jax.photo.find_camera import FoundCamera, photograph_of, step_scales
from raytrace_jax.photo.flattened import flatten
from raytrace_jax.photo.lens import LensPrior, turned, uncalibrated
from raytrace_jax.photo.locate import NotLocated, locate
from raytrace_jax.photo.outline import Disc, find_discs
from raytrace_jax.photo.room_scene import FREE, UNCERTAIN, room_scene
from raytrace_jax.photo.sight import Sight
from raytrace_jax.report.board_sheet import board_blocks, pattern_picture

WIDTH, HEIGHT = 640, 480
VIEWPOINT, LOOKAT, UP, FOV = (60.0, -45.0, 262.0), (2.0, 1.0, 0.0), (0.05, 1.0, 0.0), 35.0
INDEX, CENTER, RADIUS = 1.5, (4.0, -3.0, 65.0), 20.0
BLUR, NOISE = 0.8, 0.003
PATTERN = Pattern(14, 10, 10.0)


def write_board(folder, pattern=PATTERN, name="board"):
    """The board's blocks and their picture, as `raytrace-jax board` writes them beside its page."""
    Image.fromarray(pattern_picture(pattern)).save(folder / f"{name}_texture.png")
    (folder / f"{name}.txt").write_text(board_blocks(pattern, f"{name}_texture.png", "A4"))
    return folder / f"{name}.txt"


def seen_by(camera, board, *shapes):
    """A scene-linear picture of a board that shines by itself before a grey room."""
    half = board.half
    scene = make_scene(
        build.settings("main", model="physical", mapping="center"),
        build.camera("eye", pixeldim=(WIDTH, HEIGHT), **camera),
        build.background("room", radiance=(0.3, 0.3, 0.3)),
        build.texture("print", kind="image", file=np.repeat(0.05 + 0.9 * board.texture[None], 3, axis=0)),
        build.material("paper", emission=(1, 1, 1), texture="print"),
        build.material("glass", transmission=1, ior=INDEX),
        build.rectangle("board", material="paper", center=(0, 0, 0), right=(half[0], 0, 0), up=(0, half[1], 0)),
        *shapes,
    )
    return np.asarray(render(scene, RenderSettings(samples=2, max_bounces=6)).image, np.float64)


def taken(picture, seed):
    """As a camera has it: blurred, under a light that falls off by a third, with noise of a few grey levels."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    light = 0.75 - 0.18 * (column / WIDTH - 0.5) - 0.1 * (row / HEIGHT - 0.5) - 0.1 * (column / WIDTH - 0.4) ** 2
    blurred = ndimage.gaussian_filter(picture, (0, BLUR, BLUR))
    noise = NOISE * np.random.default_rng(seed).normal(size=picture.shape)
    return np.clip(blurred * light + noise, 0, 1)


CAMERA = {"viewpoint": VIEWPOINT, "lookat": LOOKAT, "up": UP, "fov": FOV}


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    return read_board(write_board(tmp_path_factory.mktemp("board")))


@pytest.fixture(scope="module")
def wide_board(tmp_path_factory):
    return read_board(write_board(tmp_path_factory.mktemp("wide"), Pattern(28, 20, 10.0)))


@pytest.fixture(scope="module")
def image(board):
    return taken(seen_by(CAMERA, board, build.sphere("ball", material="glass", center=CENTER, radius=RADIUS)), 1)


@pytest.fixture(scope="module")
def located(image, board):
    return locate(photograph_of(image, "ball"), board, (RADIUS, 0.0), uncalibrated())


def test_a_board_that_is_read_has_its_markers_and_corners_where_the_pattern_has_them(board):
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
    (tmp_path / "ball.txt").write_text(
        "material glass { emission 1 1 1 } sphere a { material glass center 0 0 0 radius 1 }"
    )
    with pytest.raises(RaytraceError, match=r"ball\.txt: has 0 pictures and 0 rectangles.*raytrace-jax board"):
        read_board(tmp_path / "ball.txt")
    path = write_board(tmp_path)
    Image.fromarray(np.full((80, 112), 255, np.uint8)).save(tmp_path / "board_texture.png")
    with pytest.raises(RaytraceError, match=r"board\.txt: its picture shows 0 markers.*raytrace-jax board"):
        read_board(path)
    path.write_text(path.read_text().replace("board_texture", "gone_texture"))
    with pytest.raises(RaytraceError, match="gone_texture"):
        read_board(path)


def charuco(columns, rows, dictionary, is_legacy=False):
    markers = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    board = aruco.CharucoBoard((columns, rows), 30.0, 21.0, markers)
    board.setLegacyPattern(is_legacy)
    return board.generateImage((columns * 60, rows * 60))


def grid_of_markers():
    """OpenCV's picture of a board of markers without squares."""
    board = aruco.GridBoard((6, 4), 30.0, 10.0, aruco.getPredefinedDictionary(aruco.DICT_4X4_50))
    return board.generateImage((680, 460), marginSize=20)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (charuco(8, 6, "DICT_APRILTAG_36h11"), r"0 markers of the sets that are read, DICT_4X4.* 24 of .*LTAG_36h11, "),
        (charuco(8, 6, "DICT_ARUCO_ORIGINAL"), "24 of DICT_ARUCO_ORIGINAL, which is none of these"),
        (grid_of_markers(), "24 markers of DICT_4X4_1000 that no squares lie between: it is no ChArUco board"),
        (charuco(5, 4, "DICT_5X5_50"), "too small: 12 corners lie between the squares of its 10 markers, and 20 are"),
    ],
)
def test_a_board_that_cannot_be_used_says_why(picture, words, tmp_path):
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


def test_a_board_that_is_stretched_is_refused(tmp_path):
    path = write_board(tmp_path)
    path.write_text(path.read_text().replace("right 70 ", "right 80 "))
    with pytest.raises(RaytraceError, match=r"markers would be 8 wide and 7 high: the rectangle has other proportions"):
        read_board(path)


@pytest.mark.slow
def test_the_index_and_the_place_of_the_ball_are_found_within_their_errors(located):
    index, error = located.index
    assert abs(index - INDEX) < 2e-3 and abs(index - INDEX) < 4 * error and error < 5e-3
    off, errors = located.numbers[12:15] - CENTER, np.sqrt(np.diagonal(located.covariance)[12:15])
    assert np.all(np.abs(off) < 4 * errors) and np.all(np.abs(off) < 1), "millimetres, of 262 to the camera"
    assert located.numbers[15] == RADIUS and located.covariance[15, 15] == 0, "it is known exactly"
    assert len(located.direct.pixels) > 50 and len(located.through.pixels) > 20
    # The noise moves a corner by hundredths of a pixel, and none is believed to less than `TRUE_TO`.
    assert TRUE_TO <= located.sigma[0] < 0.06 and TRUE_TO <= located.sigma[1] < 0.1
    assert abs(located.blur - BLUR) <= 0.25, "the next of `alignment.BLURS`; a pixel's own width adds to it"


@pytest.mark.slow
def test_the_camera_is_found_within_its_errors(located):
    errors = np.sqrt(np.diagonal(located.covariance))
    assert abs(located.numbers[6] - FOV) < 4 * errors[6] and abs(located.numbers[6] - FOV) < 0.5
    assert np.all(np.abs(located.numbers[7:9]) < 4 * errors[7:9]), "there is no distortion"
    assert np.linalg.norm(located.sight.viewpoint - VIEWPOINT) < 3
    # Wherever camera and ball are together, the outline is where it was.
    toward = np.subtract(CENTER, VIEWPOINT) / np.linalg.norm(np.subtract(CENTER, VIEWPOINT))
    found = located.numbers[12:15] - located.sight.viewpoint
    assert np.degrees(np.arccos(found @ toward / np.linalg.norm(found))) < 0.1


@pytest.mark.slow
def test_the_scene_of_the_flattened_photograph_looks_like_it(image, located):
    flat = flatten(image, located)
    room = room_scene(located, flat)
    assert flat.counts.shape == flat.image.shape[1:] == (flat.grid.window[3], flat.grid.window[2])
    assert flat.through.sum() > 2000 and not np.any(flat.through & ~flat.counts)
    for name in FREE:
        get_parameter(room.scene, name)
    assert set(room.uncertain) == set(UNCERTAIN) - {"ball.radius"}, "it is known exactly"
    assert all(np.isfinite(get_parameter(room.scene, name)) for name in room.uncertain)
    assert all(spread > 0 for spread in room.uncertain.values())
    assert all(set(pair) <= set(room.uncertain) and abs(r) < 1 + 1e-9 for pair, r in room.correlations.items())
    # The ink is 0.05 of 0.95, but the glass has lost some light by reflection at both of its sides, 8 %.
    np.testing.assert_allclose(flat.field.ink, 0.05 / 0.95, atol=0.02)
    picture = np.asarray(render(room.scene, RenderSettings(crop=flat.grid.window)).image)
    off = (picture - flat.image)[:, flat.counts]
    assert np.sqrt(np.mean(off**2)) < 0.1, "of paper"


@pytest.mark.slow
def test_three_pictures_without_the_ball_calibrate_the_lens_however_the_camera_was_turned(board):
    sides = [(120.0, 20.0, 190.0), (-110.0, 60.0, 190.0), (10.0, -140.0, 180.0)]
    aside = {"lookat": (0.0, 0.0, 0.0), "center": ((WIDTH - 1) / 2 + 0.01 * WIDTH, (HEIGHT - 1) / 2 - 0.008 * WIDTH)}
    stored = [taken(seen_by(CAMERA | {"viewpoint": side} | aside, board), 3) for side in sides]
    pictures = [
        photograph_of(np.moveaxis(TURNS[turn](np.moveaxis(image, 0, -1)), -1, 0), f"turn {turn}", turn)
        for turn, image in zip((1, 3, 6), stored, strict=True)
    ]
    found = calibrate(pictures, board)
    errors = np.sqrt(np.diagonal(found.lens.covariance))
    assert np.all(np.abs(found.lens.mean - [FOV, 0, 0, 0.01, -0.008]) < 4 * errors) and errors[0] < 0.2
    assert np.all(errors[3:] < 1e-3)
    assert found.size == (WIDTH, HEIGHT) and len(found.each) == len(found.sigma) == 3


def test_a_grey_picture_is_refused_with_what_to_do(board):
    with pytest.raises(PictureError, match=r"grey: 8 markers of .*board\.txt are wanted, and 0 are found.*nearer"):
        locate(photograph_of(np.full((3, HEIGHT, WIDTH), 0.5), "grey"), board, (RADIUS, 0.0), uncalibrated())
    with pytest.raises(PictureError, match="black: 8 markers"):
        locate(photograph_of(np.zeros((3, HEIGHT, WIDTH)), "black"), board, (RADIUS, 0.0), uncalibrated())


def flat_picture(pattern, scale=2):
    """A board as a scanner sees it, amid white."""
    picture = np.pad(pattern_picture(pattern, scale) / 255.0, 20, constant_values=1.0)
    return np.repeat(0.05 + 0.9 * picture[None], 3, axis=0)


@pytest.mark.slow
def test_a_board_of_another_dictionary_is_named(board):
    other = photograph_of(flat_picture(Pattern(8, 6, 10.0, dictionary="DICT_6X6_250")), "other")
    with pytest.raises(PictureError, match=r"other: .*it shows \d+ markers of DICT_6X6_1000, .*those of DICT_5X5_1000"):
        locate(other, board, (RADIUS, 0.0), uncalibrated())


@pytest.mark.parametrize(
    ("picture", "share"),
    [(charuco(14, 10, "DICT_5X5_1000", is_legacy=True), 0), (charuco(15, 10, "DICT_5X5_1000"), 52)],
)
def test_a_board_whose_markers_lie_elsewhere_is_another_one(picture, share, board):
    light = np.repeat(np.pad(picture, 20, constant_values=255)[None] / 255.0, 3, axis=0)
    other = photograph_of(light, "other")
    words = rf"other: of the neighbours of its \d+ markers {share}% lie where .*board\.txt has them: another board"
    with pytest.raises(PictureError, match=words):
        locate(other, board, (RADIUS, 0.0), uncalibrated())
    with pytest.raises(PictureError, match=words):
        calibrate([other] * 3, board)


@pytest.mark.parametrize("turn", [np.s_[:, :, ::-1], np.s_[:, ::-1]], ids=["left-right", "top-bottom"])
def test_a_mirrored_picture_is_said_to_be_one(turn, board):
    mirrored = photograph_of(flat_picture(PATTERN)[turn], "mirrored")
    with pytest.raises(PictureError, match=r"mirrored: 8 markers .* and 0 are found, but 70 in its mirror image"):
        locate(mirrored, board, (RADIUS, 0.0), uncalibrated())
    with pytest.raises(PictureError, match=r"mirrored: .* mirror the file back, as by `magick FILE -flop FILE`"):
        calibrate([mirrored] * 3, board)


def test_too_few_pictures_or_pictures_of_two_sizes_are_no_calibration(board):
    picture = photograph_of(flat_picture(PATTERN), "flat")
    with pytest.raises(PictureError, match="2 pictures are too few for a calibration: 3 are wanted"):
        calibrate([picture, picture], board)
    turned = photograph_of(flat_picture(PATTERN).swapaxes(1, 2), "turned")
    with pytest.raises(PictureError, match=r"turned has .* flat .*EXIF has to say so"):
        calibrate([picture, turned, picture], board)


def found_cameras(monkeypatch, lens_of):
    """Cameras that see the board's plane from several sides in place of those that are found."""
    places = np.stack(np.meshgrid(np.arange(-60, 61, 15.0), np.arange(-45, 46, 15.0)), -1).reshape(-1, 2)
    sides = iter((0.5, -0.5, 0.4, -0.3))

    def find(photograph, *_):
        lens = turned(lens_of(photograph), photograph.orientation, photograph.size_on_sensor)
        numbers = np.concatenate([[np.pi, next(sides), 0.3, 0, 0, 250], lens.mean, [1.5, 0, 0, 0, 1]])
        corners = Corners(Sight(numbers, photograph.size).where(places), places, np.full(len(places), 0.01))
        scale = np.where(np.arange(16) < 11, step_scales(numbers, (0.0, 0.0), lens), 0)
        covariance = np.eye(16)
        covariance[6:11, 6:11] = lens.covariance
        return FoundCamera(PhotoView(numbers, scale, photograph.size, corners, Corners.none()), covariance, 0.5, 0.03)

    monkeypatch.setattr("raytrace_jax.photo.calibrate.find_camera", find)
    monkeypatch.setattr("raytrace_jax.photo.calibrate.find_markers", lambda *_: None)


LENS = LensPrior(np.array([41.3, -0.02, 0.004, 0.007, -0.003]), 1e-8 * np.eye(5))


@pytest.mark.parametrize("turns", [(1, 3, 6, 8), (6, 6, 6), (2, 4, 5, 7), (8, 1, 1)])
def test_a_lens_is_the_same_on_the_sensor_however_the_camera_was_turned(turns, board, monkeypatch):
    found_cameras(monkeypatch, lambda _: LENS)
    shapes = [(3, WIDTH, HEIGHT) if turn > 4 else (3, HEIGHT, WIDTH) for turn in turns]
    pictures = [photograph_of(np.ones(shape), str(turn), turn) for shape, turn in zip(shapes, turns, strict=True)]
    found = calibrate(pictures, board)
    assert found.size == (WIDTH, HEIGHT)
    np.testing.assert_allclose([one.mean for one in found.each], [LENS.mean] * len(turns), rtol=1e-9)
    # What lenses usually are has its part, too.
    assert np.all(np.abs(found.lens.mean - LENS.mean) < 0.1 * np.sqrt(np.diagonal(found.lens.covariance)))


def test_a_picture_by_another_zoom_is_refused_by_name(board, monkeypatch):
    found_cameras(
        monkeypatch, lambda photograph: LENS._replace(mean=LENS.mean * (1.1 if photograph.name == "c" else 1))
    )
    pictures = [photograph_of(np.ones((3, HEIGHT, WIDTH)), name) for name in "abcd"]
    with pytest.raises(PictureError, match=r"c: it tells an angle of view of 45\.\d.* others one of 41\.\d.* one zoom"):
        calibrate(pictures, board)


DRAWN = np.array([np.pi, 0, 0, 0, 0, 600.0, 40.0, 0, 0, 0, 0, INDEX, 0, 0, 60, RADIUS])
"""A camera straight before the board's middle, and a ball."""


def test_corners_of_a_level_picture_are_measured_to_a_hundredth_of_a_pixel(board):
    """The board straight ahead, whose edges lie along the pixels' sides, drawn with 256 rays each."""
    sight = Sight(DRAWN, (WIDTH, HEIGHT))
    expected = sight.where(board.corners)
    chosen = np.all(np.abs(expected - (WIDTH / 2, HEIGHT / 2)) < 50, axis=1)
    first, last = np.array([WIDTH, HEIGHT]) // 2 - 90, np.array([WIDTH, HEIGHT]) // 2 + 90
    # A plane straight ahead is seen at one scale.
    scale = np.diff(sight.where(np.array([[0.0, 0.0], [1.0, 0.0]])), axis=0)[0, 0]
    middle = sight.where(np.zeros((1, 2)))[0]
    x, y = ((np.arange(16 * 180) + 0.5) / 16 - 0.5 + first[k] - middle[k] for k in range(2))
    aside = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 16 * 180)) / 16
    fine = board.brightness(np.stack([x + aside[0][:, None], -(y[:, None] + aside[1])], -1) / scale)
    light = np.full((HEIGHT, WIDTH), 0.5)
    light[first[1] : last[1], first[0] : last[0]] = fine.reshape(180, 16, 180, 16).mean(axis=(1, 3))
    light = ndimage.gaussian_filter(light, BLUR)
    found = align(light, board, board.corners[chosen], expected[chosen], sight.directly, BLUR)
    assert found.good.all() and chosen.sum() > 20
    off = found.pixels - expected[chosen]
    assert np.max(np.abs(off)) < 0.02, off


def drawn(board, *balls, hides=lambda column, row: {}, light=1.0):
    """The board with balls before it, as `DRAWN` sees it, in some light; then what hides parts of it, by its grey."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.stack([column, row], -1).reshape(-1, 2).astype(float)
    seen, _ = Sight(DRAWN, (WIDTH, HEIGHT)).directly(pixels)
    picture = np.nan_to_num(board.brightness(seen), nan=0.4) * np.broadcast_to(light, (HEIGHT, WIDTH)).reshape(-1)
    for x, y in balls:
        ball = Sight(with_center(x, y), (WIDTH, HEIGHT)).through(pixels)
        through = np.where(ball.valid, np.nan_to_num(board.brightness(ball.place), nan=0.4), 0.3)
        picture = np.where(ball.reach < 1, 0.85 * through, picture)
    picture = picture.reshape(HEIGHT, WIDTH)
    for grey, where in hides(column, row).items():
        picture = np.where(where, grey, picture)
    return ndimage.gaussian_filter(picture, BLUR)


def with_center(x, y):
    numbers = np.array(DRAWN)
    numbers[12:14] = x, y
    return numbers


def found_ball(light, board, name="drawn"):
    """The numbers of the ball in a drawn picture, of which only the radius is known."""
    blank = np.array(DRAWN)
    blank[11:15] = 1.5, 0, 0, 0
    return find_ball(light, board, blank, BLUR, name, find_discs(light, board, blank, BLUR, name))


POSTS = {
    "no": lambda column, row: {},
    "a thick dark": lambda column, row: {0.15: (np.abs(column - 338) < 16) & (row > 268)},
    "a thick bright": lambda column, row: {0.8: (np.abs(column - 338) < 16) & (row > 268)},
    "a thin grey": lambda column, row: {0.5: (np.abs(column - 339) < 5) & (row > 262)},
    "a ring's": lambda column, row: {0.1: (np.abs(column - 337) < 22) & (np.abs(row - 273) < 6)},
    "a hand's": lambda column, row: {
        0.5: (np.abs(np.abs(column - 337) - 39) < 5) & (row > 246) & (row < 292)
        | (np.abs(column - 337) < np.where(row < 300, 44, 16)) & (row > 288)
    },
}


def on_a_post(board, post):
    """A ball on a post, its right side before a shadow; and its numbers."""
    column = np.arange(WIDTH)[None] - 380.0
    light = 1 - 0.55 * np.exp(-((np.abs(column) / 30) ** 6)) * np.ones((HEIGHT, 1))
    return drawn(board, (11, -4), hides=POSTS[post], light=light), with_center(11, -4)


@pytest.mark.slow
@pytest.mark.parametrize("post", POSTS)
def test_a_ball_is_found_on_a_post_and_beside_a_shadow(post, wide_board):
    picture, wanted = on_a_post(wide_board, post)
    found = found_ball(picture, wide_board)
    (center, radius), (at, size) = (Sight(one, (WIDTH, HEIGHT)).outline for one in (wanted, found))
    assert np.hypot(*(at - center)) < 0.03 * radius
    assert abs(size / radius - 1) < 0.05, "the outline tells the distance to some per cent"
    assert abs(found[11] - INDEX) < 0.2, "and with it where the index begins"


@pytest.mark.slow
def test_two_balls_are_refused_with_their_places(wide_board):
    with pytest.raises(PictureError, match=r"two: the board is seen through two balls, at column \d+, row 2\d\d, with"):
        found_ball(drawn(wide_board, (-30, 0), (30, 5)), wide_board, "two")


@pytest.mark.slow
def test_without_a_ball_the_sizes_are_told_that_it_could_have(wide_board):
    with pytest.raises(PictureError, match=r"none: there is no ball before the board: .* radius of \d+ to \d+ pixels"):
        found_ball(drawn(wide_board), wide_board, "none")


@pytest.mark.slow
def test_a_refused_photograph_says_where_the_ball_was_taken_to_be_and_it_can_be_stated(image, board):
    wrong = Disc(np.array([200.0, 200.0]), 50.0)
    with pytest.raises(NotLocated, match=r"taken to be at column 200, row 200, .* 50 pixels; --ball X Y R") as refused:
        locate(photograph_of(image, "ball"), board, (RADIUS, 0.0), uncalibrated(), wrong)
    taken = refused.value.taken
    assert len(taken.direct.pixels) > 50 and len(taken.markers) > 20 and taken.discs == [wrong]


@pytest.mark.slow
def test_a_photograph_is_fitted_to_the_end_of_its_report(image, tmp_path, monkeypatch, capsys):
    write_png(tmp_path / "ball.png", image, transfer="srgb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("raytrace_jax.photo.room_scene.FitOptions", partial(FitOptions, max_steps=1))
    lengths = ["--radius", "20+-0.01mm", "--ruler", "100+-0.01mm"]
    board = str(write_board(tmp_path))
    assert main(["photo", "ball.png", "--board", board, *lengths, "-o", "out", "--fit"]) in (0, 3)
    assert "error" not in capsys.readouterr().err
    written = {path.name for path in Path("out").iterdir()}
    assert {"located.png", "scene.txt", "report.html", "fit.exr", "fit.print.exr", "joined.json"} <= written
    corners = json.loads(Path("out/located.json").read_text())["parameters"]["index"]["error"]
    index, error = json.loads(Path("out/joined.json").read_text())["ior"]
    assert error <= corners and abs(index - INDEX) < 4 * error
    assert abs(FitResult.load("out")["ball.ior"].value - INDEX) < 0.01
    made = read_exr("out/fit.exr").metadata["scene"]
    assert made == Path("out/fit.txt").read_text() and "fit.print.exr" in made
