"""JPEG and TIFF pictures, as cameras and scanners write them, and painted masks, read by OpenImageIO."""

import math
import os
import warnings
from typing import Any

import numpy as np

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.opening import opened, reason
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import DECODERS

LEAST_PAINTED = 1 / 16
"""Of a mask in a JPEG: less is what its compression left around what was painted."""

TURNS = {
    1: lambda picture: picture,
    2: lambda picture: picture[:, ::-1],
    3: lambda picture: picture[::-1, ::-1],
    4: lambda picture: picture[::-1],
    5: lambda picture: picture.swapaxes(0, 1),
    6: lambda picture: picture.swapaxes(0, 1)[:, ::-1],
    7: lambda picture: picture.swapaxes(0, 1)[::-1, ::-1],
    8: lambda picture: picture.swapaxes(0, 1)[::-1],
}
"""For each orientation of EXIF how "height width channels" becomes upright (Exif 2.32, tag 0x0112)."""

DIAGONAL_OF_FILM = math.hypot(36, 24)
"""Of a frame of 35 mm film, in millimetres."""

MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
"""Of EXIF's units of the focal plane's resolution: inch, centimetre, millimetre, micrometre."""

PLAUSIBLE = (0.1, 170.0)
"""Angles of view, in degrees, of lenses that there are: what is beyond was never a focal length."""

INTEGERS = {"uint8": np.uint8, "uint16": np.uint16}
FLOATS = ("half", "float", "double")


def read_camera_file(path: str | os.PathLike[str], *, transfer: Transfer | None = None) -> np.ndarray:
    """Read a JPEG or TIFF picture as scene-linear float32 "3 height width", top row first, upright.

    The orientation that EXIF says is obeyed, and told. A grey picture has three equal channels. Integers, of any number
    of bits, are scaled to their largest value; floats are scene-linear.

    Args:
        path: the file.
        transfer: how its integers were made, `course` or `srgb`; None is `srgb`.

    Raises:
        PictureError: the file is broken or truncated, is CMYK, or has several pages, transparent pixels, or numbers
            that are not finite.

    Warns:
        PictureWarning: it was turned upright.
    """
    with opened(path) as file:
        return _read(file, path, transfer or "srgb")


def states_transfer(path: str | os.PathLike[str]) -> bool:
    """Whether a JPEG or TIFF says how its numbers were made from light: all do but TIFFs of integers without a profile.

    Raises:
        PictureError: the file is broken.
    """
    with opened(path) as file:
        spec, name = file.spec(), file.format_name()
        return name == "jpeg" or str(spec.format) in FLOATS or spec.getattribute("ICCProfile") is not None


def has_integers(path: str | os.PathLike[str]) -> bool:
    """Whether a JPEG or TIFF holds integers, which have a largest one. Raises PictureError if the file is broken."""
    with opened(path) as file:
        return str(file.spec().format) not in FLOATS


