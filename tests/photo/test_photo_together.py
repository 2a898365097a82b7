"""Several photographs of one ball: one adjustment, whose priors count once, and the command to its end."""

import json
from pathlib import Path

import numpy as np
import photographed_boards as boards
import pytest
from photographed_boards import HEIGHT, INDEX, PATTERN, RADIUS, SIZE, WIDTH, flat_picture
from PIL import Image
from scipy import ndimage

from raytrace_jax import PictureError, write_png
from raytrace_jax.cli import main
from raytrace_jax.errors import RaytraceWarning
from raytrace_jax.images.exif import upright
from raytrace_jax.photo import find_camera
from raytrace_jax.photo.bundle import PhotoView, adjust, known_before
from raytrace_jax.photo.find_camera import FoundCamera, calibrate
from raytrace_jax.photo.geometry import LENS as AT_LENS
from raytrace_jax.photo.geometry import Ball, Camera, Setup
from raytrace_jax.photo.lens import LensPrior, Turn
from raytrace_jax.photo.opinions import Budget, budget, contradictions
from raytrace_jax.photo.photograph import Corners, photograph_of
from raytrace_jax.photo.sight import Projection
from raytrace_jax.photo.turned import turned_alike

TRUE_LENS = np.array([35.0, -0.05, 0.01, 0.004, -0.003])
KNOWN_LENS = LensPrior(
    TRUE_LENS + np.array([0.01, 0.001, -0.002, 2e-4, 2e-4]), np.diag([0.02, 0.003, 0.006, 5e-4, 5e-4]) ** 2
)
KNOWN_RADIUS = (RADIUS * 1.0004, RADIUS * 5e-4)
PLACES = [([np.pi - 0.15, 0.12, -0.2, 6.0, -4.0, 260.0], [4.0, -3.0, 65.0]),
          ([np.pi + 0.2, -0.1, 0.3, 0.0, 5.0, 280.0], [-8.0, 4.0, 45.0]),
          ([np.pi + 0.05, 0.3, 0.1, -5.0, 0.0, 270.0], [0.0, 2.0, 90.0])]  # fmt: skip
COMMON = [*AT_LENS, 11, 15]


def setup_of(pose, lens, center):
    return Setup(Camera(), Ball()).at(np.concatenate([pose, lens, [INDEX], center, [RADIUS]]))


def view_of(place, turn=None, seed=0, noise=0.05):
    """A view of corners as a camera has them, directly and through the ball, that begins a little beside the truth."""
    random = np.random.default_rng(seed)
    turn = turn or Turn(SIZE)
    pose, center = place
    size = SIZE if turn.after < 5 else SIZE[::-1]
    setup = setup_of(pose, turn(TRUE_LENS)[0], center)
    sight = Projection(setup, size)
    places = np.stack(np.meshgrid(np.arange(-60, 61, 15.0), np.arange(-45, 46, 15.0)), -1).reshape(-1, 2)
    middle, radius = sight.outline
    angle, reach = random.uniform(0, 2 * np.pi, 60), 0.9 * np.sqrt(random.uniform(0, 1, 60))
    pixels = middle + radius * (reach * np.stack([np.cos(angle), np.sin(angle)])).T
    seen = sight.through(pixels)
    groups = [(sight.where(places), places), (pixels[seen.valid], seen.place[seen.valid])]
    direct, through = (
        Corners(pixels + noise * random.normal(size=pixels.shape), places, np.full(len(places), noise))
        for pixels, places in groups
    )
    scale = np.array(KNOWN.scale)
    scale[3:6] *= pose[5]
    start = setup.at(setup.vector + 0.05 * scale * random.normal(size=25)[:16])
    return PhotoView(start, size, direct, through, turn)


KNOWN = known_before(KNOWN_LENS, {"radius": KNOWN_RADIUS})


