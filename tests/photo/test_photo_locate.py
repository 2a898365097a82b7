"""From a photograph that the package itself made to camera, ball and index; and pictures that show no such thing."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import photographed_boards as boards
import pytest
from photographed_boards import BLUR, CAMERA, HEIGHT, INDEX, RADIUS, SIZE, WIDTH, charuco, locate
from scipy import ndimage

from raytrace_jax import FitOptions, FitResult, PictureError, RenderSettings, build, read_exr, render, write_png
from raytrace_jax.cli import main
from raytrace_jax.photo.alignment import align
from raytrace_jax.photo.bundle import CORNER_FLOOR
from raytrace_jax.photo.find_ball import find_ball
from raytrace_jax.photo.find_camera import calibrate
from raytrace_jax.photo.flattened import flatten
from raytrace_jax.photo.geometry import Ball, Camera, Setup
from raytrace_jax.photo.lens import uncalibrated
from raytrace_jax.photo.locate import locate_together
from raytrace_jax.photo.outline import Disc, find_discs
from raytrace_jax.photo.photograph import Photograph, photograph_of
from raytrace_jax.photo.room_scene import HELD, room_scene
from raytrace_jax.photo.sight import Projection

VIEWPOINT, CENTER = CAMERA["viewpoint"], (4.0, -3.0, 65.0)


@pytest.fixture(scope="module")
def image(board):
    ball = build.sphere("ball", material="glass", center=CENTER, radius=RADIUS)
    return boards.taken(boards.seen_by(CAMERA, board, ball), 1)


@pytest.fixture(scope="module")
def located(image, board):
    return locate(photograph_of(image, "ball"), board, {"radius": (RADIUS, 0.0)}, uncalibrated())


@pytest.mark.slow
def test_the_ball_is_found_within_errors(located):
    index, error = located.ior
    assert abs(index - INDEX) < 2e-3 and abs(index - INDEX) < 4 * error and error < 5e-3
    off = located.setup.glass.center - CENTER
    assert np.all(np.abs(off) < np.minimum(4 * located.errors.glass.center, 1)), "millimetres, of 262 to the camera"
    assert located.setup.glass.radius == RADIUS and located.errors.glass.radius == 0, "it is known exactly"
    assert len(located.direct.pixels) > 50 and len(located.through.pixels) > 20
    # The noise moves a corner by hundredths of a pixel, and none is believed to less than the floor.
    assert CORNER_FLOOR <= located.sigma[0] < 0.06 and CORNER_FLOOR <= located.sigma[1] < 0.1
    assert abs(located.blur - BLUR) <= 0.25, "the next that is tried; a pixel's own width adds to it"
    setup, errors = located.setup, located.errors
    assert abs(setup.camera.fov - boards.FOV) < min(4 * errors.camera.fov, 0.5)
    assert np.all(np.abs(setup.camera.distortion) < 4 * errors.camera.distortion), "there is no distortion"
    assert np.linalg.norm(located.sight.viewpoint - VIEWPOINT) < 3
    # Wherever camera and ball are together, the outline is where it was.
    toward = np.subtract(CENTER, VIEWPOINT) / np.linalg.norm(np.subtract(CENTER, VIEWPOINT))
    found = setup.glass.center - located.sight.viewpoint
    assert np.degrees(np.arccos(found @ toward / np.linalg.norm(found))) < 0.1


@pytest.mark.slow
def test_the_scene_looks_like_the_photograph(image, located):
    flat = flatten(image, located)
    room = room_scene([located], [flat], [np.eye(len(located.covariance))], located.covariance)
    assert flat.counts.shape == flat.image.shape[1:] == (flat.grid.window[3], flat.grid.window[2])
    assert flat.through.sum() > 2000 and not np.any(flat.through & ~flat.counts)
    for name in (*room.free, *room.held):
        room.scene[name]
    assert set(room.glass) <= {name for free in room.free for name in (free, *(f"{free}.{axis}" for axis in "xyz"))}
    assert set(room.uncertain) == set(HELD) - {"ball.radius"}, "it is known exactly"
    assert all(np.isfinite(room.scene[name]) for name in room.uncertain)
    assert all(spread > 0 for spread in room.uncertain.values())
    assert all(set(pair) <= set(room.uncertain) and abs(r) < 1 + 1e-9 for pair, r in room.correlations.items())
    # The ink is 0.05 of 0.95, but the glass has lost some light by reflection at both of its sides, 8 %.
    np.testing.assert_allclose(flat.field.ink, 0.05 / 0.95, atol=0.02)
    picture = np.asarray(render(room.scene, RenderSettings(crop=flat.grid.window)).image)
    off = (picture - flat.image)[:, flat.counts]
    assert np.sqrt(np.mean(off**2)) < 0.1, "of paper"


@pytest.mark.slow
def test_each_of_several_photographs_is_shown_its_own_board(image, located):
    flat = flatten(image, located)
    # The second one's place is its own; glass, radius and lens are common.
    count = len(located.covariance)
    is_own = np.array([number.is_own for number in located.setup.numbers])
    chains = np.zeros((2, count, count + is_own.sum()))
    chains[:, ~is_own, np.flatnonzero(~is_own)] = 1
    chains[0, is_own, np.flatnonzero(is_own)] = chains[1, is_own, np.arange(count, count + is_own.sum())] = 1
    whole = np.zeros((count + is_own.sum(),) * 2)
    whole[:count, :count] = located.covariance
    whole[count:, count:] = located.covariance[np.ix_(is_own, is_own)]
    one = room_scene([located], [flat], [np.eye(count)], located.covariance)
    two = room_scene([located] * 2, [flat] * 2, chains, whole)
    assert two.scene.cameras == tuple(two.shown) == ("eye1", "eye2")
    assert two.glass == ("glass.ior", *(f"ball{k}.center.{axis}" for k in (1, 2) for axis in "xyz"))
    np.testing.assert_allclose(two.told[4:], two.told[1:4] + two.scene["board2.center"])
    np.testing.assert_allclose(two.covariance[:4, :4], one.covariance[:4, :4], rtol=1e-9)
    assert two.correlations["eye1.distortion.k1", "eye2.distortion.k1"] == pytest.approx(1)
    settings = RenderSettings(crop=flat.grid.window)
    wanted = np.asarray(render(one.scene, settings).image)
    for camera in two.scene.cameras:
        for scene in (two.shown[camera], two.scene.seen_by(camera)):
            np.testing.assert_allclose(np.asarray(render(scene, settings).image), wanted, atol=1e-6)


@pytest.mark.parametrize("light", [0.5, 0.0])
def test_a_grey_picture_is_refused(light, board):
    with pytest.raises(PictureError, match=r"grey: 8 markers of .*board\.txt are wanted, and 0 are found.*nearer"):
        locate(
            photograph_of(np.full((3, HEIGHT, WIDTH), light), "grey"), board, {"radius": (RADIUS, 0.0)}, uncalibrated()
        )


@pytest.mark.parametrize(
    ("picture", "share"),
    [(charuco(14, 10, "DICT_5X5_1000", is_legacy=True), 0), (charuco(15, 10, "DICT_5X5_1000"), 52)],
)
def test_misplaced_markers_are_another_board(picture, share, board):
    light = np.repeat(np.pad(picture, 20, constant_values=255)[None] / 255.0, 3, axis=0)
    words = rf"other: of the neighbours of its \d+ markers {share}% lie where .*board\.txt has them: another board"
    with pytest.raises(PictureError, match=words):
        calibrate([photograph_of(light, "other")] * 3, board)


@pytest.mark.parametrize("turn", [np.s_[:, :, ::-1], np.s_[:, ::-1]], ids=["left-right", "top-bottom"])
def test_a_mirrored_picture_is_told(turn, board):
    mirrored = photograph_of(boards.flat_picture(boards.PATTERN)[turn], "mirrored")
    words = r"mirrored: 8 markers .* and 0 are found, but more in its mirror image: mirror it back"
    with pytest.raises(PictureError, match=words):
        calibrate([mirrored] * 3, board)


DRAWN = Setup(Camera([np.pi, 0, 0], [0, 0, 600.0], 40.0), Ball(INDEX, [0, 0, 60], RADIUS))
"""A camera straight before the board's middle, and a ball."""


