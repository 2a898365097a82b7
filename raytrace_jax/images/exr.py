"""OpenEXR files: scene-linear float channels by name, and our metadata, exact, as one JSON string.

Arrays are "height width" with the top row first, as the file has them. Channel names are layers:
`ViewLayer.Combined.R` is the component `R` of the layer `ViewLayer.Combined`.
"""

import contextlib
import io
import json
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from jax.typing import ArrayLike

from ..errors import PictureError, RaytraceWarning
from ..util.files import atomic_write, read_bytes
from ..util.numerics import real_numbers
from ..util.text import did_you_mean
from .picture_file import KEY, refuse_beyond_memory, to_json

MAGIC = b"\x76\x2f\x31\x01"
"""The first four bytes of every OpenEXR file."""

RGB = ("R", "G", "B")

# Compressions by the floats that they change: PXR24 drops bits of 32-bit floats only, B44 those of halfs.
_LOSSY = {**dict.fromkeys(("DWAA", "DWAB", "LJ2K"), ("f2", "f4")), "B44": ("f2",), "B44A": ("f2",), "PXR24": ("f4",)}


@dataclass(frozen=True, eq=False)
class ExrPicture:
    """What an OpenEXR file holds."""

    channels: dict[str, np.ndarray]  # "height width" by their full names, float32 (a half is exact in it) or uint32.
    metadata: dict[str, object]  # What `write_exr` was given; empty for the files of other programs.
    compression: str  # Of the first part, such as `ZIP`.
    attributes: dict[str, dict[str, Any]]
    """What the file says of each channel: the header of its part, and what that leaves out as the first part has it."""


def write_exr(
    path: str | os.PathLike[str],
    channels: Mapping[str, object] | ArrayLike,
    *,
    metadata: Mapping[str, object] | None = None,
    half: bool = False,
) -> None:
    """Write named channels, ZIP-compressed (lossless); the file appears only when it is whole.

    Args:
        path: missing folders are made.
        channels: "height width" real numbers by channel name (`R`, `depth.Z`), top row first, scene-linear; or a
            picture, "3 height width", whose channels are R, G and B.
        metadata: anything JSON can hold, NumPy and JAX numbers and arrays too; numbers come back exactly.
        half: store 16-bit floats (largest value 65504) in place of 32-bit ones.

    Raises:
        PictureError: a channel is not a finite picture, or too large for the format, or differs in shape; the
            metadata is not JSON; the file cannot be written.
    """
    where = f"{path}: cannot be written"
    if not isinstance(channels, Mapping):
        wanted = "an array of shape (3, height, width) or channels by their names"
        try:
            picture = real_numbers(channels)
        except ValueError as reason:
            raise PictureError(f"{where}: this {reason}, as {wanted}") from None
        if picture.ndim != 3 or len(picture) != 3:
            raise PictureError(f"{where}: {wanted} is wanted, not {type(channels).__name__} of shape {picture.shape}")
        channels = dict(zip(RGB, picture, strict=True))
    dtype = np.float16 if half else np.float32
    pixels = {name: _storable(where, name, values, dtype) for name, values in channels.items()}
    if len({array.shape for array in pixels.values()}) != 1:
        what = ", ".join(f"{name} {array.shape}" for name, array in pixels.items()) or "no channels"
        raise PictureError(f"{where}: channels of one shape are wanted, not {what}")
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": "raytrace_jax",
        # OpenEXR stores float attributes as float32 and large integers as 0: one string keeps numbers exact.
        KEY: to_json(path, metadata or {}),
    }
    with atomic_write(path, error=PictureError) as temporary:
        try:
            with temporary.open("wb") as file:
                OpenEXR.File(header, pixels).write(file)
        except RuntimeError as cause:
            raise PictureError(f"{where}: {cause}") from cause