def test_three_places_tell_more_than_one():
    views = [view_of(PLACES[k], Turn(SIZE, 1, turn), k) for k, turn in enumerate((1, 1, 6))]
    joint = adjust(views, KNOWN)
    single = [adjust([view._replace(turn=Turn())], KNOWN).views[0] for view in views[:2]]
    truth = np.concatenate([TRUE_LENS, [INDEX, RADIUS]])
    found, covariance = joint.views[0].setup.vector[COMMON], joint.views[0].covariance[np.ix_(COMMON, COMMON)]
    errors = np.sqrt(np.diagonal(covariance))
    assert np.all(np.abs(found - truth) < 3 * errors)
    assert errors[5] < 0.8 * min(one.errors.glass.ior for one in single)
    # The third was taken with the camera turned: its own numbers are found, and its lens is that of the turned picture.
    third = joint.views[2]
    np.testing.assert_allclose(
        third.setup.vector[AT_LENS], views[2].turn(joint.views[0].setup.vector[AT_LENS])[0], rtol=1e-12
    )
    own = third.setup.places("turn", "shift", "center")
    off = third.setup.vector[own] - np.concatenate(PLACES[2])
    assert np.all(np.abs(off) <= 4 * third.errors.vector[own])

    # Two together are the two alone, of whose precisions what both were told before is taken off once. A plain mean
    # of the indices would have the radius's error halved, and it is common to both.
    before = (KNOWN.root.T @ KNOWN.root)[np.ix_(COMMON, COMMON)]
    alone = [np.linalg.inv(one.covariance[np.ix_(COMMON, COMMON)]) for one in single]
    by_hand = np.linalg.inv(alone[0] + alone[1] - before)
    two = adjust(views[:2], KNOWN)
    np.testing.assert_allclose(np.sqrt(two.covariance[11, 11]), np.sqrt(by_hand[5, 5]), rtol=0.05)


def test_the_error_budget_adds_up():
    view = view_of(PLACES[0])
    once, twice = budget(adjust([view], KNOWN)), budget(adjust([view, view], KNOWN))
    for one in (once, twice):
        assert list(one.parts) == ["corners", "lens", "radius and ruler"] and min(one.parts.values()) > 0
    whole = np.sqrt(adjust([view], KNOWN).covariance[11, 11])
    np.testing.assert_allclose(np.linalg.norm([*once.parts.values()]), whole, rtol=1e-6)
    assert max(*once.exact.values(), once.fourfold) < whole
    # Four of the same picture are what the budget says of four.
    four = adjust([view] * 4, KNOWN)
    np.testing.assert_allclose(np.sqrt(four.covariance[11, 11]), once.fourfold, rtol=0.02)
    exact = budget(adjust([view], known_before(KNOWN_LENS, {"radius": (RADIUS, 0.0)})))
    # The root of a difference of variances: 0 as far as these are rounded.
    assert exact.parts["radius and ruler"] == pytest.approx(0, abs=1e-7 * whole) and exact.parts["lens"] > 0
    assert exact.exact["radius and ruler"] == pytest.approx(np.linalg.norm([*exact.parts.values()]), rel=1e-6)
    # What an exact radius takes away is the radius's, also where corners tell it better than the ruler.
    sure, two = KNOWN_LENS._replace(covariance=np.zeros((5, 5))), [view_of(place) for place in PLACES[:2]]
    loose = budget(adjust(two, known_before(sure, {"radius": (RADIUS, 0.1 * RADIUS)}))).parts
    held = adjust(two, known_before(sure, {"radius": (RADIUS, 0.0)}))
    assert loose["lens"] == pytest.approx(0, abs=1e-9) and loose["radius and ruler"] > loose["corners"]
    np.testing.assert_allclose(loose["corners"], np.sqrt(held.covariance[11, 11]), rtol=0.05)


@pytest.mark.parametrize(
    ("part", "words"),
    [("walls", "measure walls better"), ("corners", "take more photographs"), ("lens", "calibrate the lens")],
)
def test_the_advice_is_of_the_largest_part(part, words):
    parts = Budget({"walls": 0.001, "corners": 0.001, "lens": 0.001} | {part: 0.01}, {"walls": 0.1, "lens": 0.2}, 0.3)
    assert words in parts.advice and "of 0.01 would be left" in parts.advice


