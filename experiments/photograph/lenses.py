"""Do the errors of `raytrace-jax calibrate` hold? Lenses, barrel and cushion, each from five tilted pictures.

    python experiments/photograph/lenses.py FOLDER [--lenses 20] [--first 1] [--size 640 480]

Pictures are drawn here: a camera of OpenCV's model before a flat board, box sampled, in uneven light, then the camera
of `../camera/chain.py`, with a JPEG. Nothing of it is the package's but the board's pattern. `lenses.json` in FOLDER
gets each row at once; a lens that is in there is not drawn again. The table has how far each number is off, in its own
errors, and chi squared of all five, which is 5 on average if the covariance is right.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from raytrace_jax import enable_compile_cache, read_picture  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.find_camera import calibrate  # noqa: E402
from raytrace_jax.photo.photograph import photograph_of  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent.parent / "camera"))
from chain import Chain, photograph  # noqa: E402

FOVS = (29.3, 38.6, 46.9, 61.7)
PICTURES = 5
RAYS = 3
"""Rays along a pixel's side, each somewhere in its part of the pixel."""

NAMES = ("fov", "k1", "k2", "right", "down")


def lens_of(number: int) -> np.ndarray:
    """Angle of view, k1, k2 and principal point of a lens: odd numbers are barrels, even ones cushions."""
    uniform = (random := np.random.default_rng(100 + number)).uniform
    sign = -1 if number % 2 else 1
    return np.array([FOVS[number % 4], sign * uniform(0.02, 0.2), uniform(-0.05, 0.05), *random.normal(0, 0.01, 2)])


def straight(lens: np.ndarray, size: tuple[int, int], random) -> np.ndarray:
    """Where the rays of pixels would meet a plane at distance 1 before the camera, "ray row column 2"."""
    focal = size[0] / (2 * np.tan(np.radians(lens[0]) / 2))
    row, column = np.mgrid[: size[1], : size[0]].astype(np.float32)
    middle = (np.array(size) - 1) / 2 + lens[3:] * size[0]
    # The model says how far from the middle a straight ray is seen; a table has the inverse.
    reach = np.linspace(0, 1.2, 4000)
    seen = reach * (1 + lens[1] * reach**2 + lens[2] * reach**4)
    grows = np.append(True, np.minimum.accumulate(np.diff(seen) > 0))
    steps = (np.arange(RAYS) - (RAYS - 1) / 2) / RAYS
    found = []
    for offset in np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2):
        jitter = offset + random.uniform(-0.5, 0.5, (*column.shape, 2)) / RAYS
        bent = (np.stack([column, row], -1) + jitter - middle) / focal
        length = np.sqrt(np.sum(bent**2, axis=-1))
        found.append(bent * (np.interp(length, seen[grows], reach[grows]) / np.maximum(length, 1e-12))[..., None])
    return np.stack(found)


def drawn(rays: np.ndarray, eye: np.ndarray, roll: float, texture: np.ndarray, half: np.ndarray, random) -> np.ndarray:
    """The light that a camera sees of a board at the origin, which faces +z, from an eye that looks at its middle."""
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    turn = np.radians(roll)
    right, up = np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right
    slopes, (rows, columns), total = random.uniform(-0.15, 0.15, 2), texture.shape, np.zeros(rays.shape[1:3])
    for ray in rays:
        x, y, z = (ray[..., 0] * right[k] - ray[..., 1] * up[k] + forward[k] for k in range(3))
        place = np.stack([eye[0] - eye[2] / z * x, eye[1] - eye[2] / z * y], -1) / half
        place = place.clip(-5, 5)
        column, row = ((place[..., 0] + 1) / 2 * columns).astype(int), ((1 - place[..., 1]) / 2 * rows).astype(int)
        inside = np.all(np.abs(place) < 1, axis=-1)
        ink = texture[row.clip(0, rows - 1), column.clip(0, columns - 1)]
        total = total + np.where(inside, 0.04 + 0.78 * ink, 0.45) * (1 + place @ slopes)
    return np.repeat((total / len(rays))[None], 3, axis=0)


def pictures_of(number: int, size: tuple[int, int], board) -> list:
    """Photographs of the board through a lens, by a camera that is held level or upright to some degrees."""
    lens, random = lens_of(number), np.random.default_rng(200 + number)
    rays = straight(lens, size, random)
    distance = 1.1 * board.half[0] / np.tan(np.radians(lens[0]) / 2)
    pictures = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(PICTURES):
            side, rise = np.radians(random.uniform(25, 40) * (-1) ** k), np.radians(random.uniform(-10, 35))
            toward = np.array([np.sin(side) * np.cos(rise), np.sin(rise), np.cos(side) * np.cos(rise)])
            eye, roll = distance * random.uniform(0.95, 1.15) * toward, random.uniform(-3, 3) + 90 * (k % 2)
            light = drawn(rays, eye, roll, board.texture, board.half, random)
            gains = tuple(random.uniform(0.75, 1.0, 3))
            psf, quality = random.uniform(0.7, 1.2), int(random.integers(90, 96))
            camera = Chain(psf, gains, 0.04, full_well=20_000, read_noise=6, quality=quality, seed=10 * number + k)
            photograph(light, camera, path := Path(folder) / f"{k}.jpg")
            pictures.append(photograph_of(read_picture(path), f"picture {k}"))
    return pictures


def run(number: int, pictures: list, board) -> dict:
    """A row: the lens, what was found of it, and its covariance."""
    found = calibrate(pictures, board)
    return {
        "truth": lens_of(number).tolist(),
        "found": found.lens.mean.tolist(),
        "covariance": found.lens.covariance.tolist(),
        "scatter": found.sigma,
    }


def line(number: str, row: dict) -> str:
    """A row of the table."""
    off, covariance = np.subtract(row["found"], row["truth"]), np.array(row["covariance"])
    errors = off / np.sqrt(np.diagonal(covariance))
    lens = " | ".join(f"{value:.4f}" for value in row["truth"])
    return f"| {number} | {lens} | {' | '.join(f'{e:+.1f}' for e in errors)} | {chi_squared(row):.1f} |"


def chi_squared(row: dict) -> float:
    """How far all five numbers are off together, 5 on average."""
    off = np.subtract(row["found"], row["truth"])
    return float(off @ np.linalg.solve(np.array(row["covariance"]), off))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lenses", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480))
    given = parser.parse_args()
    enable_compile_cache()
    given.folder.mkdir(parents=True, exist_ok=True)
    board_file, path = given.folder / "board.txt", given.folder / "lenses.json"
    if not board_file.exists():
        command = [sys.executable, "-m", "raytrace_jax", "board", "-o", str(board_file.with_suffix(".pdf"))]
        subprocess.run([*command, "--square", "20mm"], check=True, stdout=subprocess.DEVNULL)
    board = read_board(board_file)
    rows = json.loads(path.read_text()) if path.exists() else {}
    for number in range(given.first, given.first + given.lenses):
        if str(number) not in rows:
            rows[str(number)] = run(number, pictures_of(number, tuple(given.size), board), board)
            path.write_text(json.dumps(rows, indent=1))
            print(line(str(number), rows[str(number)]), flush=True)
    print(f"\n| lens | {' | '.join(NAMES)} | {' | '.join(f'{name}, errors' for name in NAMES)} | chi squared |")
    print("|---" * (2 * len(NAMES) + 2) + "|")
    print(*(line(*row) for row in rows.items()), sep="\n")
    squared = [chi_squared(row) for row in rows.values()]
    print(f"\nchi squared: mean {np.mean(squared):.1f} of 5, largest {max(squared):.1f}")


if __name__ == "__main__":
    main()
