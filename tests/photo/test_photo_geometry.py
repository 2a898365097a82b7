"""The geometry of a photograph, against SciPy, OpenCV, Snell's law and finite differences; grids, light, lenses."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.spatial.transform import Rotation

from raytrace_jax import RaytraceError, RaytraceWarning
from raytrace_jax.images.exif import ORIENTATIONS, upright
from raytrace_jax.photo import geometry
from raytrace_jax.photo.geometry import LOST, Ball, Camera, Setup, rotation_matrix
from raytrace_jax.photo.illumination import fit_illumination
from raytrace_jax.photo.lens import LensPrior, Turn, read_lens, uncalibrated, write_lens
from raytrace_jax.photo.photograph import PixelGrid
from raytrace_jax.photo.sight import Projection

SIZE = (640, 480)
POSE = [np.pi - 0.15, 0.12, -0.2, 6.0, -4.0, 260.0]
LENSES = [(0.0, 0.0, 0.0, 0.0), (-0.25, 0.08, 0.013, -0.02), (0.2, -0.05, -0.01, 0.02)]
BALL = np.array([1.5, 4.0, -3.0, 65.0, 20.0])
MIDDLE = np.array([319.5, 239.5])
NO_LENS = LENSES[0]


def setup_of(lens=NO_LENS, ball=BALL, pose=POSE):
    return jax.tree.map(jnp.asarray, Setup(Camera(), Ball()).at(np.array([*pose, 35.0, *lens, *ball])))


def setup_at(numbers):
    return ravel_pytree(setup_of())[1](numbers)


def numeric(function, x, step):
    """The Jacobian by central differences, "... number", each number by its own step."""
    columns = []
    for k, h in enumerate(step):
        change = np.zeros(len(x))
        change[k] = h
        columns.append((np.asarray(function(x + change)) - np.asarray(function(x - change))) / (2 * h))
    return np.stack(columns, -1)


def test_a_rotation_vector_is_that_of_scipy():
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(8, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.array([0, 1e-9, 0.9e-6, 1.1e-6, 1e-3, 1.0, np.pi, 5.0])
    vectors = jnp.asarray(axes * angles[:, None])
    found = jax.jit(jax.vmap(rotation_matrix))(vectors)
    np.testing.assert_allclose(found, Rotation.from_rotvec(np.array(vectors)).as_matrix(), atol=1e-14)


@pytest.mark.slow
def test_a_rotation_is_differentiable_at_0():
    wanted = np.zeros((3, 3, 3))
    for k in range(3):
        wanted[:, :, k] = np.cross(np.eye(3)[k], np.eye(3)).T
    for derivative in (jax.jacfwd(rotation_matrix), jax.jacrev(rotation_matrix)):
        np.testing.assert_allclose(derivative(jnp.zeros(3)), wanted, atol=1e-15)
    # Just beside the change from series to sine and cosine: the second derivative, 1, times what the angle is.
    np.testing.assert_allclose(jax.jacfwd(rotation_matrix)(jnp.array([1.1e-6, 0.0, 0.0])), wanted, atol=3e-6)
    large = np.array([0.4, -1.0, 0.7])
    by_steps = numeric(lambda x: rotation_matrix(jnp.asarray(x)), large, [1e-5] * 3)
    np.testing.assert_allclose(jax.jacfwd(rotation_matrix)(jnp.asarray(large)), by_steps, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_projected_as_by_opencv(lens):
    setup = setup_of(lens)
    points = np.random.default_rng(1).uniform([-80, -60, 0], [80, 60, 90], (200, 3))
    focal = SIZE[0] / (2 * np.tan(np.radians(35.0) / 2))
    across, down = MIDDLE + SIZE[0] * np.array(lens[2:])
    matrix = np.array([[focal, 0, across], [0, focal, down], [0, 0, 1]])
    pose = np.array(POSE)
    wanted, _ = cv2.projectPoints(points, pose[:3], pose[3:], matrix, np.array([*lens[:2], 0.0, 0.0]))
    np.testing.assert_allclose(setup.camera.project(SIZE, jnp.asarray(points)), wanted[:, 0], atol=1e-8)

    # A pixel's ray meets what is projected into it.
    rng = np.random.default_rng(2)
    pixels = jnp.asarray(rng.uniform([-0.5, -0.5], np.array(SIZE) - 0.5, (300, 2)))
    origin, toward = setup.camera.rays(SIZE, pixels)
    np.testing.assert_allclose(jnp.linalg.norm(toward, axis=0), 1, atol=1e-14)
    along = jnp.asarray(rng.uniform(50, 400, 300))
    np.testing.assert_allclose(setup.camera.project(SIZE, (origin + along * toward).T), pixels, atol=1e-9)
    place, distance = geometry.on_board(origin, toward)
    assert np.all(distance > 0)
    flat = jnp.concatenate([place, jnp.zeros((300, 1))], axis=1)
    np.testing.assert_allclose(setup.camera.project(SIZE, flat), pixels, atol=1e-9)


def test_rays_away_from_the_board_miss():
    origin = jnp.array([[0.0, 0, 10]] * 3).T
    _, distance = geometry.on_board(origin, jnp.array([[0.0, 0, 1], [1.0, 0, 0], [0.0, 0, -1]]).T)
    np.testing.assert_array_equal(distance, [-1, -1, 10])


def test_direct_sight_inverts_the_projection():
    sight = Projection(setup_of(LENSES[1]), SIZE)
    places = np.random.default_rng(3).uniform(-50, 50, (5000, 2))  # More than a program's rows, of either size.
    found, _, sees = sight.directly(sight.where(places))
    assert sees.all()
    np.testing.assert_allclose(found, places, atol=1e-9)
    center, radius = sight.outline
    angle = np.linspace(0, 2 * np.pi, 60)
    around = np.stack([np.cos(angle), np.sin(angle)], -1)
    # An ellipse is not a disc: a ball so far off the middle is drawn out by a per cent.
    assert np.all(sight.through(center + 0.97 * radius * around).reach < 1)
    assert np.all(sight.through(center + 1.03 * radius * around).reach > 1)


def refracted(d, n, ratio):
    """Snell's law in the plane of ray and normal: the sine of the angle to the normal is `ratio` times what it was."""
    inward = -n
    across = d - (d @ inward) * inward
    across = ratio * across
    return across + np.sqrt(1 - across @ across) * inward


