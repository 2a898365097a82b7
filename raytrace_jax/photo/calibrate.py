"""A camera's lens from several tilted pictures of a board: angle of view, distortion and principal point."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.exif import BACK
from raytrace_jax.photo.boards import CharucoBoard
from raytrace_jax.photo.bundle import adjust, known_before
from raytrace_jax.photo.find_camera import FoundCamera, find_camera
from raytrace_jax.photo.lens import LensPrior, turned, uncalibrated
from raytrace_jax.photo.markers import find_markers
from raytrace_jax.photo.photograph import Photograph
from raytrace_jax.util.digits import with_error

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

    lens: LensPrior
    size: tuple[int, int]
    each: tuple[LensPrior, ...]
    sigma: tuple[float, ...]


def calibrate(photographs: Sequence[Photograph], board: CharucoBoard) -> Calibrated:
    """Find a lens from pictures of a board, each from another side, with the same camera and focus.

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
    size = one_size(photographs)
    # The camera may be turned, and its lens, which stays the same on the sensor, is turned with it.
    found = [
        find_camera(one, board, find_markers(one, board), turned(uncalibrated(), one.orientation, size))
        for one in photographs
    ]
    first = photographs[0]
    joint = one_lens(photographs, found, turned(uncalibrated(), first.orientation, size))

    def on_sensor(lens: LensPrior, photograph: Photograph) -> LensPrior:
        return turned(lens, BACK.get(photograph.orientation, photograph.orientation), photograph.size)

    each = tuple(on_sensor(camera.lens, one) for camera, one in zip(found, photographs, strict=True))
    return Calibrated(on_sensor(joint[0].lens, first), size, each, tuple(camera.sigma for camera in joint))


def one_size(photographs: Sequence[Photograph]) -> tuple[int, int]:
    """The size that all photographs have on the sensor. Raises PictureError where they differ."""
    size = photographs[0].size_on_sensor
    for one in photographs:
        if one.size_on_sensor != size:
            width, height = one.size_on_sensor
            raise PictureError(
                f"{one.name} has {width} x {height} pixels on the sensor and {photographs[0].name} {size[0]} x "
                f"{size[1]}: one camera, one zoom and one size are wanted; of a picture that was turned EXIF has to "
                "say so, as cameras write it."
            )
    return size


def one_lens(photographs: Sequence[Photograph], found: Sequence[FoundCamera], lens: LensPrior) -> list[FoundCamera]:
    """The cameras of photographs adjusted together; `lens` is what is known of it before, as the first one has it.

    Where the pictures alone differ by more than their errors, so are the errors larger (Birge's ratio): boards bend.

    Raises:
        PictureError: the angle of view of one is not that of the others; the message names it.
    """
    first = photographs[0]
    views = [camera.view._replace(turn=first.turn_to(one)) for camera, one in zip(found, photographs, strict=True)]
    seen = adjust(views, known_before(lens, (0.0, 0.0))).views
    apart = [camera.lens.mean - one.setup.lens for camera, one in zip(found, seen, strict=True)]
    # One of another zoom moves what all say: the median of what each says stays.
    shares = np.array([camera.lens.mean[0] / one.setup.fov for camera, one in zip(found, seen, strict=True)])
    for photograph, camera, share in zip(photographs, found, shares / np.median(shares), strict=True):
        fov, error = camera.lens.mean[0], np.sqrt(camera.lens.covariance[0, 0])
        if abs(share - 1) > max(0.01, 8 * error / fov):
            raise PictureError(
                f"{photograph.name}: it tells an angle of view of {with_error(fov, error)} degrees, and others one of "
                f"{fov / share:.4g}: one camera, one zoom and one focus are wanted."
            )
    squares = [float(off @ np.linalg.pinv(one.lens.covariance) @ off) for one, off in zip(found, apart, strict=True)]
    birge = max(1.0, sum(squares) / (len(lens.mean) * max(len(found) - 1, 1)))
    return [
        FoundCamera(camera.view._replace(setup=one.setup), birge * one.covariance, camera.blur, one.sigma[0])
        for camera, one in zip(found, seen, strict=True)
    ]
