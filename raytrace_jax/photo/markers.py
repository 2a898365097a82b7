"""The markers of a board in a photograph: which are seen directly, and which through a ball or a tank."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from ..errors import PictureError
from .boards import CharucoBoard, MarkerNumbers, Quads, decoded, opencv
from .lens import LensPrior
from .outline import NothingThrough
from .photograph import Corners, Photograph

Grey = UInt8[np.ndarray, "height width"]
"""A picture of 8 bits, as OpenCV reads it."""

LEAST_DIRECT = 8
"""The fewest markers seen directly: a camera has up to nine free numbers, a marker gives eight, and they err."""


def find_markers(photograph: Photograph, board: CharucoBoard) -> Corners:
    """The corners of a board's markers that are seen directly, good to half a pixel.

    A ball turns the board by 180 degrees without mirroring it, so markers decode through it as well, elsewhere. Most of
    them are seen directly: theirs is the homography that most agree on (RANSAC).

    Raises:
        PictureError: there are too few markers of this board; the message says what was found.
    """
    cv2, grey, name = opencv(), photograph.grey, photograph.name
    corners, place, others = markers_of(grey, board)
    if len(place) < LEAST_DIRECT:
        raise PictureError(f"{name}: {_too_few(grey, board, len(place), others)}")
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


def _neighbours(places: Quads, corners: Quads, square: float) -> tuple[int, int]:
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


def markers_in(grey: Grey, dictionary: str) -> tuple[Quads, MarkerNumbers]:
    """The markers of a photograph, which may be small."""
    return _markers_of(grey.tobytes(), grey.shape, dictionary)


@functools.lru_cache(maxsize=128)  # It takes seconds, and each photograph is looked at again; its grey is small.
def _markers_of(grey: bytes, shape: tuple[int, int], dictionary: str):
    """As `markers_in`."""
    aruco = opencv().aruco
    how = aruco.DetectorParameters()
    how.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    # Small markers through glass: OpenCV's own least perimeter is 3 % of the picture's side.
    how.minMarkerPerimeterRate = 0.008
    return decoded(np.frombuffer(grey, np.uint8).reshape(shape), dictionary, how)


def markers_of(grey: Grey, board: CharucoBoard) -> tuple[Quads, MarkerNumbers, int]:
    """The markers of a board in a photograph, which of the board's each is, and how many are of another board."""
    corners, ids = markers_in(grey, board.dictionary)
    photographed, place = np.nonzero(ids[:, None] == board.ids)
    return corners[photographed], place, len(ids) - len(place)


def is_mirrored(grey: Grey, board: CharucoBoard) -> bool:
    """Whether a photograph shows enough markers of a board in its mirror image alone, as a front camera may save it."""
    counts = (len(markers_of(side, board)[0]) for side in (grey, grey[:, ::-1]))
    return next(counts) < LEAST_DIRECT <= next(counts)


def _too_few(grey: Grey, board: CharucoBoard, ours: int, others: int) -> str:
    """The likely reason why a photograph shows too few markers of a board, and what to do."""
    wanted = f"{LEAST_DIRECT} markers of {board.path} are wanted, and {ours} are found"
    if is_mirrored(grey, board):
        return f"{wanted}, but more in its mirror image: mirror it back."
    if ours + others >= LEAST_DIRECT:
        return f"{wanted}, beside {others} of another board: which board was photographed?"
    return (
        f"{wanted}: more of the board, whose markers are those of {board.dictionary}, must be in the picture, sharp "
        "and evenly lit, its markers at least 20 pixels wide (photograph from nearer, or print larger squares)."
    )


class Layers(NamedTuple):
    """A board in two parts, each with the markers and corners that are seen so.

    Args:
        direct: beside the tank.
        through: through it.
        seen: the corners of the markers that are seen through it, good to half a pixel.
    """

    direct: CharucoBoard
    through: CharucoBoard
    seen: Corners


def layers_of(photograph: Photograph, board: CharucoBoard, lens: LensPrior) -> Layers:
    """Part the board's markers: those through a tank seem nearer, for each layer that is flat moves the board's image.

    The markers beside the tank have one homography, nearly so those through it (RANSAC, one after the other). Markers
    that fit both belong to none.

    Raises:
        PictureError: too few markers of this board are seen, or too few beside the tank.
        NothingThrough: too few are seen through it.
    """
    find_markers(photograph, board)  # It refuses what shows no such board.
    cv2 = opencv()
    corners, markers, _ = markers_of(photograph.grey, board)

    # Straight lines are straight once what is known of the lens is undone.
    matrix = lens.camera_matrix(photograph.size, float(lens.mean[0]) if lens.has_fov else 40.0)
    # The middle of a marker is told better than its corners.
    middles, places = (quads.mean(axis=1, keepdims=True) for quads in (corners, board.markers[markers]))
    straight = cv2.undistortPoints(middles, matrix, lens.opencv_distortion, P=matrix)

    near = 1e-3 * max(photograph.size)
    rest, planes = np.ones(len(markers), bool), []
    while np.sum(rest) >= LEAST_DIRECT and len(planes) < 2:
        homography, _ = cv2.findHomography(places[rest], straight[rest], cv2.RANSAC, near)
        if homography is None:
            break
        off = np.linalg.norm(cv2.perspectiveTransform(places, homography) - straight, axis=-1)[:, 0]
        # What is nearer than its neighbours' plane is seen larger.
        middle = np.mean(board.markers, axis=(0, 1)) + board.square * np.array([[[0, 0]], [[1, 0]], [[0, 1]]])
        origin, *axes = cv2.perspectiveTransform(middle, homography)[:, 0]
        planes.append((abs(float(np.linalg.det(np.array(axes) - origin))), off))
        rest &= off > 2 * near
    if len(planes) < 2 or np.sum(planes[1][1] < near) < 4:
        raise NothingThrough(
            f"{photograph.name}: all markers of {board.path} that are seen lie in one plane: either none is seen "
            "through the tank, or none beside it. Photograph so that half of the board is seen through the tank; a "
            "lens that bends wants a calibration."
        )
    (_, far), (_, nearer) = sorted(planes, key=lambda plane: plane[0])
    is_direct, is_through = far < np.minimum(near, nearer / 3), nearer < np.minimum(near, far / 3)
    if np.sum(is_direct) < LEAST_DIRECT:
        raise PictureError(
            f"{photograph.name}: {np.sum(is_direct)} markers of {board.path} are seen beside the tank, and "
            f"{LEAST_DIRECT} are wanted, from which the camera follows: let the tank hide half of the board."
        )
    through = corners[is_through].reshape(-1, 2)
    seen = Corners(through, board.markers[markers[is_through]].reshape(-1, 2), np.full(len(through), 0.5))
    direct, behind = (_part(board, markers[layer], markers[~layer]) for layer in (is_direct, is_through))
    return Layers(direct, behind, seen)


def _part(board: CharucoBoard, markers: np.ndarray, others: np.ndarray) -> CharucoBoard:
    """The board with these markers, and with the corners of squares that touch them and none of the others."""
    apart = np.linalg.norm(board.corners[:, None] - board.markers.mean(axis=1), axis=-1)
    touch, touch_others = ((apart[:, which] < board.square).any(axis=1) for which in (markers, others))
    corners = board.corners[touch & ~touch_others]
    return dataclasses.replace(board, ids=board.ids[markers], markers=board.markers[markers], corners=corners)
