"""Pictures of any format, known by their contents and not by their names."""

import contextlib
import warnings

import numpy as np
from PIL import Image

from ..errors import PictureError, RaytraceWarning
from ..util.files import StrPath, read_bytes
from . import Transfer
from .camera_files import RAW, RAW_STARTS, JpegFile, TiffFile
from .exr import MAGIC, ExrFile
from .hdr_ppm import HdrFile, PpmFile
from .picture_file import PictureFile, PictureOrigin
from .png import SIGNATURE, PngFile

FORMATS: dict[type[PictureFile], tuple[bytes, ...]] = {
    ExrFile: (MAGIC,),
    PngFile: (SIGNATURE,),
    HdrFile: (b"#?",),
    JpegFile: (b"\xff\xd8\xff",),
    TiffFile: (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    PpmFile: (b"P3", b"P6"),
}
"""How files of each format begin; a TIFF of more than 4 GB begins with `+`."""


def read(path: StrPath, *, layer: str | None = None) -> PictureFile:
    """The file of a picture: its numbers, what they mean and where they are from, each read when it is asked for.

    The layer is one of an OpenEXR file, when it is not obvious: `R G B`, else the only layer with R, G, B (`img.R`),
    else the only one called `Combined`. All functions here raise PictureError of a file that is missing, broken, or of
    a format that is not read.
    """
    kind = _class_of(path)
    if kind is None:
        raise PictureError(f"{path}: {_described(path)}")
    if kind is ExrFile:
        return ExrFile(path, layer)
    if layer is not None:
        raise PictureError(f"{path}: is a {kind.format} picture and has no layers, so that there is no layer {layer!r}")
    return kind(path)


def read_picture(path: StrPath, *, transfer: Transfer | None = None, layer: str | None = None) -> np.ndarray:
    """Read an OpenEXR, PNG, JPEG, TIFF, PPM or Radiance HDR picture as scene-linear float32 "3 height width".

    The top row is the first; a grey picture has three equal channels; what EXIF says of how it is turned is obeyed.

    Args:
        transfer: how the integers of a PNG, JPEG, TIFF or PPM were made, `course` or `srgb`; None is what the file
            says, and where it says nothing `course` of a PNG or PPM, `srgb` of the others. Floats are always
            scene-linear.
        layer: which layer of an OpenEXR file, when it is not obvious (see `read`).

    Returns:
        The picture. Pixels outside of an OpenEXR file's data window are not stored: they are masked (`numpy.ma`), and
        have no weight in a fit; below the mask they are black.

    Raises:
        PictureError: the file is missing or broken, is of another format, has no such layer, or does not fit into
            memory; a pixel is transparent, NaN or infinite; what it says of its colours is not known.

    Warns:
        RaytraceWarning: it was turned upright, or converted from other primaries; its compression has changed it; its
            pixels are not square, and are read as if they were; some are not stored.
    """
    light = read(path, layer=layer).light(transfer)
    if absent := _absent(light):
        warnings.warn(f"{path}: {absent}; they have no weight.", RaytraceWarning, stacklevel=2)
    return light


def read_whole_picture(path: StrPath, transfer: Transfer | None = None) -> np.ndarray:
    """As `read_picture`, but for a PictureError of a picture some of whose pixels are not stored."""
    light = read(path).light(transfer)
    if absent := _absent(light):
        raise PictureError(f"{path}: {absent}, and a whole picture is wanted")
    return light


def _absent(light: np.ndarray) -> str:
    """How many pixels of a picture are not stored, as the beginning of a sentence; empty if all are."""
    missing = np.ma.getmaskarray(light)[0]
    are = "are" if missing.sum() > 1 else "is"
    words = f"{missing.sum():,} of its {missing.size:,} pixels {are} not stored, outside of its data window"
    return words if missing.any() else ""


def read_origin(path: StrPath) -> PictureOrigin:
    """Where a picture comes from; nothing of one that is not read."""
    return PictureOrigin({}, "") if _class_of(path) is None else read(path).origin()


def states_colours(path: StrPath) -> bool:
    """Whether a picture's file says how its numbers were made from light: all do but PPMs, and some PNGs and TIFFs."""
    file = read(path)
    return file.bits() == 0 or file.meaning() is not None


def transfer_of_camera(path: StrPath) -> Transfer | None:
    """How a camera has made the numbers of a file that does not say it: None where it does, as `states_colours`.

    Of 8 bits it is `srgb`, as cameras store pictures for screens; numbers of more bits mostly count light: `course`.
    """
    return None if states_colours(path) else "course" if read(path).bits() > 8 else "srgb"


def is_photograph(path: StrPath) -> bool:
    """Whether a picture is of a format that cameras write: a JPEG or a TIFF."""
    return _class_of(path) in (JpegFile, TiffFile)


def is_jpeg(path: StrPath) -> bool:
    """Whether a file is a JPEG, by its first bytes."""
    return _class_of(path) is JpegFile


def _class_of(path: StrPath) -> type[PictureFile] | None:
    """The format of a file; None for what is not read."""
    start = read_bytes(path, count=16, error=PictureError)
    kinds = (kind for kind, magic in FORMATS.items() if start.startswith(magic) and not start.startswith(RAW_STARTS))
    return next(kinds, None)


def _described(path: StrPath) -> str:
    """What a file that is not read is, and what to do."""
    start = read_bytes(path, count=64)
    if start.startswith(RAW_STARTS) or start[4:12] == b"ftypcrx ":
        return RAW
    if start[4:11] in (b"ftyphei", b"ftypmif", b"ftypmsf") and b"avif" not in start:
        name = "a HEIC picture, as telephones write them"
    else:
        name = f"of an unknown format (it starts with {start[:4]!r})" if start else "empty"
        with warnings.catch_warnings(), contextlib.suppress(OSError, Image.DecompressionBombError):
            warnings.simplefilter("ignore")
            with Image.open(path) as picture:
                name = f"a picture of another format ({picture.format_description})"
    wanted = "an OpenEXR (.exr), PNG, JPEG, TIFF, PPM or Radiance HDR picture is wanted"
    return f"is {name}, and {wanted}: ImageMagick converts others, as by `magick FILE FILE.png`"
