"""The markers of a board in a photograph: which are seen directly, and which through glass."""

import functools

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..errors import PictureError
from .boards import CharucoBoard, decoded, opencv
from .photograph import Corners, Photograph

LEAST_DIRECT = 8
"""The fewest markers seen directly: a camera has up to nine free numbers, a marker gives eight, and they err."""


def find_markers(photograph: Photograph, board: CharucoBoard) -> Corners:
    """The corners of a board's markers that are seen directly, good to half a pixel.

    A ball turns the board by 180 degrees without mirroring it, so markers decode through it as well, elsewhere. Most of
    them are seen directly: theirs is the homography that most agree on (RANSAC).

    Raises:
        PictureError: there are too few markers of this board; the message says what was found.
    """
    cv2, grey, name = opencv("a photograph of a board"), photograph.grey, photograph.name
    corners, ids = markers_in(grey, board.dictionary)
    known = {int(number): place for place, number in enumerate(board.ids)}
    ours = np.array([int(number) in known for number in ids], bool)
    if np.sum(ours) < LEAST_DIRECT:
        raise PictureError(f"{name}: {_too_few(grey, board, ids, int(np.sum(ours)))}")
    place = np.array([known[int(number)] for number in ids[ours]])
    corners = corners[ours]
    fit, pairs = _neighbours(board.markers[place], corners, board.square)
    # In photographs of the board all neighbours lie where it has them, also through a ball; of others 0 to 0.52.
    if fit < 0.75 * pairs:
        raise PictureError(
            f"{name}: of the neighbours of its {len(place)} markers {fit / pairs:.0%} lie where {board.path} has them: "
            "another board was photographed, of other columns or rows, or one whose markers lie in the other squares, "
            "as in OpenCV's legacy pattern."
        )

    # A lens bends a picture by less than this share of its diagonal; a ball moves a marker by about its own size.
    near = 0.02 * float(np.hypot(*grey.shape))
    places = board.markers[place].reshape(-1, 1, 2)
    homography, _ = cv2.findHomography(places, corners.reshape(-1, 1, 2), cv2.RANSAC, near / 4)
    direct = np.zeros(len(place), bool)
    if homography is not None:
        expected = cv2.perspectiveTransform(places, homography).reshape(-1, 4, 2)
        direct = np.max(np.linalg.norm(expected - corners, axis=-1), axis=1) < near
    if np.sum(direct) < LEAST_DIRECT:
        raise PictureError(
            f"{name}: only {int(np.sum(direct))} of {len(place)} markers lie where one flat board would have them, "
            f"{LEAST_DIRECT} are wanted: is {board.path} the board of this photograph, and is it flat?"
        )
    pixels = corners[direct].reshape(-1, 2)
    return Corners(pixels, board.markers[place[direct]].reshape(-1, 2), np.full(len(pixels), 0.5))


def _neighbours(
    places: Float[np.ndarray, "markers 4 2"], corners: Float[np.ndarray, "markers 4 2"], square: float
) -> tuple[int, int]:
    """How many neighbours of the markers of a photograph lie where the board has them, and how many there are.

    Each marker's own corners say how its neighbourhood is seen, directly or through glass.
    """

    def sides(quads):
        return np.stack([quads[:, 1] - quads[:, 0] + quads[:, 2] - quads[:, 3],
                         quads[:, 3] - quads[:, 0] + quads[:, 2] - quads[:, 1]], axis=-1)  # fmt: skip

    def apart(middles):
        return middles[None] - middles[:, None]

    to_board = sides(places) @ np.linalg.pinv(sides(corners))
    seen = np.einsum("iab,ijb->ija", to_board, apart(corners.mean(axis=1)))
    # The markers of touching squares are 1.4 squares apart, those of another board elsewhere by one at least.
    is_near = (np.linalg.norm(seen, axis=-1) < 1.7 * square) & ~np.eye(len(seen), dtype=bool)
    fits = np.linalg.norm(seen - apart(places.mean(axis=1)), axis=-1) < 0.5 * square
    return int(np.sum(is_near & fits)), int(np.sum(is_near))


def markers_in(
    grey: UInt8[np.ndarray, "height width"], dictionary: str
) -> tuple[Float[np.ndarray, "markers 4 2"], Int[np.ndarray, " markers"]]:
    """The markers of a photograph, which may be small."""
    return _markers_of(grey.tobytes(), grey.shape, dictionary)


@functools.lru_cache(maxsize=128)  # It takes seconds, and each photograph is looked at again; its grey is small.
def _markers_of(grey: bytes, shape: tuple[int, int], dictionary: str):
    """As `markers_in`."""
    aruco = opencv("a photograph of a board").aruco
    how = aruco.DetectorParameters()
    how.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    # Small markers through glass: OpenCV's own least perimeter is 3 % of the picture's side.
    how.minMarkerPerimeterRate = 0.008
    return decoded(np.frombuffer(grey, np.uint8).reshape(shape), dictionary, how)


def is_mirrored(grey: UInt8[np.ndarray, "height width"], board: CharucoBoard) -> bool:
    """Whether a photograph shows enough markers of a board in its mirror image alone, as a front camera may save it."""
    found = (int(np.isin(markers_in(one, board.dictionary)[1], board.ids).sum()) for one in (grey, grey[:, ::-1]))
    return next(found) < LEAST_DIRECT <= next(found)


def _too_few(grey: UInt8[np.ndarray, "height width"], board: CharucoBoard, ids: np.ndarray, ours: int) -> str:
    """Why a photograph shows too few markers of a board, as far as it can be told, and what to do."""
    wanted = f"{LEAST_DIRECT} markers of {board.path} are wanted, and {ours} are found"
    if is_mirrored(grey, board):
        return f"{wanted}, but more in its mirror image: mirror it back."
    if len(ids) >= LEAST_DIRECT:
        return f"{wanted}, beside {len(ids) - ours} of another board: which board was photographed?"
    return (
        f"{wanted}: more of the board, whose markers are those of {board.dictionary}, must be in the picture, sharp "
        "and evenly lit, its markers at least 20 pixels wide (photograph from nearer, or print larger squares)."
    )