def test_corners_are_measured_to_0_01_pixel(board):
    """The board straight ahead, whose edges lie along the pixels' sides, drawn with 256 rays each."""
    sight = Projection(DRAWN, SIZE)
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
    assert len(found.pixels) == chosen.sum() > 20
    off = found.pixels - expected[chosen]
    assert np.max(np.abs(off)) < 0.02, off


def pictured(board, *balls, hides=lambda column, row: {}, light=1.0):
    """The board with balls before it, as `DRAWN` sees it, in some light; then what hides parts of it, by its grey."""
    light = np.broadcast_to(light, (HEIGHT, WIDTH)).reshape(-1)
    picture = boards.drawn(board, DRAWN, boards.middles(), [ball_at(*place) for place in balls], light)
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    for grey, where in hides(column, row).items():
        picture = np.where(where, grey, picture)
    return ndimage.gaussian_filter(picture, BLUR)


def ball_at(x, y):
    return Setup(DRAWN.camera, Ball(INDEX, [x, y, 60.0], RADIUS))


def found_ball(light, board, name="drawn"):
    """The set-up with the ball of a drawn picture, of which only the radius is known."""
    photograph, blank = Photograph(light, None, name), Setup(DRAWN.camera, Ball(INDEX, radius=RADIUS))  # pyright: ignore
    return find_ball(photograph, board, blank, BLUR, find_discs(photograph, board, blank, BLUR))


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
    return pictured(board, (11, -4), hides=POSTS[post], light=light), ball_at(11, -4)


