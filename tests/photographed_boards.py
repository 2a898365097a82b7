"""Boards and photographs of them for the tests: as the package renders them, and as its geometry draws them."""

import numpy as np
from cv2 import aruco
from PIL import Image
from scipy import ndimage

from raytrace_jax import PictureError, RenderSettings, build, make_scene, render
from raytrace_jax.photo.boards import Pattern
from raytrace_jax.photo.locate import locate_together
from raytrace_jax.photo.sight import Projection
from raytrace_jax.report.board_sheet import board_blocks, pattern_picture

SIZE = WIDTH, HEIGHT = 640, 480
FOV, INDEX, RADIUS = 35.0, 1.5, 20.0
CAMERA = {"viewpoint": (60.0, -45.0, 262.0), "lookat": (2.0, 1.0, 0.0), "up": (0.05, 1.0, 0.0), "fov": FOV}
BLUR, NOISE = 0.8, 0.003
PATTERN, WIDE = Pattern(14, 10, 10.0), Pattern(28, 20, 10.0)


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


def charuco(columns, rows, dictionary, is_legacy=False):
    markers = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    board = aruco.CharucoBoard((columns, rows), 30.0, 21.0, markers)
    board.setLegacyPattern(is_legacy)
    return board.generateImage((columns * 60, rows * 60))


def flat_picture(pattern, scale=2):
    """A board as a scanner sees it, amid white."""
    picture = np.pad(pattern_picture(pattern, scale) / 255.0, 20, constant_values=1.0)
    return np.repeat(0.05 + 0.9 * picture[None], 3, axis=0)


def drawn(board, camera, pixels, balls=(), light=1.0):
    """How bright pixels are that a camera sees of a board in some light, and through the balls of set-ups."""
    picture = np.nan_to_num(board.brightness(Projection(camera, SIZE).directly(pixels).place), nan=0.4) * light
    for ball in balls:
        seen = Projection(ball, SIZE).through(pixels)
        through = np.where(seen.valid, np.nan_to_num(board.brightness(seen.place), nan=0.4), 0.3)
        picture = np.where(seen.reach < 1, 0.85 * through, picture)
    return picture.reshape(HEIGHT, WIDTH)


def middles():
    """The middles of all pixels."""
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return np.stack([column, row], -1).reshape(-1, 2)


def locate(photograph, *known):
    """What one photograph tells. Raises PictureError."""
    (result,) = locate_together([photograph], *known).photographs
    if result.reason:
        raise PictureError(result.reason)
    return result.located
