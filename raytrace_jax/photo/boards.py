"""A calibration board, OpenCV's ChArUco: as a scene's file describes it and OpenCV finds it, and its pattern."""

import importlib
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..errors import RaytraceError
from ..scene.reader import parse_scene
from ..util.files import StrPath, read_bytes
from ..util.numerics import on_host
from ..util.text import install

Quads = Float[np.ndarray, "markers 4 2"]
"""The corners of markers, clockwise from the upper left."""

MarkerNumbers = Int[np.ndarray, " markers"]

LEAST_CORNERS = 20
"""The fewest corners of a board, and of a photograph; a camera has up to nine free numbers."""


def opencv(purpose: str = "a photograph of a board") -> ModuleType:
    """The module cv2, which only the commands for photographs need; `purpose` begins the message where it is missing.

    Raises:
        RaytraceError: OpenCV is missing, cannot be loaded or is too old; with the command that installs it.
    """
    try:
        cv2 = importlib.import_module("cv2")
    except ModuleNotFoundError:
        raise RaytraceError(f"{purpose} needs OpenCV: {install('photo')}") from None
    except ImportError as cause:  # It is there, but a library of the system that it wants is not.
        raise RaytraceError(f"{purpose} needs OpenCV, which cannot be loaded ({cause}): {install('photo')}") from None
    if not hasattr(getattr(cv2, "aruco", None), "CharucoDetector"):
        version = getattr(cv2, "__version__", "of no version")
        raise RaytraceError(f"{purpose} needs OpenCV 4.10 or newer, and {version} is here: {install('photo')}")
    return cv2


@dataclass(frozen=True)
class CharucoBoard:
    """A board in its own plane: x to the right, y up, from its middle, in the scene's unit of length.

    Args:
        path: the file that describes it.
        dictionary: OpenCV's name of its set of markers.
        half: half its width and height.
        square: the side of a square.
        ids: numbers of its markers.
        markers: the corners of each, clockwise from the upper left.
        corners: where four squares meet, that are seen between two markers.
        texture: how bright it is, from 0 to 1, its first row at the top.
    """

    path: Path
    dictionary: str
    half: Float[np.ndarray, "2"]
    square: float
    ids: MarkerNumbers
    markers: Quads
    corners: Float[np.ndarray, "corners 2"]
    texture: Float[np.ndarray, "rows columns"]

    @property
    def places(self) -> Float[np.ndarray, "places 2"]:
        """Places around which a patch of the board tells where it is: corners, and the middles of markers."""
        return np.concatenate([self.corners, self.markers.mean(axis=1)])

    def brightness(self, place: Float[np.ndarray, "*any 2"]) -> Float[np.ndarray, " *any"]:
        """How bright the board is at places in its plane, the nearest pixel of its texture; NaN beyond its border."""
        rows, columns = self.texture.shape
        x, y = np.moveaxis(np.asarray(place), -1, 0)
        column = np.floor((x / self.half[0] + 1) / 2 * columns)
        row = np.floor((1 - y / self.half[1]) / 2 * rows)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        nearest = np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)
        return np.where(inside, self.texture[nearest], np.nan)


