"""A tank of liquid before a board: which of the board is seen beside it, and which through it."""

import dataclasses
from typing import NamedTuple

import numpy as np

from ..errors import PictureError
from .boards import CharucoBoard, opencv
from .lens import LensPrior
from .markers import LEAST_DIRECT, find_markers, markers_in
from .outline import NothingThrough
from .photograph import Corners, Photograph


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
    cv2, size = opencv("a photograph of a board"), photograph.size
    corners, ids = markers_in(photograph.grey, board.dictionary)
    known = {int(number): place for place, number in enumerate(board.ids)}
    ours = np.array([int(number) in known for number in ids], bool)
    corners, markers = corners[ours], np.array([known[int(number)] for number in ids[ours]], int)

    # Straight lines are straight once the lens is undone, as far as it is known.
    fov = float(lens.mean[0]) if np.isfinite(lens.covariance[0, 0]) else 40.0
    focal = size[0] / (2 * np.tan(np.radians(fov) / 2))
    across, down = (np.asarray(size) - 1) / 2 + lens.mean[3:] * size[0]
    matrix = np.array([[focal, 0, across], [0, focal, down], [0, 0, 1]])
    # The middle of a marker is told better than its corners.
    distortion, middles = np.array([*lens.mean[1:3], 0.0, 0.0]), corners.mean(axis=1, keepdims=True)
    straight = cv2.undistortPoints(middles, matrix, distortion, P=matrix)
    places = board.markers[markers].mean(axis=1, keepdims=True)

    near = 1e-3 * max(size)
    rest, found = np.ones(len(markers), bool), []
    while np.sum(rest) >= LEAST_DIRECT and len(found) < 2:
        homography, _ = cv2.findHomography(places[rest], straight[rest], cv2.RANSAC, near)
        if homography is None:
            break
        off = np.linalg.norm(cv2.perspectiveTransform(places, homography) - straight, axis=-1)[:, 0]
        # What is nearer than its neighbours' plane is seen larger.
        middle = np.mean(board.markers, axis=(0, 1)) + board.square * np.array([[[0, 0]], [[1, 0]], [[0, 1]]])
        origin, *axes = cv2.perspectiveTransform(middle, homography)[:, 0]
        found.append((abs(float(np.linalg.det(np.array(axes) - origin))), off))
        rest &= off > 2 * near
    if len(found) < 2 or np.sum(found[1][1] < near) < 4:
        raise NothingThrough(
            f"{photograph.name}: all markers of {board.path} that are seen lie in one plane: either none is seen "
            "through the tank, or none beside it. Photograph so that half of the board is seen through the tank; a "
            "lens that bends wants a calibration."
        )
    (_, far), (_, nearer) = sorted(found, key=lambda one: one[0])
    is_direct, is_through = far < np.minimum(near, nearer / 3), nearer < np.minimum(near, far / 3)
    if np.sum(is_direct) < LEAST_DIRECT:
        raise PictureError(
            f"{photograph.name}: {np.sum(is_direct)} markers of {board.path} are seen beside the tank, and "
            f"{LEAST_DIRECT} are wanted, from which the camera follows: let the tank hide half of the board."
        )
    through = corners[is_through].reshape(-1, 2)
    seen = Corners(through, board.markers[markers[is_through]].reshape(-1, 2), np.full(len(through), 0.5))
    direct, behind = (_part(board, markers[mine], markers[~mine]) for mine in (is_direct, is_through))
    return Layers(direct, behind, seen)


def _part(board: CharucoBoard, markers: np.ndarray, others: np.ndarray) -> CharucoBoard:
    """The board with these markers, and with the corners of squares that touch them and none of the others."""
    apart = np.linalg.norm(board.corners[:, None] - board.markers.mean(axis=1), axis=-1)
    touch, touch_others = ((apart[:, which] < board.square).any(axis=1) for which in (markers, others))
    corners = board.corners[touch & ~touch_others]
    return dataclasses.replace(board, ids=board.ids[markers], markers=board.markers[markers], corners=corners)
