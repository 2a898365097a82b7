"""The pattern of a calibration board, OpenCV's ChArUco: black squares, and markers in the white ones."""

import math
import re
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ..errors import RaytraceError
from .boards import opencv

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
    """At most so many squares, in about the shape of too many, and no more of them a side."""
    in_shape = math.floor(math.sqrt(most * columns / rows))
    columns = min(columns, max(LEAST, min(in_shape, most // LEAST)))
    return columns, min(rows, most // columns)
