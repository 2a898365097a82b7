"""A camera's lens from several tilted pictures of a board: angle of view, distortion and principal point."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.exif import BACK
from raytrace_jax.photo.boards import Board
from raytrace_jax.photo.find_camera import Photograph, find_camera
from raytrace_jax.photo.lens import USUAL, Lens, turned, uncalibrated
from raytrace_jax.photo.markers import find_markers

LEAST_PICTURES = 3
"""The fewest pictures: fewer do not tell what all have in common from what each has of its own."""


class Calibrated(NamedTuple):
    """What pictures of a board say of a lens.

    Args:
        lens: its numbers, with their covariance, of pictures as the sensor has them.
        size: width and height of these.
        each: the lens as each picture alone tells it, also as the sensor has it.
        sigma: the scatter of corners, in pixels, of each picture.
    """

    lens: Lens
    size: tuple[int, int]
    each: tuple[Lens, ...]
    sigma: tuple[float, ...]


def calibrate(photographs: Sequence[Photograph], board: Board) -> Calibrated:
    """Find a lens from pictures of a board, each from another side, with the same camera and focus.

    Each picture gives an estimate with its covariance; the lens is their mean, weighted by the inverse covariances.
    Where the pictures differ by more than their errors, so is the lens's error larger (Birge's ratio).

    Args:
        photographs: three at least, of one size on the sensor, tilted by 20 to 45 degrees in several directions; EXIF
            may say of some that the camera was turned.
        board: what they show.

    Returns:
        The lens that they say together, and what each says alone.

    Raises:
        PictureError: too few pictures, of several sizes, or too little of the board in one.
    """
    if len(photographs) < LEAST_PICTURES:
        raise PictureError(f"{len(photographs)} pictures are too few for a calibration: {LEAST_PICTURES} are wanted.")
    size = photographs[0].size_on_sensor
    for one in photographs:
        if one.size_on_sensor != size:
            width, height = one.size_on_sensor
            raise PictureError(
                f"{one.name} has {width} x {height} pixels on the sensor and {photographs[0].name} {size[0]} x "
                f"{size[1]}: one camera, one zoom and one size are wanted; of a picture that was turned EXIF has to "
                "say so, as cameras write it."
            )
    # The camera may be turned, and its lens, which stays the same on the sensor, is turned with it.
    found = [
        find_camera(one, board, find_markers(one.grey, board, one.name), turned(uncalibrated(), one.orientation, size))
        for one in photographs
    ]
    each = tuple(
        turned(camera.lens, BACK.get(one.orientation, one.orientation), one.size)
        for one, camera in zip(photographs, found, strict=True)
    )

    # What all say together. Each has been told what lenses usually are: that counts once, not each time.
    usual = np.diag([0.0, *USUAL**-2])
    precisions = [np.linalg.inv(one.covariance) - usual for one in each]
    covariance = np.linalg.inv(sum(precisions) + usual)
    mean = covariance @ sum(p @ one.mean for p, one in zip(precisions, each, strict=True))
    off = sum(float((one.mean - mean) @ p @ (one.mean - mean)) for p, one in zip(precisions, each, strict=True))
    birge = max(1.0, off / (len(mean) * (len(each) - 1)))
    return Calibrated(Lens(mean, birge * covariance), size, each, tuple(camera.sigma for camera in found))
