"""Reading a picture of any format that is read, as scene-linear RGB; the contents decide which it is, not the name."""

import os
from typing import Any, NamedTuple

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images import camera_files
from raytrace_jax.images.camera_files import read_camera_file, read_painted
from raytrace_jax.images.exr import exr_origin, read_rgb
from raytrace_jax.images.exr_parts import MAGIC as EXR_MAGIC
from raytrace_jax.images.hdr import MAGIC as HDR_MAGIC
from raytrace_jax.images.hdr import read_hdr
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.other_formats import describe
from raytrace_jax.images.png import png_origin, read_png, states_transfer
from raytrace_jax.images.png_chunks import SIGNATURE as PNG_SIGNATURE
from raytrace_jax.images.ppm import has_long_numbers, read_ppm
from raytrace_jax.util.files import read_bytes

_KINDS = {
    PNG_SIGNATURE: "PNG",
    HDR_MAGIC: "Radiance HDR",
    b"\xff\xd8\xff": "JPEG",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",
    b"MM\0+": "TIFF",
    b"P3": "PPM",
    b"P6": "PPM",
}
"""Formats beside OpenEXR by how their files begin; a TIFF of more than 4 GB begins with `+`."""

PAINTED = ("PNG", "JPEG", "TIFF")
"""Formats in which masks are painted."""


def read_picture(
    path: str | os.PathLike[str], *, transfer: Transfer | None = None, layer: str | None = None
) -> np.ndarray:
    """Read an OpenEXR, PNG, JPEG, TIFF, PPM or Radiance HDR picture as scene-linear float32 "3 height width".

    The top row is the first.

    Args:
        path: the file.
        transfer: how the integers of a PNG, JPEG, TIFF or PPM were made, `course` or `srgb`; None is what the file
            says, and where it says nothing `course` of a PNG or PPM, `srgb` of the others. Floats are always
            scene-linear.
        layer: which layer of an OpenEXR file, when it is not obvious (see `exr.read_rgb`).

    Returns:
        The picture.

    Raises:
        PictureError: the file is missing or broken, is of another format, or has no such layer.
    """
    start = read_bytes(path, count=64, error=PictureError)
    if start.startswith(EXR_MAGIC):
        return read_rgb(path, layer=layer)
    kind = _kind(path)
    if kind is None:
        wanted = "an OpenEXR (.exr), PNG, JPEG, TIFF, PPM or Radiance HDR picture is wanted"
        raise PictureError(f"{path}: is {describe(start, wanted)}")
    if layer is not None:
        raise PictureError(f"{path}: is a {kind} picture and has no layers, so that there is no layer {layer!r}")
    if kind in ("JPEG", "TIFF"):
        return read_camera_file(path, transfer=transfer)
    if kind == "PPM":
        return read_ppm(path, transfer=transfer)
    return read_png(path, transfer=transfer) if kind == "PNG" else read_hdr(path)


def states_colours(path: str | os.PathLike[str]) -> bool:
    """Whether a picture's file says how its numbers were made from light: all do but PPMs, and some PNGs and TIFFs.

    Raises:
        PictureError: the file is missing or broken.
    """
    kind = _kind(path)
    if kind in ("JPEG", "TIFF"):
        return camera_files.states_transfer(path)
    return kind != "PPM" and (kind != "PNG" or states_transfer(path))


def transfer_of_camera(path: str | os.PathLike[str]) -> Transfer | None:
    """How a camera has made the numbers of a file that does not say it: None where it does, as `states_colours`.

    Of 8 bits it is `srgb`, as cameras store pictures for screens; numbers of more bits mostly count light: `course`.
    """
    if states_colours(path):
        return None
    kind = _kind(path)
    if kind == "PNG":
        is_long = read_bytes(path, count=25, error=PictureError)[-1] > 8
    else:
        is_long = has_long_numbers(path) if kind == "PPM" else camera_files.has_long_numbers(path)
    return "course" if is_long else "srgb"


class Origin(NamedTuple):
    """Where a picture comes from, as its file says.

    Args:
        how_made: the metadata that this program writes into OpenEXR and PNG files; empty for all others.
        maker: the program that rendered it (`generatedBy` of OpenEXR and PNG); empty if none is named.
    """

    how_made: dict[str, Any]
    maker: str


def read_origin(path: str | os.PathLike[str]) -> Origin:
    """Where a picture comes from. Raises PictureError: the file is missing or broken."""
    if read_bytes(path, count=4, error=PictureError) == EXR_MAGIC:
        return Origin(*exr_origin(path))
    return Origin(*png_origin(path)) if _kind(path) == "PNG" else Origin({}, "")


def read_mask(path: str | os.PathLike[str]) -> np.ndarray:
    """Read weights "height width": 0 leaves a pixel out, 1 counts in full.

    Of an OpenEXR or Radiance HDR picture they are the means of its channels, 0 or more. Of others, as an editor paints
    them, they are how bright and how opaque a pixel is, from 0 to 1.

    Args:
        path: the file.

    Returns:
        The weights.

    Raises:
        PictureError: the file is missing or broken, or of another format.
    """
    if _kind(path) in PAINTED:
        return read_painted(path)
    return read_picture(path).mean(axis=0)


def stores_integers(path: str | os.PathLike[str]) -> bool:
    """Whether a picture's file stores integers, which have a largest one. Raises PictureError if it is broken."""
    kind = _kind(path)
    return kind in ("PNG", "PPM") or (kind in PAINTED and camera_files.has_integers(path))


def is_photograph(path: str | os.PathLike[str]) -> bool:
    """Whether a picture is of a format that cameras write: a JPEG or a TIFF. Raises PictureError if it is missing."""
    return _kind(path) in ("JPEG", "TIFF")


def is_jpeg(path: str | os.PathLike[str]) -> bool:
    """Whether a picture is a JPEG. Raises PictureError if it is missing."""
    return _kind(path) == "JPEG"


def _kind(path: str | os.PathLike[str]) -> str | None:
    """The format of a file; None for OpenEXR and for what is not read."""
    start = read_bytes(path, count=16, error=PictureError)
    return next((kind for magic, kind in _KINDS.items() if start.startswith(magic)), None)
