"""What the EXIF of a photograph tells of its camera and lens: which it is, and the angle of view."""

import math
import os
import warnings

from PIL.ExifTags import Base

from raytrace_jax.errors import PictureWarning
from raytrace_jax.images.exif import exif_of, orientation_of
from raytrace_jax.images.opening import opened

DIAGONAL_OF_FILM = math.hypot(36, 24)
"""The diagonal of a frame of 35 mm film, in millimetres."""

MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
"""Lengths of EXIF's units of the focal plane's resolution: inch, centimetre, millimetre, micrometre."""


TOLD = {
    Base.Make: "the camera's maker",
    Base.Model: "the camera",
    Base.FocalLength: "the focal length",
    Base.FocalLengthIn35mmFilm: "the focal length for 35 mm film",
    Base.DigitalZoomRatio: "the digital zoom",
}
"""What EXIF tells of a camera and its zoom."""


def camera_of(path: str | os.PathLike[str]) -> dict[str, str]:
    """What the EXIF of a photograph tells of its camera and zoom, by the words of `TOLD`. Raises as `exif_of`."""
    exif = exif_of(path)
    return {word: str(exif[tag]).strip() for tag, word in TOLD.items() if tag in exif}


def angle_of_view(path: str | os.PathLike[str]) -> float | None:
    """The full horizontal angle of view, in degrees, that the EXIF of a JPEG or TIFF tells; None if it tells none.

    It follows from the focal length for 35 mm film, whose frame has a diagonal of 43.27 mm (Exif 2.32, tag 0xA405), or
    from the lens's own and the width of the sensor: the pixels that the camera wrote (0xA002) over their density in the
    sensor's plane (0xA20E). A digital zoom (0xA404) shows less of it. The picture may have been made smaller since, but
    not cut.

    Raises:
        PictureError: the file is broken.

    Warns:
        PictureWarning: what it tells cannot be, and is not believed.
    """
    # What the file tells; what it does not is 0.
    exif, turned = exif_of(path), orientation_of(path) > 4
    with opened(path) as file:
        width, height = file.spec().width, file.spec().height

    def number(tag: Base) -> float:
        try:
            value = float(exif.get(tag, 0))
        except (TypeError, ValueError):
            return 0.0
        return value if math.isfinite(value) and value > 0 else 0.0

    focal, as_on_film = number(Base.FocalLength), number(Base.FocalLengthIn35mmFilm)
    was = number(Base.ExifImageWidth), number(Base.ExifImageHeight)
    density, unit = number(Base.FocalPlaneXResolution), int(number(Base.FocalPlaneResolutionUnit))
    zoom = number(Base.DigitalZoomRatio) or 1.0
    told = f"{path}: its EXIF tells a focal length of {as_on_film or focal:g} mm" + " for 35 mm film" * bool(as_on_film)

    # The focal length in pixels of the picture as it is stored, in one of two ways, and the sensor's width with it.
    sensor = pixels = 0.0
    if as_on_film:
        pixels = as_on_film / DIAGONAL_OF_FILM * math.hypot(width, height)
        sensor = focal / pixels * width
    elif focal and density and unit in MILLIMETRES:
        sensor = (was[0] or width) / density * MILLIMETRES[unit]
        is_rotated = all(was) and (was[0] > was[1]) != (width > height)
        pixels = focal / sensor * (height if is_rotated else width)
    if not pixels:
        return None

    # A file may tell nonsense, or tell of a picture that was cut since. Sensors are 2 mm wide in telephones, and 60 mm
    # in medium format.
    if sensor and not 2.0 < sensor < 60.0:
        _disbelieve(f"{told} and a sensor that is {sensor:.3g} mm wide, which no camera has")
        return None
    if all(was) and not _same_shape(was, (width, height)):
        _disbelieve(f"{told} for {was[0]:g} x {was[1]:g} pixels, and it has {width} x {height}: it was cut")
        return None
    angle = math.degrees(2 * math.atan((height if turned else width) / (2 * zoom * pixels)))
    if not 0.1 < angle < 170.0:
        _disbelieve(f"{told}, an angle of view of {angle:.2g} degrees, which no lens has")
        return None
    return angle


def _same_shape(was: tuple[float, float], now: tuple[float, float]) -> bool:
    """Whether a picture of one size can be one of another size made smaller, upright or turned."""
    shape, *others = (math.log(width / height) for width, height in (now, was, was[::-1]))
    # Programs round the sizes of small pictures, by up to 2 %.
    return min(abs(shape - other) for other in others) < 0.02


def _disbelieve(words: str) -> None:
    warnings.warn(f"{words}: the angle of view is not taken from it.", PictureWarning, stacklevel=3)
