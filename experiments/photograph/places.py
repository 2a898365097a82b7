"""Which three places of the ball are best for an index? From the covariance of the joint adjustment, without pictures.

    python experiments/photograph/places.py FOLDER [--radius 25] [--known 1e-4 1e-3]

A camera of 1600 x 1200 pixels and 38.6 degrees sees a board on A4 from three sides, the lens as a calibration from five
pictures knows it. The ball stands at 1.6, 2.1 or 2.8 focal distances from the board, n R / (2 (n - 1)); what is seen of
the board, directly and through the ball, counts as `photo` counts it. Printed is the error of the index for each choice
of three places, and for each alone. FOLDER gets the board, `board.txt`, if it has none.
"""

import argparse
import itertools
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

from raytrace_jax import enable_compile_cache  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.bundle import CORNER_FLOOR, linearized, padded  # noqa: E402
from raytrace_jax.photo.geometry import LENS, Ball, Camera, Setup  # noqa: E402
from raytrace_jax.photo.locate import LEAST_SQUARE  # noqa: E402
from raytrace_jax.photo.photograph import Corners  # noqa: E402
from raytrace_jax.photo.sight import Projection  # noqa: E402

SIZE, FOV = (1600, 1200), 38.6
INDICES = (1.35, 1.5, 1.65, 1.8)
PLACES = {"near": 1.6, "middle": 2.1, "far": 2.8}
"""Distances of the ball's middle from the board, in distances of its focus from its middle."""

SIDES = (-14.0, 3.0, 15.0)
"""From how many degrees aside the camera looks, one for each photograph."""

LENS_ERRORS = np.array([1.3e-3, 4.5e-4, 5e-3, 4e-5, 4e-5])
"""Of angle of view, k1, k2 and principal point, as a calibration from five pictures has them."""

BEFORE = Setup(Camera(), Ball())
OWN, COMMON = BEFORE.places("turn", "shift", "center"), [*LENS, *BEFORE.places("index", "radius")]
COUNT = len(BEFORE.numbers)
"""Of a ball in air."""


def setup_of(index: float, radius: float, factor: float, side: float, width: float) -> Setup:
    """A camera and a ball; the ball is on the line from the camera to the board's middle, or nearly."""
    gap = factor * radius * index / (2 * (index - 1))
    distance = 0.56 * width / np.tan(np.radians(FOV) / 2) + 0.5 * gap
    aside, above = np.radians(side), np.radians(6.0)
    eye = distance * np.array([np.sin(aside) * np.cos(above), np.sin(above), np.cos(aside) * np.cos(above)])
    forward = -eye / distance
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    rotation, center = Rotation.from_matrix(turn).as_rotvec(), np.array([0.05 * width, 0.0, gap])
    return Setup(Camera(rotation, -turn @ eye, FOV), Ball(index, center, radius))


def information(setup: Setup, board) -> tuple[np.ndarray, int]:
    """The precision of what is common that one photograph tells, whatever its own numbers are; places in the ball."""
    sight = Projection(setup, SIZE)
    center, radius = sight.outline
    pixels = sight.where(board.corners)
    beside = np.linalg.norm(pixels - center, axis=1) > 1.05 * radius
    beside &= np.all((pixels > 20) & (pixels < np.array(SIZE) - 20), axis=1)

    at, stretch, visible = sight.where_through(board.places, np.full(2, np.inf))
    visible &= stretch * board.square > LEAST_SQUARE
    groups = [(pixels[beside], board.corners[beside]), (at[visible], board.places[visible])]
    corners = [Corners(*group, np.zeros(len(group[0]))) for group in groups]
    _, slopes = linearized(setup, np.asarray(SIZE, float), *map(padded, corners))
    whole = np.zeros((COUNT, COUNT))
    for slope, group in zip(slopes, corners, strict=True):
        rows = np.asarray(slope)[: len(group.pixels)].reshape(-1, COUNT) / CORNER_FLOOR
        whole += rows.T @ rows
    own = np.linalg.solve(whole[np.ix_(OWN, OWN)], whole[np.ix_(OWN, COMMON)])
    return whole[np.ix_(COMMON, COMMON)] - whole[np.ix_(COMMON, OWN)] @ own, int(visible.sum())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--radius", type=float, default=25.0)
    parser.add_argument("--known", type=float, nargs="+", default=[1e-4, 1e-3], help="radius and ruler, as shares")
    given = parser.parse_args()
    enable_compile_cache()
    path = given.folder / "board.txt"
    if not path.exists():
        command = [sys.executable, "-m", "raytrace_jax", "board", "-o", str(path.with_suffix(".pdf"))]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    board = read_board(path)
    triples = list(itertools.combinations_with_replacement(PLACES, 3))
    told = {
        (index, place, side): information(
            setup_of(index, given.radius, PLACES[place], side, 2.1 * board.half[0]), board
        )
        for index in INDICES
        for place in PLACES
        for side in SIDES
    }

    def error(index: float, places: tuple[str, ...], known: float) -> float:
        before = np.diag(1 / np.array([*LENS_ERRORS, np.inf, known * given.radius]) ** 2)
        sides = SIDES if len(places) > 1 else SIDES[1:2]
        whole = before + sum(told[index, place, side][0] for place, side in zip(places, sides, strict=True))
        return float(np.sqrt(np.linalg.inv(whole)[5, 5]))

    for known in given.known:
        print(f"\nErrors of the index, 1e-5, radius and ruler known to {known:g}; in parentheses places in the ball\n")
        print(f"| places | {' | '.join(map(str, INDICES))} |\n|---{'|---' * len(INDICES)}|")
        for place in PLACES:
            cells = [f"{1e5 * error(i, (place,), known):.0f} ({told[i, place, SIDES[1]][1]})" for i in INDICES]
            print(f"| {place} alone | {' | '.join(cells)} |")
        for triple in triples:
            cells = [f"{1e5 * error(index, triple, known):.0f}" for index in INDICES]
            print(f"| {', '.join(triple)} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
