"""What the EXIF of a JPEG, PNG or TIFF says, and pictures turned upright as it says."""

import os
import struct
import warnings
from typing import Any

import numpy as np
from PIL.ExifTags import IFD, Base
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.tiff_layout import directories
from raytrace_jax.util.files import read_bytes

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

BACK = {6: 8, 8: 6}
"""Which of EXIF's orientations undoes one, where it does not undo itself."""


def exif_of(path: str | os.PathLike[str]) -> dict[int, Any]:
    """The values of EXIF by their tags; none where a file has no EXIF, or a broken one. Pillow reads them.

    Raises:
        PictureError: the file is missing.
    """
    start = read_bytes(path, count=4, error=PictureError)
    reads = {b"\xff\xd8": JpegImageFile, b"\x89P": PngImageFile}.get(start[:2])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # What Pillow says of broken EXIF.
            if reads is not None:
                with reads(os.fspath(path)) as image:
                    exif = image.getexif()
                    return {**exif, **exif.get_ifd(IFD.Exif)}
            if start[:2] in (b"II", b"MM"):
                first = next(directories(path))
                inner = next(directories(path, first[IFD.Exif])) if IFD.Exif in first else {}
                return {**first, **inner}
    except (OSError, EOFError, SyntaxError, ValueError, LookupError, TypeError, ArithmeticError, struct.error):
        pass
    return {}


def orientation_of(path: str | os.PathLike[str]) -> int:
    """How a file says that its picture is turned, as EXIF numbers it: 1 is upright. Raises as `exif_of`."""
    orientation = exif_of(path).get(Base.Orientation, 1)
    return int(orientation) if orientation in TURNS else 1


def upright(colors: np.ndarray, path: str | os.PathLike[str]) -> np.ndarray:
    """A picture "height width channels" as it is stored, turned as its file says.

    Warns:
        PictureWarning: it was turned.
    """
    orientation = orientation_of(path)
    if orientation == 1:
        return colors
    colors = TURNS[orientation](colors)
    height, width, _ = colors.shape
    warnings.warn(
        f"{path} says that it is turned (orientation {orientation}): upright it is {width} x {height}.",
        PictureWarning,
        stacklevel=5,
    )
    return colors
