"""Liquids before a board, in a tank or around a ball: Snell's law, derivatives, and an index from a photograph."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import photographed_boards as boards
import pytest
from jax.flatten_util import ravel_pytree
from photographed_boards import FOV, HEIGHT, SIZE, WIDTH, locate

from raytrace_jax import PictureError, build
from raytrace_jax.photo.bundle import PhotoView, adjust, known_before
from raytrace_jax.photo.geometry import Ball, Camera, Liquid, Setup, Tank
from raytrace_jax.photo.lens import LensPrior, uncalibrated
from raytrace_jax.photo.locate import Located, locate_together
from raytrace_jax.photo.markers import layers_of
from raytrace_jax.photo.opinions import budget, contradictions, shown
from raytrace_jax.photo.photograph import Corners, photograph_of
from raytrace_jax.photo.room_scene import tank_scene, wedge_comment
from raytrace_jax.photo.sight import Projection
from raytrace_jax.scene.writer import save_scene

POSE = [np.pi - 0.2, 0.12, -0.1, 3.0, -2.0, 260.0]
LENS = LensPrior(np.array([FOV, 0.0, 0.0, 0.0, 0.0]), np.diag([1e-3, 1e-4, 1e-3, 1e-5, 1e-5]) ** 2)
MEASURED = {"thickness": (60.0, 0.03), "wall": (3.0, 0.02), "wall_index": (1.49, 0.0)}
INDEX, TILT = 1.36, (0.05, -0.03)


def tank(ior=INDEX, tilt=TILT, thickness=60.0, wall=3.0, wall_ior=1.49, wedge=(0.0, 0.0), center=(0.0, 0.0, 0.0)):
    camera = Camera(np.array(POSE[:3]), np.array(POSE[3:]), FOV)
    return Setup(camera, Tank(ior, center, tilt, thickness, wall, wall_ior, wedge))


def refracted(d, normal, ratio):
    """Snell's law in vectors; `ratio` is the index before over that behind, and the normal towards the ray."""
    cosine = -d @ normal
    return ratio * d + (ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal


@pytest.mark.parametrize("wall", [0.0, 4.0])
def test_rays_obey_snell_in_a_wedge(wall):
    """Face by face, where both faces of a wall are parallel, and the back is turned by .3 degrees."""
    wedge, center = np.radians([0.3, -0.1]), np.array([5.0, 8.0, 40.0])
    setup, pixels = tank(wall=wall, wedge=wedge, center=center), np.random.default_rng(3).uniform(0, 1, (20, 2)) * SIZE
    origins, directions = jax.tree.map(jnp.asarray, setup.camera).rays(SIZE, jnp.asarray(pixels))
    front, back = (np.append(by, 1.0) / np.linalg.norm([*by, 1.0]) for by in (TILT, TILT + wedge))
    faces = [(60, front, 1 / 1.49), (60 - wall, front, 1.49 / INDEX), (wall, back, INDEX / 1.49), (0, back, 1.49)]
    places = []
    for o, d in zip(np.asarray(origins).T, np.asarray(directions).T, strict=True):
        for height, normal, ratio in faces:
            o = o + d * ((center + height * normal - o) @ normal) / (d @ normal)
            d = refracted(d, normal, ratio)
        places.append((o - d * o[2] / d[2])[:2])
    seen = Projection(setup, SIZE).through(pixels)
    assert seen.valid.all()
    np.testing.assert_allclose(seen.place, places, atol=1e-9)


@pytest.mark.parametrize("wall", [0.0, 4.0])
def test_rays_obey_snell_at_each_face(wall):
    """Face by face, for a tank that stands anywhere: how far it is from the board does not matter."""
    setup, pixels = tank(wall=wall), np.random.default_rng(3).uniform(0, 1, (20, 2)) * [WIDTH, HEIGHT]
    origins, directions = jax.tree.map(jnp.asarray, setup.camera).rays(SIZE, jnp.asarray(pixels))
    normal = np.append(TILT, 1.0) / np.linalg.norm([*TILT, 1.0])
    depths, indices = [0, wall, 60 - wall, 60], [1, 1.49, INDEX, 1.49, 1]
    for front in (110.0, 150.0):
        places = []
        for o, d in zip(np.asarray(origins).T, np.asarray(directions).T, strict=True):
            for depth, before, behind in zip(depths, indices[:-1], indices[1:], strict=True):
                o = o + d * ((front - depth - o @ normal) / (d @ normal))
                d = refracted(d, normal, before / behind)
            places.append((o - d * o[2] / d[2])[:2])
        seen = Projection(setup, SIZE).through(pixels)
        assert seen.valid.all()
        np.testing.assert_allclose(seen.place, places, atol=1e-9)


PIXELS = jnp.asarray([[300.0, 200.0], [335.0, 260.0], [310.0, 230.0], [325.0, 245.0]])


def places_of(setup):
    """Where pixels see the board, directly and through what is before it, by a set-up's numbers; its derivatives."""
    of = ravel_pytree(setup)[1]

    def places(numbers):
        return jnp.stack([one.see(SIZE, PIXELS).place for one in (of(numbers), of(numbers).beside)])

    return [jax.jit(one) for one in (places, jax.jacfwd(places), jax.jacrev(places))]


def in_liquid(liquid=1.33):
    """A ball in a liquid."""
    return Setup(tank().camera, Ball(1.7, np.array([3.0, -2.0, 60.0]), 20.0), Liquid(liquid, 110.0))


@pytest.mark.parametrize("setup", [tank(1.0), tank(), in_liquid()], ids=["air", "tank", "liquid"])
def test_derivatives_are_differences(setup):
    (places, *modes), numbers = places_of(setup), setup.vector
    steps = np.full(len(numbers), 1e-5)
    steps[8] = 1e-3  # k2 does nearly nothing near the middle.
    moves = [(by * direction, 2 * by) for by, direction in zip(steps, np.eye(len(numbers)), strict=True)]
    wanted = np.stack([(places(numbers + by) - places(numbers - by)) / span for by, span in moves], axis=-1)
    for mode in modes:
        np.testing.assert_allclose(mode(numbers), wanted, rtol=2e-5, atol=2e-6)


@pytest.mark.parametrize(
    "setup",
    [tank(ior=0.5), tank(tilt=(1e3, 0.0)), tank(tilt=(0.0, -2.2)), in_liquid(0.5)],
    ids=["critical", "along", "behind", "liquid"],
)
def test_grazing_rays_have_finite_derivatives(setup):
    """Past the critical angle of a liquid below 1, and along the faces."""
    assert all(np.isfinite(mode(setup.vector)).all() for mode in places_of(setup))


def photographed(board, setup, seed, covers=lambda pixels: pixels[:, 0] < WIDTH * 0.55):
    """Light of a board whose left half is seen through a tank, as a camera has it."""
    fine = np.mean(
        [
            np.where(
                covers(boards.middles()).reshape(HEIGHT, WIDTH),
                np.nan_to_num(board.brightness(Projection(setup, SIZE).through(boards.middles() + step).place), nan=0.4)
                .reshape(HEIGHT, WIDTH),
                boards.drawn(board, setup, boards.middles() + step),
            )
            for step in (np.stack(np.meshgrid([-0.33, 0.0, 0.33], [-0.33, 0.0, 0.33]), -1).reshape(-1, 2))
        ],
        axis=0,
    )  # fmt: skip
    return photograph_of(boards.taken(np.repeat(fine[None], 3, axis=0), seed), f"tank {seed}")


def test_a_boards_markers_lie_in_two_layers(board):
    setup = tank()
    layers = layers_of(photographed(board, setup, 1), board, LENS)
    assert len(layers.direct.ids) >= 8 and len(layers.through.ids) >= 8
    assert not np.intersect1d(layers.direct.ids, layers.through.ids).size
    sight = Projection(setup, SIZE)
    assert (sight.where(layers.direct.corners)[:, 0] > WIDTH * 0.5).all()
    assert (sight.where(layers.through.corners)[:, 0] < WIDTH * 0.6).all()
    off = sight.through(layers.seen.pixels).place - layers.seen.places
    assert np.median(np.linalg.norm(off, axis=1)) < 0.5, "millimetres"


@pytest.mark.parametrize(("everywhere", "words"), [(True, "none beside it"), (False, "none is seen through")])
def test_a_tank_that_hides_all_or_nothing(everywhere, words, board):
    photograph = photographed(board, tank(), 2, lambda pixels: np.full(len(pixels), everywhere))
    with pytest.raises(PictureError, match=words):
        locate(photograph, board, MEASURED, LENS)


@pytest.mark.slow
def test_a_liquids_index_is_within_its_error(wide_board):
    """Of one photograph, also with sizes that cannot be; of two, one without a tank; and what is in the error."""
    seen = photographed(wide_board, tank(), 3)
    found = locate(seen, wide_board, MEASURED, LENS)
    index, error = found.ior
    assert abs(index - INDEX) < 3 * error and error < 2e-3
    assert np.all(np.abs(found.setup.glass.tilt - TILT) < 4 * found.errors.glass.tilt)
    with pytest.raises(PictureError, match=r"index would be 0\.9.*are the tank's thickness and its walls right"):
        locate(seen, wide_board, MEASURED | {"wall": (17.0, 0.02), "wall_index": (2.0, 0.0)}, LENS)
    for thickness, words in ((600.0, "a tenth of that thickness"), (6.0, "ten times that")):
        with pytest.raises(PictureError, match=rf"With {words}, 60 mm, .*: was another unit stated\?"):
            locate(seen, wide_board, MEASURED | {"thickness": (thickness, 0.03), "wall": (2.9, 0.02)}, LENS)
    bare = photographed(wide_board, tank(), 4, lambda pixels: np.zeros(len(pixels), bool))
    both = locate_together([seen, bare], wide_board, MEASURED, uncalibrated())
    assert [result.is_bare for result in both.photographs] == [False, True]
    (located,) = both.located
    index, error = located.ior
    assert abs(index - INDEX) < 3 * error
    parts = budget(both.adjusted).parts
    assert list(parts) == ["corners", "lens", "thickness and ruler", "walls"]
    np.testing.assert_allclose(np.linalg.norm([*parts.values()]), error, rtol=1e-6)


def test_thickness_and_index_are_told_together():
    """Straight ahead a tank only lifts the board: without a measured thickness the index has a large error."""
    places = np.stack(np.meshgrid(np.arange(-60, 61, 15.0), np.arange(-45, 46, 15.0)), -1).reshape(-1, 2)
    setup = tank(tilt=(0.0, 0.0))
    setup = Setup(replace(setup.camera, rotation=np.array([np.pi, 0.0, 0.0])), setup.glass)
    sight, noise = Projection(setup, SIZE), np.random.default_rng(5)
    pixels, _, seen = sight.where_through(places, np.array([90.0, 70.0]))
    groups = [
        Corners(where + 0.02 * noise.normal(size=where.shape), places, np.full(len(places), 0.02))
        for where in (sight.where(places), pixels)
    ]
    assert seen.all()

    def error(thickness):
        view = PhotoView(setup, SIZE, *groups)
        known = known_before(LENS, MEASURED | {"thickness": (60.0, thickness)})
        return adjust([view], known).views[0].ior[1]

    assert error(30.0) > 20 * error(0.03)


def seen_past(setup, seed):
    """The tank as it is stated, with walls that are parallel, and corners as they are seen, through it and beside."""
    places = np.stack(np.meshgrid(np.arange(-60, 61, 8.0), np.arange(-45, 46, 8.0)), -1).reshape(-1, 2)
    noise, sight = np.random.default_rng(seed), Projection(setup, SIZE)
    pixels, _, seen = sight.where_through(places, np.array([90.0, 70.0]))
    assert seen.all()
    groups = [
        Corners(where + 0.02 * noise.normal(size=where.shape), places, np.full(len(places), 0.02))
        for where in (sight.where(places), pixels)
    ]
    glass = replace(setup.glass, ior=1.4, wedge=np.zeros(2), center=np.array([0.0, 0.0, 60.0]))
    return PhotoView(Setup(setup.camera, glass), SIZE, *groups)


KNOWN = known_before(LENS, MEASURED | {"wedge": (0.0, np.radians(0.2))})


@pytest.mark.parametrize("gap", [0.0, 40.0, 150.0])
def test_a_wedge_is_found_beside_the_index(gap):
    """Of .3 degrees, wherever the tank stands: at the board, or twice its thickness before it."""
    wedge = np.radians([-0.2, 0.25])
    found = (adjusted := adjust([seen_past(tank(wedge=wedge, center=(0.0, 0.0, gap)), 5)], KNOWN)).views[0]
    index, error = found.ior
    assert abs(index - INDEX) < min(3 * error, 1e-3)
    assert np.all(np.abs(found.setup.glass.wedge - wedge) < 4 * found.errors.glass.wedge)
    assert "wedge" in budget(adjusted).parts and not contradictions(adjusted)
    assert {"wedge.x", "wedge.y"} <= {found.setup.names[k] for k in shown(found.setup)}


def test_photographs_share_one_wedge():
    """Of a tank that stands elsewhere in each; and one in which no tank is seen tells nothing of where it stands."""
    wedge, poses = np.radians([0.1, -0.3]), ([*POSE], [np.pi + 0.1, -0.25, 0.2, 0.0, 3.0, 280.0])
    setups = [
        Setup(Camera(np.array(pose[:3]), np.array(pose[3:]), FOV), tank(wedge=wedge, center=(0.0, 0.0, gap)).glass)
        for gap, pose in zip((10.0, 80.0), poses, strict=True)
    ]
    views = [seen_past(setup, seed) for seed, setup in enumerate(setups)]
    bare = views[0]._replace(through=Corners.none())
    adjusted = adjust([*views, bare], KNOWN)
    first, second, _ = adjusted.views
    np.testing.assert_array_equal(first.setup.glass.wedge, second.setup.glass.wedge)
    assert np.all(np.abs(first.setup.glass.wedge - wedge) < 4 * first.errors.glass.wedge)
    assert np.all(first.errors.glass.wedge < adjust(views[:1], KNOWN).views[0].errors.glass.wedge)
    for seen, gap in ((first, 10), (second, 80)):
        assert abs(seen.setup.glass.center[2] - gap) < 4 * seen.errors.glass.center[2]
    index, error = first.ior
    assert abs(index - INDEX) < min(3 * error, 1e-3)
    assert not contradictions(adjusted)


def test_what_shifts_neighbours_counts_once():
    """A wall that is not flat shifts all corners of a patch alike: the error is as much larger, and that is told."""
    view = seen_past(tank(), 3)
    plain = adjust([view], KNOWN).views[0]
    places = view.through.places
    waves = 0.1 * np.stack([np.sin(places[:, 0] / 7 + 1) * np.cos(places[:, 1] / 8), np.cos(places[:, 0] / 8)], -1)
    shifted = adjust([view._replace(through=view.through._replace(pixels=view.through.pixels + waves))], KNOWN).views[0]
    assert plain.shared == (1.0, 1.0)
    assert shifted.shared[0] == 1.0 and 2 < shifted.shared[1] <= 3
    assert shifted.sigma[1] > 2 * shifted.sigma[0]
    assert abs(shifted.ior[0] - INDEX) < 3 * shifted.ior[1]


@pytest.mark.parametrize(
    ("wedge", "words"),
    [
        ((0.005, 0.0), "# The walls of the tank were found out of parallel, by a wedge of 0.286"),
        ((0.0, 0.0), "settings"),
    ],
)
def test_a_scene_tells_of_the_wedge(wedge, words, board, tmp_path):
    """Its slab has parallel walls; where these were stated as parallel it says nothing."""
    none, setup = Corners.none(), tank(wedge=wedge)
    located = Located(setup, np.zeros((22, 22)), (0.02, 0.02), none, none, board=board, size=SIZE, blur=0.7)
    text = save_scene(tank_scene(located), tmp_path / "scene.txt", comments=wedge_comment(located))
    assert text.startswith(words)


def test_rays_obey_snell_in_a_liquid():
    """At its surface, at both sides of the ball, down to the board; and places are found where they are seen."""
    setup = in_liquid()
    sight = Projection(setup, SIZE)
    middle, radius = sight.outline
    pixels = middle + 0.8 * radius * np.random.default_rng(4).uniform(-0.7, 0.7, (20, 2))
    origins, directions = jax.tree.map(jnp.asarray, setup.camera).rays(SIZE, jnp.asarray(pixels))
    seen, up = [], np.array([0.0, 0.0, 1.0])
    for o, d in zip(np.asarray(origins).T, np.asarray(directions).T, strict=True):
        o, d = o + d * (110.0 - o[2]) / d[2], refracted(d, up, 1 / 1.33)
        direct = (o - d * o[2] / d[2])[:2]
        for side, ratio in ((-1, 1.33 / 1.7), (1, 1.7 / 1.33)):
            off = o - setup.glass.center
            along = -off @ d + side * np.sqrt((off @ d) ** 2 - off @ off + 400.0)
            o = o + along * d
            d = refracted(d, -side * (o - setup.glass.center) / 20.0, ratio)
        seen.append([*direct, *(o - d * o[2] / d[2])[:2]])
    through = sight.through(pixels)
    assert through.valid.all()
    np.testing.assert_allclose(np.hstack([sight.directly(pixels).place, through.place]), seen, atol=1e-9)
    np.testing.assert_allclose(sight.where(sight.directly(pixels).place), pixels, atol=1e-4)


@pytest.mark.slow
def test_a_ball_in_a_liquid_is_read(wide_board):
    """As the tracer renders it, the surface of the water at a height that nobody states."""
    water = build.material("water", transmission=1, ior=1.333)
    surface = build.plane("surface", material="water", normal=(0, 0, 1), point=(0, 0, 140.0))
    dense = build.material("dense", transmission=1, ior=1.75)
    ball = build.sphere("ball", material="dense", center=(4.0, -3.0, 65.0), radius=20.0)
    light = boards.seen_by(boards.CAMERA, wide_board, water, dense, surface, ball)
    measured = {"radius": (20.0, 0.002), "liquid": (1.333, 5e-4), "depth": (100.0, 80.0)}
    found = locate(photograph_of(boards.taken(light, 6), "in water"), wide_board, measured, LENS)
    index, error = found.ior
    assert abs(index - 1.75) < 3 * error and error < 5e-3
    assert abs(found.setup.liquid.depth - 140) < 4 * found.errors.liquid.depth


def test_a_blank_picture_beside_is_refused(board):
    """Not only without a tank, but without a board: it tells nothing of the lens, and does not stop the others."""
    blank = photograph_of(np.full((3, HEIGHT, WIDTH), 0.5), "blank")
    bare = photographed(board, tank(), 7, lambda pixels: np.zeros(len(pixels), bool))
    found = locate_together([blank, bare], board, MEASURED, LENS)
    assert not found.located and [result.is_bare for result in found.photographs] == [False, True]
    assert all(result.reason for result in found.photographs)