def read_painted(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a mask that was painted, a PNG, JPEG or TIFF of any kind, as weights "height width" from 0 to 1.

    A weight is how bright a pixel is, the mean of its channels without any gamma, times how opaque it is.

    Args:
        path: the file.

    Raises:
        PictureError: the file is broken or truncated, is CMYK, or has several pages.

    Warns:
        PictureWarning: it was turned upright.
    """
    with opened(path) as file:
        stored, spec = _stored(file, path)
        largest = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
        values = np.asarray(stored, np.float64) / largest
        colors = [k for k in range(spec.nchannels) if k != spec.alpha_channel]
        weight = values[..., colors].mean(axis=-1, keepdims=True)
        if spec.alpha_channel >= 0:
            weight = weight * values[..., [spec.alpha_channel]]
        if file.format_name() == "jpeg":
            weight = np.where(weight < LEAST_PAINTED, 0.0, weight)
        return np.ascontiguousarray(_upright(weight, spec, path)[..., 0])


def angle_of_view(path: str | os.PathLike[str]) -> float | None:
    """The full horizontal angle of view, in degrees, that the EXIF of a JPEG or TIFF tells; None if it tells none.

    It follows from the focal length for 35 mm film, whose frame has a diagonal of 43.27 mm (Exif 2.32, tag 0xA405), or
    from the lens's own and the pixels of the sensor's plane. The picture is taken to be whole.

    Raises:
        PictureError: the file is broken.
    """
    with opened(path) as file:
        spec = file.spec()

        def number(name: str) -> float:
            value = spec.getattribute(f"Exif:{name}")
            return float(value) if isinstance(value, int | float) and math.isfinite(value) and value > 0 else 0.0

        focal = number("FocalLengthIn35mmFilm") / DIAGONAL_OF_FILM * math.hypot(spec.width, spec.height)
        unit = MILLIMETRES.get(int(number("FocalPlaneResolutionUnit")))
        if not focal and unit:
            focal = number("FocalLength") / unit * number("FocalPlaneXResolution")
        turned = spec.get_int_attribute("Orientation", 1) > 4
        width = spec.height if turned else spec.width
        angle = math.degrees(2 * math.atan(width / (2 * focal))) if focal else 0.0
        return angle if PLAUSIBLE[0] < angle < PLAUSIBLE[1] else None


def _read(file: Any, path: str | os.PathLike[str], transfer: Transfer) -> np.ndarray:
    stored, spec = _stored(file, path)
    picture = np.moveaxis(_upright(_colors(stored, spec, path), spec, path), -1, 0)
    if stored.dtype.kind == "u":
        return np.ascontiguousarray(DECODERS[transfer](picture), np.float32)
    if not np.isfinite(picture).all():
        raise PictureError(f"{path}: {(~np.isfinite(picture)).sum()} of its numbers are NaN or infinite")
    return np.ascontiguousarray(picture, np.float32)


def _stored(file: Any, path: str | os.PathLike[str]) -> tuple[np.ndarray, Any]:
    """The numbers of the one picture of a file, "height width channels", as they are stored, and what it says."""
    spec = file.spec()
    if file.seek_subimage(1, 0):
        raise PictureError(f"{path}: has several pages, and one picture is wanted")
    file.seek_subimage(0, 0)
    file.geterror()  # That there is no second page is none.
    if spec.get_string_attribute("jpeg:ColorSpace") == "CMYK" or "CMYK" in spec.get_string_attribute("tiff:ColorSpace"):
        raise PictureError(f"{path}: is CMYK, for print; RGB is wanted")
    kind = str(spec.format)
    dtype = INTEGERS.get(kind, np.float32)
    if kind not in INTEGERS and kind not in FLOATS:
        raise PictureError(
            f"{path}: has numbers of the kind {spec.format}; integers of up to 16 bits or floats are wanted"
        )
    pixels = file.read_image(0, 0, 0, spec.nchannels, kind if kind in INTEGERS else "float")
    if pixels is None or file.has_error:
        raise PictureError(f"{path}: cannot be read: {reason(file.geterror())}")
    return np.asarray(pixels, dtype).reshape(spec.height, spec.width, spec.nchannels), spec


def _upright(colors: np.ndarray, spec: Any, path: str | os.PathLike[str]) -> np.ndarray:
    """A picture "height width channels" turned as its EXIF says."""
    orientation = spec.get_int_attribute("Orientation", 1)
    if orientation in TURNS and orientation != 1:
        colors = TURNS[orientation](colors)
        height, width, _ = colors.shape
        warnings.warn(
            f"{path} says that it is turned (orientation {orientation}): upright it is {width} x {height}.",
            PictureWarning,
            stacklevel=5,
        )
    return colors


def _colors(stored: np.ndarray, spec: Any, path: str | os.PathLike[str]) -> np.ndarray:
    """The three channels of colour, by their names."""
    names = [name.upper() for name in spec.channelnames]
    if spec.alpha_channel >= 0:
        alpha = stored[..., spec.alpha_channel]
        opaque = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
        if np.any(alpha != opaque):
            raise PictureError(
                f"{path}: {int(np.sum(alpha != opaque)):,} of its pixels are transparent, and opaque ones are wanted"
            )
    if {"R", "G", "B"} <= set(names):
        return stored[..., [names.index(name) for name in "RGB"]]
    colors = [k for k in range(spec.nchannels) if k != spec.alpha_channel]
    if len(colors) == 1:
        return np.repeat(stored[..., colors], 3, axis=-1)
    raise PictureError(f"{path}: has the channels {', '.join(spec.channelnames)}, and R, G and B are wanted")
