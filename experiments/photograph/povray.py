"""What pictures by POV-Ray share: a printed board, the camera before it, and how a scene becomes light.

Scenes are in centimetres, boards and truths in millimetres; the board's middle is the origin, it faces +z, y is up.
Needs the program `povray` (Debian package `povray`) and the extra `photo`.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from scipy import ndimage

SIZE = (1600, 1200)
PAPERS = {"a4": (29.7, 21.0), "a3": (42.0, 29.7)}
MARGIN = 1.2
"""How much larger a picture is rendered before a lens that bends it."""


def any_camera(random: np.random.Generator, seed: int) -> dict:
    """A chain drawn at random, as a truth keeps it."""
    uniform = random.uniform
    return {
        "psf": float(uniform(0.7, 1.2)),
        "gains": (uniform(0.75, 1.0, 3)).tolist(),
        "vignetting": float(uniform(0.0, 0.06)),
        "full_well": 20_000,
        "read_noise": 6,
        "quality": int(random.integers(90, 96)),
        "seed": seed,
    }


def directions(eye, lookat, roll: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors to the right of a camera, upwards and forwards."""
    forward = np.subtract(lookat, eye) / np.linalg.norm(np.subtract(lookat, eye))
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    turn = np.radians(roll)
    return np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right, forward


def camera(truth: dict, eye, lookat, roll: float) -> str:
    """POV-Ray's camera."""
    right, up, forward = directions(eye, lookat, roll)
    across = 2 * np.tan(np.radians(truth["fov"]) / 2) * (MARGIN if any(truth["lens"]) else 1.0)
    return (
        f"camera {{ perspective location {v(np.array(eye) / 10)} direction {v(forward)} right {v(across * right)} "
        f"up {v(across * SIZE[1] / SIZE[0] * up)} }}"
    )


def pixels(truth: dict, points) -> np.ndarray:
    """Where a pinhole camera sees points, "n 2"; the middle of the first pixel is 0 0."""
    right, up, forward = directions(truth["eye"], truth["lookat"], truth["roll"])
    away = points - np.array(truth["eye"])
    focal = SIZE[0] / (2 * np.tan(np.radians(truth["fov"]) / 2))
    place = np.stack([away @ right, -(away @ up)], -1) / (away @ forward)[:, None]
    return place * focal + (np.array(SIZE) - 1) / 2


def printed(truth: dict, board: Path) -> list[str]:
    """The paper, and the print a little in front of it."""
    width, height = PAPERS[truth["paper"]]
    pattern = pattern_size(board) / 10 * truth["print_scale"]
    return [
        f"box {{ {v((-width / 2, -height / 2, -0.4))} {v((width / 2, height / 2, -0.005))} "
        "pigment { color rgb 0.82 } finish { diffuse 0.9 ambient 0 } }",
        f'box {{ <0,0,-0.004> <1,1,0> pigment {{ image_map {{ png "{board.with_name(f"{board.stem}_texture.png")}" '
        "gamma 1.0 once interpolate 2 } } finish { diffuse 0.9 ambient 0 } "
        f"scale {v((pattern[0], pattern[1], 1))} translate {v((-pattern[0] / 2, -pattern[1] / 2, 0))} }}",
    ]


def made(board: Path, paper: str) -> Path:
    """The text of a board, which is made if its PDF is missing."""
    if not board.exists():
        command = [sys.executable, "-m", "raytrace_jax", "board", "-o", str(board), "--paper", paper]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return board.with_suffix(".txt")


def v(values) -> str:
    """A POV-Ray vector."""
    return "<" + ", ".join(f"{float(x):.9g}" for x in values) + ">"


def pattern_size(board: Path) -> np.ndarray:
    """Width and height of the pattern in millimetres, as the board's file says."""
    words = board.read_text().split()
    right, up = words.index("right"), words.index("up")
    return 2 * np.array([float(words[right + 1]), float(words[up + 2])])


def through_lens(light: np.ndarray, fov: float, lens: list[float]) -> np.ndarray:
    """The light behind a lens, of `SIZE`, from that of a picture that is larger by `MARGIN`."""
    k1, k2, right, down = lens
    focal = SIZE[0] / (2 * np.tan(np.radians(fov) / 2))
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    middle = (np.array(SIZE) - 1) / 2 + np.array([right, down]) * SIZE[0]
    bent = np.stack([column - middle[0], row - middle[1]]) / focal
    # The model says where a straight ray's pixel lies; its inverse by a fixed point.
    straight = bent
    for _ in range(50):
        squared = np.sum(straight**2, axis=0)
        straight = bent / (1 + k1 * squared + k2 * squared**2)
    place = straight * focal + (np.array(light.shape[:0:-1]) - 1)[:, None, None] / 2
    return np.stack([ndimage.map_coordinates(plane, place[::-1], order=3, mode="nearest") for plane in light])


def rendered(text: str, size: tuple[int, int]) -> np.ndarray:
    """The light of a scene, "3 height width"."""
    with tempfile.TemporaryDirectory() as folder:
        scene, picture = Path(folder) / "a.pov", Path(folder) / "a.png"
        scene.write_text(text)
        command = ["povray", f"+I{scene}", f"+O{picture}", f"+W{size[0]}", f"+H{size[1]}", "+FN16", "File_Gamma=1.0"]
        quality = ["+A0.03", "+AM2", "+R2", "-J", "-D", "-GA", "+WT2"]
        subprocess.run([*command, *quality], check=True, capture_output=True)
        pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.FLOAT)
        assert pixels is not None
        return np.moveaxis(pixels[..., :3].astype(float), -1, 0)