@pytest.mark.parametrize(
    ("off", "count", "name"),
    [((0, 0), 1, None), ((-10, 0), 1, "radius"), ((0, 20), 1, "fov"), ((0, 0), 2, None), ((40, 0), 2, "radius")],
)
def test_a_contradicted_prior_is_named(off, count, name):
    """The radius and the angle of view are stated so many of their errors off."""
    lens = KNOWN_LENS._replace(mean=TRUE_LENS + np.array([off[1] * 0.02, 0, 0, 0, 0]))
    known = known_before(lens, {"radius": (RADIUS * (1 + 5e-4 * off[0]), RADIUS * 5e-4)})
    adjusted = adjust([view_of(PLACES[k], seed=k) for k in range(count)], known)
    found = contradictions(adjusted)
    assert [one.name for one in found[:1]] == ([name] if name else [])
    if off[0] and count == 1:  # A single photograph hardly tells the radius, and moves it by less than its error.
        assert abs(found[0].found[0] - found[0].stated[0]) < 3 * found[0].stated[1]


@pytest.mark.slow
def test_three_turned_pictures_give_the_lens(board):
    sides = [(120.0, 20.0, 190.0), (-110.0, 60.0, 190.0), (10.0, -140.0, 180.0)]
    aside = {"lookat": (0.0, 0.0, 0.0), "center": ((WIDTH - 1) / 2 + 0.01 * WIDTH, (HEIGHT - 1) / 2 - 0.008 * WIDTH)}
    stored = [boards.taken(boards.seen_by(boards.CAMERA | {"viewpoint": side} | aside, board), 3) for side in sides]
    pictures = [
        photograph_of(np.moveaxis(upright(np.moveaxis(image, 0, -1), turn), -1, 0), f"turn {turn}", turn)
        for turn, image in zip((1, 3, 6), stored, strict=True)
    ]
    found = calibrate(pictures, board)
    errors = np.sqrt(np.diagonal(found.lens.covariance))
    assert np.all(np.abs(found.lens.mean - [boards.FOV, 0, 0, 0.01, -0.008]) < 4 * errors) and errors[0] < 0.2
    assert np.all(errors[3:] < 1e-3)
    assert found.size == (WIDTH, HEIGHT) and len(found.each) == len(found.sigma) == 3


def test_few_or_mixed_pictures_are_refused(board):
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
        lens = Turn(photograph.size_on_sensor, after=photograph.orientation).of(lens_of(photograph))
        setup = setup_of([np.pi, next(sides), 0.3, 0, 0, 250], lens.mean, [0, 0, 0]).beside
        corners = Corners(Projection(setup, photograph.size).where(places), places, np.full(len(places), 0.01))
        covariance = np.eye(11)
        covariance[np.ix_(AT_LENS, AT_LENS)] = lens.covariance
        view = PhotoView(setup, photograph.size, corners, Corners.none())
        return FoundCamera(setup, covariance, (0.03, 0.0), corners, Corners.none(), view, 0.5)

    monkeypatch.setattr("raytrace_jax.photo.find_camera.find_camera", find)
    monkeypatch.setattr("raytrace_jax.photo.find_camera.find_markers", lambda *_: None)


LENS = LensPrior(np.array([41.3, -0.02, 0.004, 0.007, -0.003]), 1e-8 * np.eye(5))


@pytest.mark.parametrize("turns", [(1, 3, 6, 8), (2, 4, 5, 7), (8, 1, 1)])
def test_turned_pictures_give_the_same_lens(turns, board, monkeypatch):
    found_cameras(monkeypatch, lambda _: LENS)
    shapes = [(3, WIDTH, HEIGHT) if turn > 4 else (3, HEIGHT, WIDTH) for turn in turns]
    pictures = [photograph_of(np.ones(shape), str(turn), turn) for shape, turn in zip(shapes, turns, strict=True)]
    found = calibrate(pictures, board)
    assert found.size == (WIDTH, HEIGHT)
    np.testing.assert_allclose([one.mean for one in found.each], [LENS.mean] * len(turns), rtol=1e-9)
    # What lenses usually are has its part, too.
    assert np.all(np.abs(found.lens.mean - LENS.mean) < 0.1 * np.sqrt(np.diagonal(found.lens.covariance)))