def read_board(path: StrPath) -> CharucoBoard:
    """Read a board from the blocks of a scene, in whose picture OpenCV finds its markers.

    They are those that `raytrace-jax board` writes, or any picture of a ChArUco board on a rectangle of its size.

    Raises:
        RaytraceError: the file cannot be read, has not one rectangle with a picture, or the picture shows no board, or
            too small a one.
    """
    path = Path(path)
    data = read_bytes(path)
    if data.startswith(b"%PDF") or b"\0" in data:
        raise RaytraceError(
            f"{path}: is no text; the text that describes a board is wanted, which `raytrace-jax board` writes beside "
            "it."
        )
    text = data.decode("utf-8", "replace")
    if not re.search(r"^[^#/]*\bcamera\b", text, re.MULTILINE):  # Scenes have one, and a board's blocks have none.
        text += "\ncamera board_camera { pixeldim 2 2 viewpoint 0 0 1 lookat 0 0 0 }"
    scene = parse_scene(text, source=str(path), model="physical", folder=path.parent)
    if len(scene.images.texels) != 1 or scene.rectangles.center.shape[1] != 1:
        raise RaytraceError(
            f"{path}: has {len(scene.images.texels)} pictures and {scene.rectangles.center.shape[1]} rectangles; "
            "a board is one rectangle with one picture, as `raytrace-jax board` writes it."
        )
    sides = on_host(scene.rectangles.right), on_host(scene.rectangles.up)
    half = np.array([np.linalg.norm(side[:, 0]) for side in sides])
    texture = on_host(scene.images.texels[0]).mean(axis=0)
    name, ids, found = _markers_in(texture, path)

    # From the texture's pixels, whose corners are whole numbers, to the board's plane.
    rows, columns = texture.shape
    markers = (found / [columns, rows] * 2 - 1) * [1, -1] * half
    wide, high = (float(np.median(np.linalg.norm(markers[:, 1] - markers[:, k], axis=-1))) for k in (0, 2))
    # Markers may be wider than high by a twentieth, by the pixels of a small texture.
    if abs(wide / high - 1) > 0.05:
        raise RaytraceError(
            f"{path}: its markers would be {wide:.4g} wide and {high:.4g} high: the rectangle has other proportions "
            "than its picture."
        )
    square, corners = _corners_between(markers)
    if not len(corners):
        raise RaytraceError(
            f"{path}: its picture shows {len(ids)} markers of {name} that no squares lie between: it is no ChArUco "
            "board, whose markers lie in the white squares of a chessboard. Make one with `raytrace-jax board`."
        )
    if len(corners) < LEAST_CORNERS:
        raise RaytraceError(
            f"{path}: the board is too small: {len(corners)} corners lie between the squares of its {len(ids)} "
            f"markers, and {LEAST_CORNERS} are wanted, as a board of 6 x 5 squares has."
        )
    return CharucoBoard(path, name, half, square, ids, markers, corners, texture)


def _markers_in(texture: Float[np.ndarray, "rows columns"], path: Path) -> tuple[str, MarkerNumbers, Quads]:
    """The dictionary of a board's markers, their numbers, and their corners in the texture."""
    dark, light = np.percentile(texture, (5, 95))
    grey = np.round(255 * np.clip((texture - dark) / max(light - dark, 1e-9), 0, 1)).astype(np.uint8)
    least, best = 6, ("", np.zeros(0, int), np.zeros((0, 4, 2)))
    # Of equal markers the largest set comes first.
    for name in (f"DICT_{n}X{n}_{count}" for n in (5, 4, 6, 7) for count in (1000, 250, 100, 50)):
        corners, ids = decoded(grey, name)
        if len(ids) > len(best[1]):
            # OpenCV's (0, 0) is the middle of the first pixel; what it finds are the outermost dark pixels' middles.
            found = corners + 0.5
            middle = found.mean(axis=1, keepdims=True)
            side = np.linalg.norm(found[:, :1] - found[:, 1:2], axis=-1, keepdims=True)
            best = name, ids, middle + (found - middle) * (side + 1) / side
        if len(best[1]) >= least:
            break
    if len(best[1]) < least:
        raise RaytraceError(
            f"{path}: its picture shows {len(best[1])} markers of the sets that are read, DICT_4X4, DICT_5X5, "
            f"DICT_6X6 and DICT_7X7 of 50 to 1000. A board has {least} at least: make one with "
            "`raytrace-jax board`."
        )
    return best


def decoded(grey: UInt8[np.ndarray, "height width"], dictionary: str, how: Any = None) -> tuple[Quads, MarkerNumbers]:
    """The corners and numbers of a dictionary's markers in a picture; `how` are parameters of OpenCV's detector."""
    aruco = opencv().aruco
    markers = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    corners, ids, _ = aruco.ArucoDetector(markers, how or aruco.DetectorParameters()).detectMarkers(grey)
    if ids is None:
        return np.zeros((0, 4, 2)), np.zeros(0, int)
    return np.reshape(corners, (-1, 4, 2)).astype(np.float64), np.ravel(ids).astype(int)