@pytest.mark.slow
@pytest.mark.parametrize("post", POSTS)
def test_a_ball_is_found_beside_a_shadow(post, wide_board):
    picture, wanted = on_a_post(wide_board, post)
    found = found_ball(picture, wide_board)
    (center, radius), (at, size) = (Projection(one, SIZE).outline for one in (wanted, found))
    assert np.hypot(*(at - center)) < 0.03 * radius
    assert abs(size / radius - 1) < 0.05, "the outline tells the distance to some per cent"
    assert abs(found.glass.ior - INDEX) < 0.2, "and with it where the index begins"


@pytest.mark.slow
def test_two_balls_or_none_are_refused(wide_board):
    with pytest.raises(PictureError, match=r"two: the board is seen through two balls, at column \d+, row 2\d\d, with"):
        found_ball(pictured(wide_board, (-30, 0), (30, 5)), wide_board, "two")
    with pytest.raises(PictureError, match=r"none: there is no ball before the board: .* radius of \d+ to \d+ pixels"):
        found_ball(pictured(wide_board), wide_board, "none")


@pytest.mark.slow
def test_a_refusal_says_where_the_ball_was(image, board):
    wrong = Disc(np.array([200.0, 200.0]), 50.0)
    photographs = [photograph_of(image, "ball")]
    (result,) = locate_together(photographs, board, {"radius": (RADIUS, 0.0)}, uncalibrated(), wrong).photographs
    assert re.search(r"taken to be at column 200, row 200, .* 50 pixels; --ball X Y R", result.reason)
    assert len(result.direct.pixels) > 50 and len(result.markers) > 20 and result.discs == [wrong]


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "words"), [(10, "a tenth"), (2, "half")])
def test_a_wrong_radius_is_asked_about(factor, words, image, board):
    with pytest.raises(
        PictureError, match=f"With {words} of that radius, 20 mm, the board is seen through the ball: was"
    ):
        locate(photograph_of(image, "ball"), board, {"radius": (factor * RADIUS, 0.01)}, uncalibrated())


@pytest.mark.slow
def test_a_photograph_is_fitted_and_reported(image, tmp_path, monkeypatch, capsys):
    write_png(tmp_path / "ball.png", image, transfer="srgb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("raytrace_jax.photo.room_scene.FitOptions", partial(FitOptions, max_steps=1))
    lengths = ["--radius", "20+-0.01mm", "--ruler", "100+-0.01mm"]
    board = str(boards.write_board(tmp_path))
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


@pytest.mark.slow
@pytest.mark.optimized
def test_the_light_of_two_photographs_is_fitted_together(image, tmp_path, monkeypatch, capsys):
    noise = np.random.default_rng(3).normal(scale=0.002, size=image.shape)
    for name, light in (("a.png", image), ("b.png", np.clip(image + noise, 0, 1))):
        write_png(tmp_path / name, light, transfer="srgb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("raytrace_jax.photo.room_scene.FitOptions", partial(FitOptions, max_steps=1))
    lengths = ["--radius", "20+-0.01mm", "--ruler", "100+-0.01mm"]
    board = str(boards.write_board(tmp_path))
    assert main(["photo", "a.png", "b.png", "--board", board, *lengths, "-o", "out", "--fit"]) in (0, 3)
    assert "error" not in capsys.readouterr().err
    written = {path.name for path in Path("out").iterdir()}
    assert {"scene_a.txt", "scene_b.txt", "report.html", "fit_eye1.exr", "fit_eye2.exr", "joined.json"} <= written
    found = FitResult.load("out")
    assert [view.camera for view in found.alone] == ["eye1", "eye2"] and "ball2.center.z" in found.names
    index, error = json.loads(Path("out/joined.json").read_text())["ior"]
    assert abs(index - INDEX) < 4 * error and abs(found["glass.ior"].value - INDEX) < 0.01