def _storable(where: str, name: str, values: object, dtype: type[np.floating]) -> np.ndarray:
    """A contiguous array of the stored type. Raises PictureError for what the file cannot hold truthfully."""
    if not isinstance(name, str) or not name or "\0" in name:
        raise PictureError(f"{where}: {name!r} is not a channel name")
    try:
        array = real_numbers(values)
    except ValueError as reason:
        raise PictureError(f"{where}: channel {name} {reason}") from None
    if array.ndim != 2 or array.size == 0:
        raise PictureError(f"{where}: channel {name} has the shape {array.shape}, and (height, width) is wanted")
    refuse_not_finite(where, name, array)
    # A non-contiguous array would be written as wrong pixels, silently.
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(array.astype(dtype))
    if not np.isfinite(stored).all():
        reached = np.abs(array.astype(np.float64)).max()
        raise PictureError(f"{where}: channel {name} reaches {reached:g}, and half ends at 65504, float at 3.4e38")
    return stored


def refuse_not_finite(where: str, name: str, array: np.ndarray) -> None:
    """Raise PictureError if a channel has NaN or infinite pixels; `where` begins the sentence."""
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        first = f"the first in row {bad[0, 0]}, column {bad[0, 1]}"
        raise PictureError(f"{where}: channel {name} has {len(bad)} pixels that are NaN, infinite or masked, {first}")


def read_exr(path: str | os.PathLike[str], *, layer: str | None = None) -> ExrPicture:
    """Read all channels of an OpenEXR file, whichever program wrote it; scanlines or tiles, one part or many.

    Pixels are placed in the display window: zero where the data window has none, cropped where it is larger.
    If two parts have a channel of the same name, their channels get the part's name in front.

    Args:
        layer: keep only this layer's channels (under their full names); its last word will do if only one ends so.

    Returns:
        The channels by name, with what the file says besides.

    Raises:
        PictureError: the file is missing, is not an OpenEXR file, is truncated or broken, has deep or subsampled
            pixels, or has no such layer.

    Warns:
        RaytraceWarning: the compression has changed the pixels, or the metadata cannot be read.
    """
    parts = _load_parts(path)
    counts = Counter(name for part in parts for name in part.channels)
    channels: dict[str, np.ndarray] = {}
    attributes: dict[str, dict[str, Any]] = {}
    compressions, lossy = [part.compression().name.removesuffix("_COMPRESSION") for part in parts], set()
    for part, compression in zip(parts, compressions, strict=True):
        prefix = f"{part.name()}." if any(counts[name] > 1 for name in part.channels) else ""
        for name, channel in part.channels.items():
            channels[prefix + name] = in_display_window(path, channel.pixels, part.header)
            attributes[prefix + name] = {**parts[0].header, **part.header}
            lossy |= {compression} if channel.pixels.dtype.str[1:] in _LOSSY.get(compression, ()) else set()
    if lossy:
        words = f"{path}: was stored with the lossy compression {' and '.join(lossy)}; its pixels are not exact"
        warnings.warn(words, RaytraceWarning, stacklevel=2)
    if layer is not None:
        prefix = find_layer(channels, layer, str(path))
        channels = {name: array for name, array in channels.items() if name.rpartition(".")[0] == prefix}
    attributes = {name: attributes[name] for name in channels}
    return ExrPicture(channels, read_metadata(path, parts[0].header), compressions[0], attributes)


def opened(path: str | os.PathLike[str], **how: bool) -> OpenEXR.File:
    """What OpenEXR reads of a file: as a stream, since a name need not be UTF-8, and OpenEXR's have to."""
    with Path(path).open("rb") as file:
        return OpenEXR.File(file, **how)