def pictures_of_turned(monkeypatch, taken, lens, zoom=1.0):
    """Three pictures by a lens and one that was turned without EXIF, whose cameras follow from corners with noise."""
    random = np.random.default_rng(0)
    places = np.stack(np.meshgrid(np.arange(-60, 61, 15.0), np.arange(-45, 46, 15.0)), -1).reshape(-1, 2)
    tilts = dict(zip(("a", "b", "c", "turned"), ((0.5, 0.2), (-0.5, 0.3), (0.2, -0.5), (0.4, 0.4)), strict=True))

    def find(photograph, _, known):
        is_turned = photograph.name == "turned"
        seen_by = lens._replace(mean=lens.mean * [zoom, 1, 1, 1, 1]) if is_turned else lens
        truth = Turn(SIZE, after=taken if is_turned else 1).of(seen_by).mean
        setup = setup_of([np.pi, *tilts[photograph.name], 0, 0, 250], truth, [0, 0, 0]).beside
        pixels = Projection(setup, photograph.size).where(places) + 0.03 * random.normal(size=places.shape)
        corners = Corners(pixels, places, np.full(len(places), 0.03))
        view = PhotoView(setup, photograph.size, corners, Corners.none())
        (done,) = adjust([view], known_before(known)).views
        return FoundCamera(**vars(done), view=view, blur=0.5)

    monkeypatch.setattr("raytrace_jax.photo.turned.find_camera", find)
    pictures = [photograph_of(np.ones((3, HEIGHT, WIDTH)), name) for name in "abc"]
    return [photograph_of(np.ones((3, WIDTH, HEIGHT)), "turned"), *pictures]


@pytest.mark.parametrize(("taken", "side"), [(6, "clockwise"), (8, "counterclockwise")])
def test_a_turn_without_exif_is_found(taken, side, board, monkeypatch):
    """Nothing but the others' lens tells to which side the first one was turned."""
    pictures = pictures_of_turned(monkeypatch, taken, LENS)
    with pytest.warns(RaytraceWarning, match=f"turned: has 480 x 640 .* turned by a quarter {side}: it is taken"):
        alike = turned_alike(pictures, board)
    assert [one.orientation for one in alike] == [taken, 1, 1, 1]
    assert turned_alike(alike, board) == alike


@pytest.mark.parametrize(("center", "zoom"), [(0, 1), (1, 1.1)], ids=["both turns fit", "no turn fits"])
def test_an_unclear_turn_is_refused(center, zoom, board, monkeypatch):
    """A lens in the middle of its pictures is the same after both turns; one of another angle is so after none."""
    pictures = pictures_of_turned(monkeypatch, 6, LENS._replace(mean=LENS.mean * [1, 1, 1, center, center]), zoom)
    with pytest.raises(PictureError, match=r"turned has 480 x 640 .* EXIF has to say so"):
        turned_alike(pictures, board)


def test_a_picture_of_another_zoom_is_named(board, monkeypatch):
    found_cameras(
        monkeypatch, lambda photograph: LENS._replace(mean=LENS.mean * (1.1 if photograph.name == "c" else 1))
    )
    pictures = [photograph_of(np.ones((3, HEIGHT, WIDTH)), name) for name in "abcd"]
    with pytest.raises(PictureError, match=r"c: it tells an angle of view of 45\.\d.* others one of 41\.\d.* one zoom"):
        calibrate(pictures, board)


def photographed(board, setup, seed, ball=True):
    """The light of the board as a camera sees it, with a ball or without.

    There is one ray in each cell of every pixel. Of as many anywhere in the pixel edges have a noise of a tenth of the
    light, and the patches of small squares, as they are seen through the ball, scatter by all that is allowed.
    """
    random, total, cells = np.random.default_rng(seed), 0.0, 4
    for cell in np.ndindex(cells, cells):
        within = np.array(cell) + random.uniform(0, 1, (WIDTH * HEIGHT, 2))
        pixels = boards.middles() + within / cells - 0.5
        total = total + boards.drawn(board, setup, pixels, [setup] * ball) / cells**2
    light = ndimage.gaussian_filter(0.05 + 0.8 * total, boards.BLUR)
    return light + boards.NOISE * random.normal(size=light.shape)