@pytest.mark.parametrize("index", [1.0, 1.33, 1.5, 1.9])
def test_rays_of_a_tilted_camera_obey_snell(index):
    setup, center, radius = setup_of(LENSES[1], [index, *BALL[1:]]), BALL[1:4], BALL[4]
    middle, size = Projection(setup, SIZE).outline
    pixels = middle + size * np.random.default_rng(4).uniform(-0.65, 0.65, (40, 2))
    eye = np.asarray(setup.camera.of_scene.viewpoint)
    toward = np.asarray(setup.camera.rays(SIZE, jnp.asarray(pixels))[1]).T
    wanted, down = [], []
    for d in toward:
        b = d @ (eye - center)
        entry = eye + (-b - np.sqrt(b * b - (eye - center) @ (eye - center) + radius**2)) * d
        inner = refracted(d, (entry - center) / radius, 1 / index)
        leave = entry - 2 * (inner @ (entry - center)) * inner
        outer = refracted(inner, -(leave - center) / radius, index)
        wanted.append((leave - leave[2] / outer[2] * outer)[:2])
        down.append(-outer[2])
    seen = setup.see(SIZE, jnp.asarray(pixels))
    reaches = np.array(down) > 1e-3
    np.testing.assert_array_equal(seen.valid, reaches)
    assert reaches.mean() > 0.8 and (reaches.all() or index > 1.5)
    np.testing.assert_allclose(seen.reach, np.linalg.norm(np.cross(toward, eye - center), axis=1) / radius, atol=1e-9)
    np.testing.assert_allclose(seen.place[reaches], np.array(wanted)[reaches], rtol=1e-9, atol=1e-9)


STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3, 0.3, 1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4])
"""For each number of camera and ball: about as much as moves a ray by a thousandth of a pixel; k2 by less, for
near the middle it does nearly nothing."""

LEAST_SCALE = np.array([0.0] * 11 + [1.0] * 5)
"""Of a derivative, below which it is not compared as a share: where the index is 1 a ball's place changes nothing."""


