"""EXIF of JPEGs, PNGs and TIFFs, read by Pillow: how a picture is turned, and through which lens it was taken."""

import contextlib
import math
import os
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL.ExifTags import IFD, Base
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from ..errors import PictureError, RaytraceWarning
from ..util.files import StrPath, read_bytes

ORIENTATIONS = range(1, 9)
"""EXIF's numbers of how a picture is turned (Exif 2.32, tag 0x0112); from 5 on rows and columns are exchanged."""

ROWS_REVERSED, COLUMNS_REVERSED = (3, 4, 7, 8), (2, 3, 6, 7)
"""The orientations whose rows, or columns, come from the last to the first."""

BACK = {6: 8, 8: 6}  # Which of EXIF's orientations undoes one, where it does not undo itself.

TOLD = {
    Base.Make: "the camera's maker",
    Base.Model: "the camera",
    Base.FocalLength: "the focal length",
    Base.FocalLengthIn35mmFilm: "the focal length for 35 mm film",
    Base.DigitalZoomRatio: "the digital zoom",
}
"""What EXIF tells of a camera and its zoom."""

BROKEN = (OSError, EOFError, SyntaxError, ValueError, LookupError, TypeError, ArithmeticError, struct.error)
"""What Pillow raises of broken tags."""

DIAGONAL_OF_FILM = math.hypot(36, 24)  # Of a frame of 35 mm film, in millimetres.
RESOLUTION_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # EXIF's units of the focal plane's resolution, in millimetres.


def orientation_of(path: StrPath) -> int:
    """How a file says that its picture is turned, as EXIF numbers it: 1 is upright. PictureError if it is missing."""
    orientation = exif_of(path).get(Base.Orientation, 1)
    return int(orientation) if orientation in ORIENTATIONS else 1


def upright(stored: np.ndarray, orientation: int) -> np.ndarray:
    """A picture "height width channels" that is stored in an orientation of EXIF, turned upright."""
    picture = stored.swapaxes(0, 1) if orientation > 4 else stored
    return picture[:: -1 if orientation in ROWS_REVERSED else 1, :: -1 if orientation in COLUMNS_REVERSED else 1]


def camera_of(path: StrPath) -> dict[str, str]:
    """What a file tells of its camera and zoom, by the words of `TOLD`. PictureError if it is missing."""
    exif = exif_of(path)
    return {word: str(exif[tag]).strip() for tag, word in TOLD.items() if tag in exif}


def angle_of_view(path: StrPath) -> float | None:
    """The full horizontal angle of view, in degrees, that the EXIF of a JPEG or TIFF tells; None if it tells none.

    It follows from the focal length for 35 mm film, whose frame has a diagonal of 43.27 mm (Exif 2.32, tag 0xA405), or
    from the lens's own and the width of the sensor: the pixels that the camera wrote (0xA002) over their density in the
    sensor's plane (0xA20E). A digital zoom (0xA404) shows less of it. The picture may have been made smaller since, but
    not cut. A RaytraceWarning tells of what cannot be, and is not believed. Raises PictureError if the file is missing.
    """
    exif = exif_of(path)

    def number(tag: Base) -> float:
        """What the file tells; 0 where it tells nothing."""
        with contextlib.suppress(TypeError, ValueError):
            if 0 < (value := float(exif.get(tag, 0))) < math.inf:
                return value
        return 0.0

    width, height = number(Base.ImageWidth), number(Base.ImageLength)
    focal, as_on_film = number(Base.FocalLength), number(Base.FocalLengthIn35mmFilm)
    was = number(Base.ExifImageWidth), number(Base.ExifImageHeight)
    density, unit = number(Base.FocalPlaneXResolution), int(number(Base.FocalPlaneResolutionUnit))
    zoom = number(Base.DigitalZoomRatio) or 1.0

    # The focal length in pixels of the picture as it is stored, in one of two ways, and the sensor's width with it.
    sensor = pixels = 0.0
    if as_on_film:
        pixels = as_on_film / DIAGONAL_OF_FILM * math.hypot(width, height)
        sensor = focal / pixels * width
    elif focal and density and unit in RESOLUTION_UNITS:
        sensor = (was[0] or width) / density * RESOLUTION_UNITS[unit]
        is_rotated = all(was) and (was[0] > was[1]) != (width > height)
        pixels = focal / sensor * (height if is_rotated else width)
    if not pixels:
        return None

    # A file may tell nonsense, or tell of a picture that was cut since. Sensors are 2 mm wide in telephones, and 60 mm
    # in medium format.
    is_turned = orientation_of(path) > 4
    angle = math.degrees(2 * math.atan((height if is_turned else width) / (2 * zoom * pixels)))
    if (sensor and not 2.0 < sensor < 60.0) or not 0.1 < angle < 170.0:
        why = f"no camera has a sensor {sensor:.3g} mm wide and an angle of view of {angle:.3g} degrees"
    # Upright or turned, and with sizes that programs round, for small pictures by up to 2 %.
    elif all(was) and min(abs(math.log(width / height) - turn * math.log(was[0] / was[1])) for turn in (1, -1)) > 0.02:
        why = f"it was cut to {width:g} x {height:g} of {was[0]:g} x {was[1]:g} pixels"
    else:
        return angle
    warnings.warn(f"{path}: its EXIF is not believed, for {why}.", RaytraceWarning, stacklevel=2)
    return None


def exif_of(path: StrPath) -> dict[int, Any]:
    """The values of EXIF and the picture's size by their tags; none where there is no EXIF, or a broken one.

    Raises PictureError if the file is missing.
    """
    start = read_bytes(path, count=4, error=PictureError)
    reads = {b"\xff\xd8": JpegImageFile, b"\x89P": PngImageFile}.get(start[:2])
    with warnings.catch_warnings(), contextlib.suppress(*BROKEN):
        warnings.simplefilter("ignore")  # What Pillow says of broken EXIF.
        if reads is not None:
            with reads(os.fspath(path)) as image:
                exif, (width, height) = image.getexif(), image.size
                return {**exif, **exif.get_ifd(IFD.Exif), Base.ImageWidth: width, Base.ImageLength: height}
        if start[:2] in (b"II", b"MM"):
            first = next(directories(path))
            inner = next(directories(path, first[IFD.Exif])) if IFD.Exif in first else {}
            return {**first, **inner}
    return {}


def directories(path: StrPath, first: int | None = None) -> Iterator[ImageFileDirectory_v2]:
    """The tags of a TIFF's pictures, of any layout: of the one at `first`, then of all others and those inside them."""
    with Path(path).open("rb") as file:
        header = file.read(8)
        header += file.read(8) if header[2] == 43 or header[3] == 43 else b""
        places, known = [ImageFileDirectory_v2(header).next if first is None else first], set()
        while places:
            place = places.pop(0)
            if place and place not in known:
                known.add(place)
                tags = ImageFileDirectory_v2(header)
                file.seek(place)
                tags.load(file)
                yield tags
                inner = tags.get(330, ())  # SubIFDs.
                places += [tags.next, *(inner if isinstance(inner, tuple) else (inner,))]
