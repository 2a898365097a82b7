"""Reading a picture of any format that is read, as scene-linear RGB; the contents decide which it is, not the name."""

import os

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images import camera_files
from raytrace_jax.images.camera_files import read_camera_file
from raytrace_jax.images.exr import read_rgb
from raytrace_jax.images.exr_parts import MAGIC as EXR_MAGIC
from raytrace_jax.images.hdr import MAGIC as HDR_MAGIC
from raytrace_jax.images.hdr import read_hdr
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import read_png, states_transfer
from raytrace_jax.images.png16 import SIGNATURE as PNG_SIGNATURE
from raytrace_jax.util.files import read_bytes

_KINDS = {
    PNG_SIGNATURE: "PNG",
    HDR_MAGIC: "Radiance HDR",
    b"\xff\xd8\xff": "JPEG",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",
    b"MM\0+": "TIFF",
}
"""Formats beside OpenEXR by how their files begin; a TIFF of more than 4 GB begins with `+`."""

_OTHER_FORMATS = {
    b"GIF8": "a GIF picture",
    b"BM": "a BMP picture",
    b"RIFF": "a WebP picture",
    b"PF": "a PFM picture",
    b"P3": "a PPM picture",
    b"P6": "a PPM picture",
    b"8BPS": "a Photoshop document",
    b"<svg": "an SVG drawing",
    b"%PDF": "a PDF document",
    b"camera": "a model file",
}


def read_picture(
    path: str | os.PathLike[str], *, transfer: Transfer | None = None, layer: str | None = None
) -> np.ndarray:
    """Read an OpenEXR, PNG, JPEG, TIFF or Radiance HDR picture as scene-linear float32 "3 height width", top row first.

    Args:
        path: the file.
        transfer: how the integers of a PNG, JPEG or TIFF were made, `course` or `srgb`; None is what the file says, and
            where it says nothing `course` of a PNG, `srgb` of the others. Floats are always scene-linear.
        layer: which layer of an OpenEXR file, when it is not obvious (see `exr.read_rgb`).

    Raises:
        PictureError: the file is missing or broken, is of another format, or has no such layer.
    """
    start = read_bytes(path, count=16, error=PictureError)
    if start.startswith(EXR_MAGIC):
        return read_rgb(path, layer=layer)
    kind = next((kind for magic, kind in _KINDS.items() if start.startswith(magic)), None)
    if kind is None:
        wanted = "an OpenEXR (.exr), PNG, JPEG, TIFF or Radiance HDR picture is wanted"
        raise PictureError(f"{path}: is {_describe(start)}, and {wanted}")
    if layer is not None:
        raise PictureError(f"{path}: is a {kind} picture and has no layers, so that there is no layer {layer!r}")
    if kind in ("JPEG", "TIFF"):
        return read_camera_file(path, transfer=transfer)
    return read_png(path, transfer=transfer) if kind == "PNG" else read_hdr(path)


def states_colours(path: str | os.PathLike[str]) -> bool:
    """Whether a picture's file says how its numbers were made from light: all do but some PNGs and TIFFs.

    Raises:
        PictureError: the file is missing or broken.
    """
    start = read_bytes(path, count=16, error=PictureError)
    kind = next((kind for magic, kind in _KINDS.items() if start.startswith(magic)), None)
    if kind in ("JPEG", "TIFF"):
        return camera_files.states_transfer(path)
    return kind != "PNG" or states_transfer(path)


def _describe(start: bytes) -> str:
    if not start:
        return "empty"
    known = (name for magic, name in _OTHER_FORMATS.items() if start.startswith(magic))
    return next(known, f"of an unknown format (it starts with {start[:4]!r})")
