"""JPEG and TIFF pictures, as cameras and scanners write them, and painted masks, read by OpenImageIO."""

import os
import warnings
from typing import Any

import numpy as np

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.colour_spaces import ColourSpace, largest_number, tell_primaries
from raytrace_jax.images.exif import upright
from raytrace_jax.images.icc import is_linear, read_profile
from raytrace_jax.images.jpeg_scans import lacks_scans
from raytrace_jax.images.opening import opened, pixels_of
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import DECODERS
from raytrace_jax.images.tiff_layout import undo_layout
from raytrace_jax.util.files import read_bytes

INTEGERS = ("uint8", "uint16")
FLOATS = ("half", "float", "double")


def read_camera_file(path: str | os.PathLike[str], *, transfer: Transfer | None = None) -> np.ndarray:
    """Read a JPEG or TIFF picture as scene-linear float32 "3 height width", top row first, upright.

    The orientation that EXIF says is obeyed, and told. A grey picture has three equal channels. Integers, of any number
    of bits, are scaled to their largest value; floats are scene-linear.

    Args:
        path: the file.
        transfer: how its integers were made, `course` or `srgb`; None is what its ICC profile says, `srgb` without one.

    Raises:
        PictureError: the file is broken or truncated, is CMYK, or has several pages, transparent pixels, a profile that
            is not read, or numbers that are not finite.

    Warns:
        PictureWarning: it was turned upright; its primaries are not those of sRGB; it says so and not which they are.
    """
    with opened(path) as file:
        return _read(file, path, transfer)


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


def has_long_numbers(path: str | os.PathLike[str]) -> bool:
    """Whether a JPEG's or TIFF's numbers have more than 8 bits. Raises PictureError if the file is broken."""
    with opened(path) as file:
        return str(file.spec().format) != "uint8"


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
        values = np.asarray(stored, np.float64) / largest_number(stored)
        weight = values[..., _channels_of_colour(spec)].mean(axis=-1, keepdims=True)
        if spec.alpha_channel >= 0:
            weight = weight * values[..., [spec.alpha_channel]]
        if file.format_name() == "jpeg":
            # Compression leaves faint traces around what was painted.
            weight = np.where(weight < 1 / 16, 0.0, weight)
        return np.ascontiguousarray(upright(weight, path)[..., 0])


def _read(file: Any, path: str | os.PathLike[str], transfer: Transfer | None) -> np.ndarray:
    stored, spec = _stored(file, path)
    colours = upright(_colors(stored, spec, path), path)
    stated = transfer or _stated(spec, path)
    is_float = stored.dtype.kind != "u"
    if isinstance(stated, ColourSpace):
        if is_float and not is_linear(stated):
            raise PictureError(
                f"{path}: has floats, which are scene-linear, and an ICC profile ({stated.name}) that says they are not"
            )
        colours = stated.decode(colours)
        tell_primaries(path, stated)
    elif not is_float:
        colours = DECODERS[stated](colours)
    if not np.isfinite(colours).all():
        raise PictureError(f"{path}: {(~np.isfinite(colours)).sum()} of its numbers are NaN or infinite")
    return np.ascontiguousarray(np.moveaxis(colours, -1, 0), np.float32)


def _stated(spec: Any, path: str | os.PathLike[str]) -> Transfer | ColourSpace:
    """What a file says of its numbers; sRGB if it says nothing."""
    profile = spec.getattribute("ICCProfile")
    try:
        if profile is not None:
            return read_profile(np.asarray(profile, np.uint8).tobytes()) or "srgb"
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause
    # EXIF knows sRGB, which is 1, and `uncalibrated`.
    if spec.get_int_attribute("Exif:ColorSpace", 1) != 1:
        words = f"{path}: its EXIF says that its colours are not sRGB, and not what they are: they are read as sRGB."
        warnings.warn(words, PictureWarning, stacklevel=4)
    return "srgb"


def _stored(file: Any, path: str | os.PathLike[str]) -> tuple[np.ndarray, Any]:
    """The numbers of the one picture of a file, "height width channels", as they are stored, and what it says."""
    spec = file.spec()
    if file.seek_subimage(1, 0):
        raise PictureError(f"{path}: has several pages, and one picture is wanted")
    file.seek_subimage(0, 0)
    file.geterror()  # That there is no second page is none.
    is_for_print = spec.get_string_attribute("jpeg:ColorSpace") in ("CMYK", "YCbCrK")
    if is_for_print or "CMYK" in spec.get_string_attribute("tiff:ColorSpace"):
        raise PictureError(f"{path}: is CMYK, for print; RGB is wanted")
    kind = str(spec.format)
    if kind not in INTEGERS and kind not in FLOATS:
        raise PictureError(
            f"{path}: has numbers of the kind {spec.format}; integers of up to 16 bits or floats are wanted"
        )
    if file.format_name() == "jpeg" and lacks_scans(read_bytes(path)):
        raise PictureError(f"{path}: is truncated: some of its picture is missing")
    stored = pixels_of(file, kind if kind in INTEGERS else "float", path)
    return undo_layout(stored, path) if file.format_name() == "tiff" else stored, spec


def _channels_of_colour(spec: Any) -> list[int]:
    """Places of the channels that are not alpha."""
    return [k for k in range(spec.nchannels) if k != spec.alpha_channel]


def _colors(stored: np.ndarray, spec: Any, path: str | os.PathLike[str]) -> np.ndarray:
    """The three channels of colour, by their names."""
    names = [name.upper() for name in spec.channelnames]
    if spec.alpha_channel >= 0:
        alpha = stored[..., spec.alpha_channel]
        transparent = int(np.sum(alpha != largest_number(stored)))
        if transparent:
            raise PictureError(f"{path}: {transparent:,} of its pixels are transparent, and opaque ones are wanted")
    if {"R", "G", "B"} <= set(names):
        return stored[..., [names.index(name) for name in "RGB"]]
    colors = _channels_of_colour(spec)
    if len(colors) == 1:
        return np.repeat(stored[..., colors], 3, axis=-1)
    raise PictureError(f"{path}: has the channels {', '.join(spec.channelnames)}, and R, G and B are wanted")