def _corners_between(markers: Quads) -> tuple[float, Float[np.ndarray, "corners 2"]]:
    """The side of a board's squares, and its corners: those that the squares of two markers have in common.

    Markers lie in the middles of the white squares, which touch along diagonals.
    """
    middle = markers.mean(axis=1)
    between = np.linalg.norm(middle[:, None] - middle[None], axis=-1)
    np.fill_diagonal(between, np.inf)
    square = float(np.median(between.min(axis=1)) / np.sqrt(2))
    around = middle[:, None] + square / 2 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    places = around.reshape(-1, 2)
    # Corners of two markers' squares are one where they lie within 0.05 squares.
    lattice = np.round((places - places[0]) / (0.05 * square)).astype(int)
    _, first, count = np.unique(lattice, axis=0, return_index=True, return_counts=True)
    return square, places[first[count > 1]]


LEAST = 2
"""The fewest squares a side: what OpenCV takes."""


@dataclass(frozen=True)
class Pattern:
    """A ChArUco board as OpenCV draws it, seen with its black corner square at the upper left.

    Everything of it lies on a lattice: with markers of 0.7 squares, which are 7 modules wide, a module is a tenth of a
    square. A marker begins one and a half modules within its square, so the lattice has 20 cells a square.

    Args:
        columns: how many squares from left to right.
        rows: how many from top to bottom.
        square: the side of a square in millimetres.
        marker_share: the side of a marker as a share of it.
        dictionary: OpenCV's name of the set of markers.

    Raises:
        RaytraceError: fewer than two squares a side, more markers than the dictionary holds, a number out of range.
    """

    columns: int
    rows: int
    square: float
    marker_share: float = 0.7
    dictionary: str = "DICT_5X5_1000"

    def __post_init__(self) -> None:
        size = f"{self.columns} x {self.rows} squares"
        if min(self.columns, self.rows) < LEAST:
            raise RaytraceError(f"{size}: a board has at least {LEAST} a side.")
        if not (self.square > 0 and math.isfinite(self.square)):
            raise RaytraceError(f"squares of {self.square:g} mm: a length greater than 0 is wanted.")
        if not 0 < self.marker_share < 1:
            raise RaytraceError(f"markers of {self.marker_share:g} squares: a share between 0 and 1 is wanted.")
        held = _bits_and_count(self.dictionary)[1]
        if self.markers > held:
            columns, rows = _fewer(self.columns, self.rows, 2 * held + 1)
            raise RaytraceError(
                f"{size} have {self.markers} markers, and {self.dictionary} holds {held}: {columns} x {rows} squares "
                "fit. Larger squares fill the same room with fewer."
            )

    @property
    def marker(self) -> float:
        return self.square * self.marker_share

    @property
    def markers(self) -> int:
        """How many markers there are, one in each white square."""
        return self.columns * self.rows // 2

    @property
    def lattice(self) -> int:
        """How many cells of the lattice there are along the side of a square."""
        modules = _bits_and_count(self.dictionary)[0] + 2  # Its black border is one module wide on either side.
        share = Fraction(self.marker_share).limit_denominator(1000)
        return math.lcm((share / modules).denominator, ((1 - share) / 2).denominator)

    def cells(self) -> np.ndarray:
        """The cells of the lattice, True where they are black: (rows * lattice, columns * lattice), the top row first.

        Raises:
            RaytraceError: OpenCV is missing.
        """
        aruco = opencv("a board").aruco
        markers = aruco.getPredefinedDictionary(getattr(aruco, self.dictionary))
        side = self.lattice
        board = aruco.CharucoBoard((self.columns, self.rows), float(side), side * self.marker_share, markers)
        # One pixel a cell: then OpenCV has nothing to round.
        picture = board.generateImage((self.columns * side, self.rows * side), marginSize=0, borderBits=1)
        return np.asarray(picture) < 128


def _bits_and_count(dictionary: str) -> tuple[int, int]:
    """How many bits a side the markers of a dictionary have, and how many of them there are; as its name says."""
    match = re.fullmatch(r"DICT_([4-7])X\1_(50|100|250|1000)", dictionary)
    if match is None:
        raise RaytraceError(f"{dictionary} is no set of markers: one such as DICT_5X5_1000 is wanted.")
    return int(match[1]), int(match[2])


def _fewer(columns: int, rows: int, most: int) -> tuple[int, int]:
    """Columns and rows of at most `most` squares, in about the proportion of a pattern with too many."""
    in_shape = math.floor(math.sqrt(most * columns / rows))
    columns = min(columns, max(LEAST, min(in_shape, most // LEAST)))
    return columns, min(rows, most // columns)