def places_and_reach(numbers, pixels):
    found = setup_at(numbers).see(SIZE, pixels)
    return jnp.concatenate([found.place, found.reach[:, None]], axis=1)


FORWARD, BACKWARD = (jax.jit(mode(places_and_reach)) for mode in (jax.jacfwd, jax.jacrev))


@jax.jit
def places_at(numbers, pixels):
    return places_and_reach(numbers, pixels)[:, :2]


@jax.jit
def missed(numbers, pixels, places):
    setup = setup_at(numbers)
    seen = setup.see(SIZE, pixels)
    inverse = jax.lax.stop_gradient(geometry.inverse_of(setup.local_map(SIZE, pixels)))
    return jnp.where(seen.valid[:, None], jnp.einsum("nij,nj->ni", inverse, seen.place - places), geometry.LOST)


@pytest.mark.slow
@pytest.mark.parametrize("index", [1.0, 1.5])
def test_glass_derivatives_are_differences(index):
    setup = setup_of(LENSES[1], [index, *BALL[1:]])
    numbers, (middle, radius) = setup.vector, Projection(setup, SIZE).outline
    pixels = jnp.asarray(middle + radius * np.random.default_rng(6).uniform(-0.6, 0.6, (8, 2)))

    by_steps = numeric(lambda x: places_at(jnp.asarray(x), pixels), numbers, STEPS)
    forward, backward = (mode(jnp.asarray(numbers), pixels)[:, :2] for mode in (FORWARD, BACKWARD))
    # Rounding, 1e-13 of 100 mm over the step, and curvature leave 1e-6 of the largest.
    scale = np.maximum(np.max(np.abs(by_steps), axis=(0, 1)), LEAST_SCALE)
    np.testing.assert_allclose(forward / scale, by_steps / scale, atol=1e-6)
    np.testing.assert_allclose(backward / scale, forward / scale, atol=1e-11)
    slopes = setup.local_map(SIZE, pixels)
    moved = numeric(lambda step: places_at(jnp.asarray(numbers), pixels + step), np.zeros(2), [1e-4, 1e-4])
    np.testing.assert_allclose(slopes, moved, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("index", [0.8, 1.0, 1.5])
def test_derivatives_are_finite_at_the_rim(index):
    height, above, radius = 250.0, 60.0, 20.0
    # The camera looks straight down on the board's middle: half a turn about x.
    setup = setup_of(ball=[index, 0, 0, above, radius], pose=[np.pi, 0, 0, 0, 0, height])
    numbers = jnp.asarray(setup.vector)
    focal = SIZE[0] / (2 * np.tan(np.radians(35.0) / 2))
    touching = focal * np.tan(np.arcsin(radius / (height - above)))
    away = touching * np.array([0, 1 - 1e-9, 1 - 1e-13, 1, 1 + 1e-13, 1 + 1e-9, 1.1, 2])
    pixels = jnp.asarray(MIDDLE + np.stack([away, 0 * away], -1))
    seen = setup.see(SIZE, pixels)
    assert np.all(np.isfinite(seen.place)) and np.all(np.isfinite(seen.reach))
    assert seen.valid[0] and not np.any(seen.valid[-3:])
    np.testing.assert_allclose(seen.reach[2:5], 1, atol=1e-12)

    for mode in (FORWARD, BACKWARD):
        assert np.all(np.isfinite(mode(numbers, pixels)))
    # By the pixel too, by which misses are carried back.
    assert np.all(np.isfinite(missed(numbers, pixels, jnp.zeros((8, 2)))))


@pytest.mark.slow
def test_seen_corners_miss_by_nothing():
    setup = setup_of(LENSES[1])
    numbers, (middle, radius) = setup.vector, Projection(setup, SIZE).outline
    pixels = jnp.asarray(middle + radius * np.random.default_rng(7).uniform(-0.55, 0.55, (8, 2)))
    places = places_at(jnp.asarray(numbers), pixels)

    np.testing.assert_allclose(missed(jnp.asarray(numbers), pixels, places), 0, atol=1e-11)
    slope = jax.jit(jax.jacfwd(missed))(jnp.asarray(numbers), pixels, places)
    by_steps = numeric(lambda x: missed(jnp.asarray(x), pixels, places), numbers, STEPS)
    scale = np.maximum(np.max(np.abs(by_steps), axis=(0, 1)), LEAST_SCALE)
    np.testing.assert_allclose(slope / scale, by_steps / scale, atol=2e-6)
    # A hundredth of a pixel aside it is that hundredth; the map bends by less than 1 % there.
    aside = jnp.array([0.006, -0.008])
    found = missed(jnp.asarray(numbers), pixels + aside, places)
    np.testing.assert_allclose(found, np.broadcast_to(aside, found.shape), atol=1e-4)
    beyond = jnp.asarray(pixels + np.array([2 * radius, 0]))
    np.testing.assert_array_equal(missed(jnp.asarray(numbers), beyond, places), LOST)


@pytest.mark.parametrize("binning", [1, 2, 3, 7])
def test_grid_pixels_are_centred_on_parts(binning):
    width, height = 101, 64
    row, column = np.mgrid[:height, :width].astype(float)
    image = np.stack([column, row, column * row])
    whole = PixelGrid.of((width, height), binning)
    assert whole.size == (width // binning, height // binning)
    part = whole.around(np.array([48.3, 20.9]), 15.5)
    x, y, *_ = part.window
    for grid in (whole, part):
        parts = grid.parts(image)
        assert parts.shape == (3, *grid.window[:1:-1], binning**2)
        np.testing.assert_allclose(parts[:2].mean(axis=-1).reshape(2, -1).T, grid.pixels, atol=1e-12)
    for j, i in ((0, 0), (1, 2)):
        top, left = whole.left[1] + (y + j) * binning, whole.left[0] + (x + i) * binning
        direct = image[:, top : top + binning, left : left + binning].mean(axis=(1, 2))
        np.testing.assert_allclose(part.parts(image).mean(axis=-1)[:, j, i], direct, rtol=1e-14)
    # Everything within the distance lies in the part.
    assert part.pixels.min(axis=0)[0] - (binning - 1) / 2 <= 48.3 - 15.5 and part.pixels[:, 1].max() >= 20.9 + 15.5 - 1
    beyond = whole.around(np.array([0.0, 0.0]), 1000.0)
    assert beyond.window == whole.window


def test_board_light_is_found_beside_a_stain():
    rng = np.random.default_rng(8)
    half = np.array([70.0, 50.0])
    place = rng.uniform(-half, half, (6000, 2))
    brightness = (rng.uniform(size=6000) > 0.45).astype(float)
    x, y = (place / half).T
    light = np.stack([0.6 + 0.1 * x - 0.05 * y - 0.1 * x * x, 0.5 + 0.08 * x * y, 0.4 - 0.1 * y * y - 0.02 * x])
    ink = np.array([0.05, 0.08, 0.12])
    noise = 1 + 0.005 * rng.normal(size=light.shape)
    image = light * np.where(brightness > 0.5, 1, ink[:, None]) * noise
    stain = np.linalg.norm(place - [30, 10], axis=1) < 12
    image[:, stain] *= 0.6
    field = fit_illumination(image, place, brightness, half)
    # 15 terms of 3000 pixels, which scatter by 0.5 %: 0.04 % in the mean, some times that in the corners.
    np.testing.assert_allclose(field.at(place) / light, 1, atol=3e-3)
    np.testing.assert_allclose(field.ink, ink, rtol=5e-3)
    assert 0.004 < field.rest < 0.006
    # Beyond the border's neighbourhood it is that of the border.
    np.testing.assert_array_equal(field.at(np.array([1e4, 0.0])), field.at(np.array([1e5, 0.0])))


LENS = LensPrior(np.array([41.3, -0.02, 0.004, 0.007, -0.003]), np.diag([0.01, 1e-4, 4e-4, 2e-4, 3e-4]) + 1e-5)


def test_a_lens_comes_back_from_its_file(tmp_path):
    path = tmp_path / "new" / "camera.toml"
    write_lens(path, LENS, (4000, 3000), "By a test.")
    assert path.read_text().startswith("# By a test.\n")
    for size in ((4000, 3000), (640, 480), (1001, 751)):
        found = read_lens(path, size)
        np.testing.assert_allclose(found.mean, LENS.mean, rtol=1e-11)
        np.testing.assert_allclose(found.covariance, LENS.covariance, rtol=1e-11)
    with pytest.raises(RaytraceError, match=r"camera\.toml: .*4000 x 3000 .* 1920 x 1080: calibrate"):
        read_lens(path, (1920, 1080))


def test_a_lens_of_turned_pictures_is_turned(tmp_path):
    """To which side is not known: both that are as likely lie within the error."""
    write_lens(path := tmp_path / "camera.txt", LENS, (4000, 3000), "By a test.")
    with pytest.warns(RaytraceWarning, match=r"of 4000 x 3000 pixels, and this one has 600 x 800: it is turned by a"):
        found = read_lens(path, (600, 800))
    sides = [Turn((4000, 3000), after=orientation).of(LENS) for orientation in (6, 8)]
    np.testing.assert_allclose(found.mean, np.mean([one.mean for one in sides], axis=0), atol=1e-12)
    for one in sides:
        np.testing.assert_allclose(one.mean[:3], found.mean[:3], rtol=1e-12)
        off, spread = one.mean - found.mean, found.covariance - one.covariance
        np.testing.assert_allclose(spread[3:, 3:], np.outer(off, off)[3:, 3:], rtol=1e-12)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_a_lens_is_turned_as_its_picture_is(orientation):
    """Every pixel stays as far from where the lens looked, in focal lengths; and errors follow by differences."""
    size = (12, 8)
    column, row = np.meshgrid(*map(np.arange, map(float, size)))

    def reach(lens, size, pixels):
        camera = Camera(0.0, 0.0, lens[0], lens[1:3], lens[3:])
        return np.linalg.norm(pixels - camera.principal_point(size), axis=-1) / camera.focal_length(size)

    stored = upright(np.stack([column, row], -1), orientation)
    height, width, _ = stored.shape
    turn = Turn(size, after=orientation)
    found = turn.of(LENS)
    pixels = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), -1)
    of_turned = reach(found.mean, (width, height), pixels)
    np.testing.assert_allclose(of_turned, reach(LENS.mean, size, stored), rtol=1e-6)

    slope = np.stack(
        [(turn.of(LENS._replace(mean=LENS.mean + step)).mean - found.mean) / 1e-6 for step in 1e-6 * np.eye(5)],
        axis=1,
    )
    np.testing.assert_allclose(found.covariance, slope @ LENS.covariance @ slope.T, rtol=1e-4, atol=1e-12)
    again = Turn(size, before=orientation).of(found)
    np.testing.assert_allclose(again.mean, LENS.mean, rtol=1e-12)
    np.testing.assert_allclose(again.covariance, LENS.covariance, rtol=1e-12)

    # Of which nothing is known, nothing is known when it is turned.
    found = turn.of(uncalibrated())
    assert np.isinf(found.covariance[0, 0]) and not np.isnan(found.covariance).any()
    np.testing.assert_array_equal(found.mean, 0)


