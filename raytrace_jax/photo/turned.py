"""Photographs that were turned by a quarter, of which no EXIF tells: the lens that a set shares says to which side."""

import warnings
from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..errors import PictureError, RaytraceWarning
from .boards import CharucoBoard
from .find_camera import FoundCamera, find_camera, one_lens, one_size
from .lens import LensPrior, PictureSize, Turn, uncalibrated
from .markers import layers_of
from .photograph import Photograph

QUARTERS = {6: "clockwise", 8: "counterclockwise"}
"""Turns by which a picture is as wide as it was high, as EXIF numbers them. Mirrored pictures are mirrored before."""

FITS = 6.0
"""Errors by which the lens of a turned photograph may differ from that of the others, over all five numbers. Of five
normal numbers about 2.2 is usual, and more than 4.5 one time in a thousand; boards that bend a little make it more."""


def turned_alike(photographs: Sequence[Photograph], board: CharucoBoard, *, is_tank: bool = False) -> list[Photograph]:
    """The photographs, those that were turned without EXIF with the turn by which they have the others' lens.

    A lens does not look exactly at the middle of its pictures, and where it looks is turned with the picture.

    Args:
        photographs: by one camera; those of most common size are as the sensor, or their EXIF, has them.
        is_tank: whether a part of the board is seen through a tank.

    Warns:
        RaytraceWarning: a photograph was turned.

    Raises:
        PictureError: the sizes differ otherwise, or not exactly one turn of a photograph fits.
    """
    sizes = Counter(one.size_on_sensor for one in photographs)
    size = max(sizes, key=lambda one: (sizes[one], one[0]))  # Of as many of both sizes the wider one is the sensor's.
    turned = [k for k, one in enumerate(photographs) if one.size_on_sensor != size]
    if not turned:
        return list(photographs)
    usual = [one for one in photographs if one.size_on_sensor == size]
    unclear = [k for k in turned if photographs[k].size_on_sensor != size[::-1] or photographs[k].orientation != 1]
    if unclear:
        one_size([usual[0], photographs[unclear[0]]])

    # Each tells of the lens what its board beside the glass tells, and those that tell nothing are named later.
    cameras = {}
    for k, one in enumerate(photographs):
        try:
            beside = layers_of(one, board, uncalibrated()).direct if is_tank else board
            cameras[k] = find_camera(one, beside, uncalibrated())
        except PictureError:
            continue
    known = [k for k in cameras if k not in turned]
    found = list(photographs)
    joint = None
    if known:
        first = photographs[known[0]]
        lens = one_lens([photographs[k] for k in known], [cameras[k] for k in known], uncalibrated())[0].lens
        joint = Turn(size, before=first.orientation).of(lens)
    for k in turned:
        fits = [] if joint is None or k not in cameras else _turns_that_fit(cameras[k], joint, size)
        if len(fits) != 1:
            one_size([usual[0], photographs[k]])
        found[k] = photographs[k]._replace(orientation=fits[0])
        width, height = photographs[k].size
        warnings.warn(
            f"{photographs[k].name}: has {width} x {height} pixels, other photographs have {size[0]} x {size[1]}, and "
            f"no EXIF says how it was turned. Its lens is that of the others if the picture was turned by a quarter "
            f"{QUARTERS[fits[0]]}: it is taken to be so.",
            RaytraceWarning,
            stacklevel=2,
        )
    return found


def _turns_that_fit(camera: FoundCamera, lens: LensPrior, size: PictureSize) -> list[int]:
    """The turns by which a photograph's lens is the given one, which is as the sensor has it."""
    fitting = []
    for orientation in QUARTERS:
        wanted = Turn(size, after=orientation).of(lens)
        off = camera.lens.mean - wanted.mean
        if off @ np.linalg.solve(camera.lens.covariance + wanted.covariance, off) < FITS**2:
            fitting.append(orientation)
    return fitting
