"""The parts of an OpenEXR file of any program: checked, decoded and placed in the display window."""

import contextlib
import io
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
import OpenEXR

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.util.files import read_bytes

MAGIC = b"\x76\x2f\x31\x01"
"""The first four bytes of every OpenEXR file."""

# PXR24 drops bits of 32-bit floats only, B44 and B44A those of halfs only.
_LOSSY = {"DWAA": (2, 4), "DWAB": (2, 4), "LJ2K": (2, 4), "B44": (2,), "B44A": (2,), "PXR24": (4,)}


def load_parts(path: str | os.PathLike[str]) -> list[OpenEXR.Part]:
    """Return the parts with their pixels, after checks that OpenEXR leaves to its caller."""
    start = read_bytes(path, count=4, error=PictureError)
    if start != MAGIC:
        what = "is empty" if not start else "is not an OpenEXR file (its first bytes differ)"
        raise PictureError(f"{path}: {what}")
    try:
        headers = OpenEXR.File(str(path), separate_channels=True, header_only=True).parts
        for part in headers:
            _refuse_unsupported(path, part)
        # OpenEXR only prints when it cannot read a part, and leaves that part out.
        with contextlib.redirect_stdout(io.StringIO()):
            parts = OpenEXR.File(str(path), separate_channels=True).parts
    except (RuntimeError, ValueError, MemoryError) as cause:
        raise PictureError(f"{path}: is a truncated or broken OpenEXR file: {cause}") from cause
    if not parts or len(parts) != len(headers):
        raise PictureError(f"{path}: is a truncated or broken OpenEXR file: some of its pixels cannot be read")
    return parts


def _refuse_unsupported(path: str | os.PathLike[str], part: OpenEXR.Part) -> None:
    if part.type() not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise PictureError(f"{path}: has deep pixels ({part.type().name}), and a flat picture is wanted")
    for channel in part.header["channels"]:
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise PictureError(f"{path}: channel {channel.name} is subsampled; save the picture with R, G, B instead")


def named_channels(path: str | os.PathLike[str], parts: list[OpenEXR.Part]) -> dict[str, np.ndarray]:
    """Return "height width" float32 or uint32 arrays, the size of the display window, by channel name.

    If two parts have a channel of the same name, their channels get the part's name in front.
    """
    counts = Counter(name for part in parts for name in part.channels)
    channels = {}
    for part in parts:
        clashes = any(counts[name] > 1 for name in part.channels)
        prefix = f"{part.name()}." if clashes else ""
        for name, channel in part.channels.items():
            channels[prefix + name] = _in_display_window(path, channel.pixels, part.header)
    return channels


def _in_display_window(path: str | os.PathLike[str], pixels: np.ndarray, header: Mapping[str, Iterable]) -> np.ndarray:
    pixels = pixels.astype(np.float32) if pixels.dtype == np.float16 else pixels
    (data_left, data_top), (data_right, data_bottom) = header["dataWindow"]
    (left, top), (right, bottom) = header["displayWindow"]
    if (data_left, data_top, data_right, data_bottom) == (left, top, right, bottom):
        return pixels
    if data_left > right or data_right < left or data_top > bottom or data_bottom < top:
        raise PictureError(f"{path}: its pixels lie outside of its display window")
    # Both windows include their last pixel.
    rows = slice(max(data_top, top), min(data_bottom, bottom) + 1)
    columns = slice(max(data_left, left), min(data_right, right) + 1)
    height, width = int(bottom) - int(top) + 1, int(right) - int(left) + 1
    try:
        placed = np.zeros((height, width), pixels.dtype)
    except MemoryError as cause:
        raise PictureError(
            f"{path}: its display window, {width} x {height} pixels, does not fit into memory"
        ) from cause
    placed[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = pixels[
        rows.start - data_top : rows.stop - data_top, columns.start - data_left : columns.stop - data_left
    ]
    return placed


def compression_name(part: OpenEXR.Part) -> str:
    """Return the compression's name, such as `ZIP`."""
    return part.compression().name.removesuffix("_COMPRESSION")


def warn_if_lossy(path: str | os.PathLike[str], parts: list[OpenEXR.Part]) -> None:
    """Warn once if the compression of any part has changed the pixels of any of its channels."""
    for part in parts:
        sizes = _LOSSY.get(compression_name(part), ())
        if any(
            channel.pixels.dtype.itemsize in sizes and channel.pixels.dtype.kind == "f"
            for channel in part.channels.values()
        ):
            message = (
                f"{path}: was stored with the lossy compression {compression_name(part)}; its pixels are not exact"
            )
            warnings.warn(message, PictureWarning, stacklevel=4)
            return