@pytest.mark.slow
def test_a_folder_is_one_command(wide_board, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    boards.write_board(tmp_path, boards.WIDE)
    Path("photos").mkdir()
    for k, (pose, center) in enumerate([*PLACES, ([np.pi + 0.3, 0.4, 0.2, 0.0, 0.0, 330.0], [0.0, 0.0, 60.0])]):
        far = [*pose[:5], 1.35 * pose[5]]
        light = photographed(wide_board, setup_of(far, TRUE_LENS, center), k, ball=k < 3)
        write_png(f"photos/{'abcd'[k]}.png", np.repeat(np.clip(light, 0, 1)[None], 3, axis=0), transfer="srgb")
    Image.fromarray(np.full((*SIZE[::-1], 3), 99, np.uint8)).save("photos/grey.png")
    lengths = ["--radius", "20+-0.002mm", "--ruler", "100+-0.01mm", "--transfer", "srgb"]
    pictures = [str(path) for path in sorted(Path("photos").iterdir())]
    assert main(["photo", *pictures, "--board", "board.txt", *lengths, "-o", "out"]) == 0
    printed = capsys.readouterr()
    words = " ".join(printed.err.split())
    assert "photos/grey.png: 8 markers" in words and "It is left out: see out/located_grey.png" in words
    rows = {row[0]: row[1:] for row in map(str.split, printed.out.splitlines()) if row}
    assert rows["d.png"][:3] == ["only", "the", "lens"] and rows["grey.png"] == ["refused"]
    assert "from the corners of 5 photographs" in printed.out and "To lessen the index's error, " in printed.out

    written = {path.name for path in Path("out").iterdir()}
    assert {f"located_{name}.png" for name in ("a", "b", "c", "d", "grey")} <= written
    assert {"scene_a.txt", "scene_b.txt", "scene_c.txt", "located.json"} <= written
    told = json.loads(Path("out/located.json").read_text())
    truth = dict(zip(("fov", "k1", "k2", "principal_point.x", "principal_point.y"), TRUE_LENS, strict=True))
    for name, value in (truth | {"index": INDEX, "radius": RADIUS}).items():
        number = told["parameters"][name]
        assert abs(number["value"] - value) < 3 * number["error"], name
    single = [told["photographs"][f"photos/{name}.png"]["alone"]["error"] for name in "abc"]
    assert told["parameters"]["index"]["error"] < 0.9 * min(single)
    assert len(told["names"]) == len(set(told["names"])) == len(told["covariance"]) == 16 + 2 * 9 + 6
    assert "there is no ball before the board" in told["photographs"]["photos/d.png"]["no_ball"]
    assert "8 markers" in told["photographs"]["photos/grey.png"]["refused"]
    assert told["contradicted"] == []
    whole = np.linalg.norm(list(told["budget"]["parts"].values()))
    assert whole == pytest.approx(told["parameters"]["index"]["error"], rel=1e-6)


def test_a_picture_without_a_board_is_left_out_of_a_calibration(board, monkeypatch):
    found_cameras(monkeypatch, lambda _: LENS)
    worked_on, work = [], find_camera.find_camera

    def look(photograph, _):
        assert not worked_on  # All are looked at before the first is worked on.
        if photograph.name in refused:
            raise PictureError(f"{photograph.name}: 0 markers are seen.")

    def recorded(photograph, *more):
        worked_on.append(photograph.name)
        return work(photograph, *more)

    monkeypatch.setattr("raytrace_jax.photo.find_camera.find_markers", look)
    monkeypatch.setattr("raytrace_jax.photo.find_camera.find_camera", recorded)
    pictures = [photograph_of(np.ones((3, HEIGHT, WIDTH)), name) for name in "abcde"]
    refused = "b"
    with pytest.warns(RaytraceWarning, match=r"b: 0 markers are seen\. It is left out\."):
        found = calibrate(pictures, board)
    assert found.names == ("a", "c", "d", "e") and len(found.each) == 4
    np.testing.assert_allclose([one.mean for one in found.each], [LENS.mean] * 4, rtol=1e-9)
    worked_on.clear()
    refused = "bce"
    with pytest.raises(PictureError, match=r"b: 0 markers(.|\n)*e: 0 markers(.|\n)*2 of 5 pictures are left"):
        calibrate(pictures, board)
    assert not worked_on
