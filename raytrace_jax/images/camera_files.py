"""JPEG and TIFF pictures, as cameras and scanners write them, read by OpenImageIO."""

import contextlib
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import DECODERS
from raytrace_jax.util.files import read_bytes

JPEG_MAGIC = b"\xff\xd8"
NAMED = {".jpg": {".jpg", ".jpeg", ".jpe"}, ".tif": {".tif", ".tiff"}}

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

INTEGERS = {oiio.UINT8: np.uint8, oiio.UINT16: np.uint16}
FLOATS = (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)


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
    with _opened(path) as file:
        return _read(file, path, transfer or "srgb")


def states_transfer(path: str | os.PathLike[str]) -> bool:
    """Whether a JPEG or TIFF says how its numbers were made from light: all do but TIFFs of integers without a profile.

    Raises:
        PictureError: the file is broken.
    """
    with _opened(path) as file:
        spec, name = file.spec(), file.format_name()
        return name == "jpeg" or spec.format.basetype in FLOATS or spec.getattribute("ICCProfile") is not None


@contextlib.contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[oiio.ImageInput]:
    """The file, opened as what it is: OpenImageIO would go by its name."""
    how = oiio.ImageSpec()
    how.attribute("oiio:UnassociatedAlpha", 1)
    suffix = ".jpg" if read_bytes(path, count=2, error=PictureError) == JPEG_MAGIC else ".tif"
    with contextlib.ExitStack() as stack:
        named = Path(path)
        if named.suffix.lower() not in NAMED[suffix]:
            named = Path(stack.enter_context(tempfile.TemporaryDirectory())) / f"picture{suffix}"
            shutil.copyfile(path, named)
        file = oiio.ImageInput.open(str(named), how)
        if file is None:
            raise PictureError(f"{path}: cannot be read: {_reason(oiio.geterror())}")
        stack.callback(file.close)
        yield file


def _read(file: oiio.ImageInput, path: str | os.PathLike[str], transfer: Transfer) -> np.ndarray:
    spec = file.spec()
    if file.seek_subimage(1, 0):
        raise PictureError(f"{path}: has several pages, and one picture is wanted")
    file.seek_subimage(0, 0)
    file.geterror()  # That there is no second page is none.
    if spec.get_string_attribute("jpeg:ColorSpace") == "CMYK" or "CMYK" in spec.get_string_attribute("tiff:ColorSpace"):
        raise PictureError(f"{path}: is CMYK, for print; RGB is wanted")
    kind = spec.format.basetype
    dtype = INTEGERS.get(kind, np.float32)
    if kind not in INTEGERS and kind not in FLOATS:
        raise PictureError(
            f"{path}: has numbers of the kind {spec.format}; integers of up to 16 bits or floats are wanted"
        )
    pixels = file.read_image(0, 0, 0, spec.nchannels, oiio.TypeDesc(kind if kind in INTEGERS else oiio.FLOAT))
    if pixels is None or file.has_error:
        raise PictureError(f"{path}: cannot be read: {_reason(file.geterror())}")
    stored = np.asarray(pixels, dtype).reshape(spec.height, spec.width, spec.nchannels)
    colors = _colors(stored, spec, path)
    orientation = spec.get_int_attribute("Orientation", 1)
    if orientation in TURNS and orientation != 1:
        colors = TURNS[orientation](colors)
        height, width, _ = colors.shape
        warnings.warn(
            f"{path} says that it is turned (orientation {orientation}): upright it is {width} x {height}.",
            PictureWarning,
            stacklevel=4,
        )
    picture = np.moveaxis(colors, -1, 0)
    if kind in INTEGERS:
        return np.ascontiguousarray(DECODERS[transfer](picture), np.float32)
    if not np.isfinite(picture).all():
        raise PictureError(f"{path}: {(~np.isfinite(picture)).sum()} of its numbers are NaN or infinite")
    return np.ascontiguousarray(picture, np.float32)


def _colors(stored: np.ndarray, spec: oiio.ImageSpec, path: str | os.PathLike[str]) -> np.ndarray:
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


def _reason(words: str) -> str:
    """The first line of what OpenImageIO says, without a full stop."""
    return (words.strip().splitlines() or ["it is broken"])[0].rstrip(".")