GOOD = "fov = 40\nk1 = 0\nk2 = 0\ncenter = [0, 0]\nsize = [4, 3]\ncovariance = [[1, 0, 0, 0, 0], "
GOOD += "[0, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 0, 1]]\n"


@pytest.mark.parametrize(
    "text",
    [
        "not toml",
        GOOD.replace("fov", "f"),
        GOOD.replace("40", "nan"),
        GOOD.replace("40", "'wide'"),
        GOOD.replace("[4, 3]", "[4]"),
        GOOD.replace("[0, 0]", "[0]"),
        GOOD.replace("[1, 0", "[-1, 0"),
        GOOD.replace("[1, 0, 0, 0, 0], ", ""),
        pytest.param(GOOD.replace("[4, 3]", "[4, 0]"), id="no-height"),
        pytest.param(GOOD.replace("40", "200"), id="beyond-180-degrees"),
        pytest.param("\xff\xfe\x00", id="no-text"),
    ],
)
def test_what_is_no_lens_is_refused(text, tmp_path):
    (tmp_path / "camera.toml").write_bytes(text.encode("latin1"))
    with pytest.raises(RaytraceError, match=r"camera\.toml: is no lens; one as `raytrace-jax calibrate` writes it"):
        read_lens(tmp_path / "camera.toml", (640, 480))