def _load_parts(path: str | os.PathLike[str]) -> list[OpenEXR.Part]:
    """Return the parts with their pixels, after checks that OpenEXR leaves to its caller."""
    if read_bytes(path, count=4, error=PictureError) != MAGIC:
        raise PictureError(f"{path}: is not an OpenEXR file (its first bytes differ)")
    try:
        headers = opened(path, separate_channels=True, header_only=True).parts
        for part in headers:
            if part.type() not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
                raise PictureError(f"{path}: has deep pixels ({part.type().name}), and a flat picture is wanted")
            halved = [one.name for one in part.header["channels"] if (one.xSampling, one.ySampling) != (1, 1)]
            if halved:
                raise PictureError(f"{path}: channel {halved[0]} is subsampled; save the picture with R, G, B instead")
        for kind in ("display", "data"):
            # A channel is read into four bytes a pixel.
            height, width = np.max([np.subtract(*_window(part.header, f"{kind}Window")[::-1]) for part in headers], 0)
            channels = sum(len(part.header["channels"]) for part in headers)
            refuse_beyond_memory(path, f"{kind} window", int(width), int(height), bytes_per_pixel=4 * channels)
        # OpenEXR only prints when it cannot read a part, and leaves that part out.
        with contextlib.redirect_stdout(io.StringIO()):
            parts = opened(path, separate_channels=True).parts
    except (RuntimeError, ValueError, MemoryError) as cause:
        raise PictureError(f"{path}: is a truncated or broken OpenEXR file: {cause}") from cause
    if not parts or len(parts) != len(headers):
        raise PictureError(f"{path}: is a truncated or broken OpenEXR file: some of its pixels cannot be read")
    return parts


def _window(header: Mapping[str, Iterable], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The (row, column) of a window's first pixel, and of the one behind its last."""
    # The header has (x, y), and the last itself.
    first, last = (np.array(corner, np.int64)[::-1] for corner in header[name])
    return first, last + 1


def in_display_window(path: str | os.PathLike[str], pixels: np.ndarray, header: Mapping[str, Iterable]) -> np.ndarray:
    """A channel of the data window where the picture is shown, 0 where it has no pixels; a half as float32."""
    pixels = pixels.astype(np.float32) if pixels.dtype == np.float16 else pixels
    (data, data_end), (shown, shown_end) = (_window(header, name) for name in ("dataWindow", "displayWindow"))
    if np.array_equal((data, data_end), (shown, shown_end)):
        return pixels
    first, end = np.maximum(data, shown), np.minimum(data_end, shown_end)
    if np.any(first >= end):
        raise PictureError(f"{path}: its pixels lie outside of its display window")
    placed = np.zeros(shown_end - shown, pixels.dtype)
    to, source = (tuple(map(slice, first - start, end - start)) for start in (shown, data))
    placed[to] = pixels[source]
    return placed


def stored_pixels(path: str | os.PathLike[str], header: Mapping[str, Iterable]) -> np.ndarray:
    """Which pixels of the display window the data window has, "height width"."""
    first, end = _window(header, "dataWindow")
    return in_display_window(path, np.ones(end - first, bool), header)


def read_metadata(path: str | os.PathLike[str], header: Mapping[str, object]) -> dict[str, object]:
    """What `write_exr` was given; a RaytraceWarning tells if that is broken."""
    with contextlib.suppress(TypeError, json.JSONDecodeError):
        if isinstance(metadata := json.loads(header.get(KEY, "{}")), dict):  # pyright: ignore[reportArgumentType]
            return metadata
    warnings.warn(f"{path}: the attribute {KEY} is not a JSON object and is left out", RaytraceWarning, stacklevel=3)
    return {}


def by_layer(names: Iterable[str]) -> dict[str, set[str]]:
    """The components of every layer; channels without a layer, such as `R`, belong to the layer ''."""
    layers: dict[str, set[str]] = {}
    for layer, _, component in (name.rpartition(".") for name in names):
        layers.setdefault(layer, set()).add(component)
    return dict(sorted(layers.items()))


def find_layer(names: Iterable[str], wanted: str, where: str) -> str:
    """The full name of the layer `wanted`, which may be only its end: `Combined` for `ViewLayer.Combined`."""
    layers = list(by_layer(names))
    if wanted in layers:
        return wanted
    ends = [layer for layer in layers if layer.endswith(f".{wanted}")]
    if len(ends) == 1:
        return ends[0]
    hint = " Give the full name." if ends else did_you_mean(wanted, layers)
    raise PictureError(f"{where}: has not one layer {wanted!r}; its layers are {str(layers)[1:-1]}.{hint}")
