"""OpenEXR pictures: scene-linear float channels by name, and exact metadata as one JSON string.

Arrays are "height width" with the top row first, as the file has them.
"""

import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import OpenEXR
from jax.typing import ArrayLike

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.colour_spaces import Chromaticities, ColourSpace, power, tell_primaries, to_rec_709
from raytrace_jax.images.exr_layers import find_layer, rgb_channels
from raytrace_jax.images.exr_parts import compression_name, load_parts, named_channels, warn_if_lossy
from raytrace_jax.images.metadata import KEY, to_json
from raytrace_jax.util.files import atomic_write


@dataclass(frozen=True, eq=False)
class ExrPicture:
    """What an OpenEXR file holds.

    Args:
        channels: "height width" arrays by their full names, float32 (a half is exact in it) or uint32.
        metadata: what `write_exr` was given; empty for the files of other programs.
        compression: the name of the compression of the first part, such as `ZIP`.
        chromaticities: the primaries and the white of R, G and B; None where the file does not say, which by the
            standard means Rec. 709.
    """

    channels: dict[str, np.ndarray]
    metadata: dict[str, object]
    compression: str
    chromaticities: Chromaticities | None = None


def write_exr(
    path: str | os.PathLike[str],
    channels: Mapping[str, object] | ArrayLike,
    *,
    metadata: Mapping[str, object] | None = None,
    half: bool = False,
) -> None:
    """Write named channels, ZIP-compressed (lossless); the file appears only when it is whole.

    Args:
        path: the file; missing folders are made.
        channels: "height width" real numbers by channel name (`R`, `depth.Z`), top row first, scene-linear; or a
            picture, "3 height width", whose channels are R, G and B.
        metadata: anything JSON can hold, NumPy and JAX numbers and arrays too; numbers come back exactly.
        half: store 16-bit floats (largest value 65504) in place of 32-bit ones.

    Raises:
        PictureError: a channel is not a finite picture, or too large for the format, or differs in shape; the
            metadata is not JSON; the file cannot be written.
    """
    # A picture is three channels; all have to be of one shape and fit the format.
    if not isinstance(channels, Mapping):
        if np.ndim(channels) != 3 or np.shape(channels)[0] != 3:
            what = f"an array of shape {np.shape(channels)}" if hasattr(channels, "shape") else type(channels).__name__
            wanted = "an array of shape (3, height, width) or channels by their names"
            raise PictureError(f"{path}: cannot be written: {wanted} is wanted, not {what}")
        channels = dict(zip("RGB", np.asarray(channels), strict=True))
    pixels = {name: _storable(path, name, values, half) for name, values in channels.items()}
    shapes = {name: array.shape for name, array in pixels.items()}
    if len(set(shapes.values())) != 1:
        what = ", ".join(f"{name} {shape}" for name, shape in shapes.items()) or "no channels"
        raise PictureError(f"{path}: cannot be written: channels of one shape are wanted, not {what}")

    # OpenEXR names the temporary file in its errors; users know the one they asked for.
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": "raytrace_jax",
        # OpenEXR stores float attributes as float32 and large integers as 0: one string keeps numbers exact.
        KEY: to_json(path, metadata or {}),
    }
    with atomic_write(path, error=PictureError) as temporary:
        try:
            OpenEXR.File(header, pixels).write(str(temporary))
        except RuntimeError as cause:
            reason = str(cause).replace(str(temporary), str(path))
            raise PictureError(f"{path}: cannot be written: {reason}") from cause


def read_exr(path: str | os.PathLike[str], *, layer: str | None = None) -> ExrPicture:
    """Read all channels of an OpenEXR file, whichever program wrote it; scanlines or tiles, one part or many.

    Pixels are placed in the display window: zero where the data window has none, cropped where it is larger.
    If two parts have a channel of the same name, their channels get the part's name in front.

    Args:
        path: the file.
        layer: keep only this layer's channels (under their full names); its last word will do if only one ends so.

    Returns:
        The channels by name, with what the file says besides.

    Raises:
        PictureError: the file is missing, is not an OpenEXR file, is truncated or broken, has deep or subsampled
            pixels, or has no such layer.

    Warns:
        PictureWarning: the compression has changed the pixels, or the metadata cannot be read.
    """
    parts = load_parts(path)
    channels = named_channels(path, parts)
    warn_if_lossy(path, parts)
    if layer is not None:
        prefix = find_layer(channels, layer, where=str(path))
        channels = {name: array for name, array in channels.items() if name.rpartition(".")[0] == prefix}
    stated = next((part.header["chromaticities"] for part in parts if "chromaticities" in part.header), None)
    return ExrPicture(
        channels,
        _read_metadata(path, parts[0].header),
        compression_name(parts[0]),
        None if stated is None else tuple(map(float, stated)),
    )


def exr_origin(path: str | os.PathLike[str]) -> tuple[dict[str, object], str]:
    """The metadata of `write_exr`, and the program that rendered the picture, empty where nothing says it; no pixels.

    Raises:
        PictureError: the file is broken.
    """
    try:
        header = OpenEXR.File(str(path), header_only=True).parts[0].header
    except (RuntimeError, ValueError, IndexError) as cause:
        raise PictureError(f"{path}: is a truncated or broken OpenEXR file: {cause}") from cause
    return _read_metadata(path, header), str(header.get("generatedBy", ""))


def read_rgb(path: str | os.PathLike[str], *, layer: str | None = None) -> np.ndarray:
    """Read the picture of an OpenEXR file as float32 "3 height width", scene-linear; a grey one three times.

    An alpha channel is left out: colours in OpenEXR are premultiplied, that is, already over black.

    Args:
        path: the file.
        layer: which layer, when it is not obvious: `R G B`, else the only layer with R, G, B (`img.R`), else the
            only one called `Combined`.

    Raises:
        PictureError: as `read_exr`; also if no layer is the obvious one, a pixel is NaN or infinite, or its primaries
            are none.

    Warns:
        PictureWarning: as `read_exr`; also if its primaries are not Rec. 709's: its light is converted to these.
    """
    exr = read_exr(path)
    channels = exr.channels
    names = rgb_channels(channels, layer, where=str(path))
    for name in names:
        _refuse_not_finite(f"{path}: cannot be used as a picture", name, channels[name])
    picture = np.stack([channels[name] for name in names]).astype(np.float32, copy=False)
    is_grey = len(set(names)) == 1
    if exr.chromaticities is None or is_grey:
        return picture
    try:
        space = ColourSpace("by chromaticities", power(1.0), to_rec_709(exr.chromaticities))
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause
    if space.to_rec_709 is None:
        return picture
    tell_primaries(path, space)
    return np.moveaxis(space.decode(np.moveaxis(picture, 0, -1)), -1, 0).astype(np.float32)


def _storable(path: str | os.PathLike[str], name: str, values: object, half: bool) -> np.ndarray:
    """Return a contiguous array of the stored type, or refuse what the file cannot hold truthfully."""
    where = f"{path}: cannot be written"
    if not name or "\0" in name:
        raise PictureError(f"{where}: {name!r} is not a channel name")
    array = np.asarray(values)
    is_real = any(jnp.issubdtype(array.dtype, kind) for kind in (np.floating, np.integer, np.bool_))
    if not is_real or array.ndim != 2 or array.size == 0:
        came = f"{array.dtype} of shape {array.shape}"
        raise PictureError(f"{where}: channel {name} is {came}, and real numbers of shape (height, width) are wanted")
    dtype = np.float16 if half else np.float32
    # A non-contiguous array would be written as wrong pixels, silently.
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(array.astype(dtype))
    _refuse_not_finite(where, name, array)
    if not np.isfinite(stored).all():
        largest = np.abs(array.astype(np.float64)).max()
        raise PictureError(
            f"{where}: channel {name} reaches {largest:g}, and {stored.dtype} ends at {np.finfo(dtype).max}"
        )
    return stored


def _refuse_not_finite(where: str, name: str, array: np.ndarray) -> None:
    bad = ~np.isfinite(array)
    if bad.any():
        y, x = np.argwhere(bad)[0]
        raise PictureError(
            f"{where}: channel {name} has {bad.sum()} pixels that are NaN or infinite, the first in row {y}, column {x}"
        )


def _read_metadata(path: str | os.PathLike[str], header: Mapping[str, object]) -> dict[str, object]:
    stored = header.get(KEY, "{}")
    try:
        metadata = json.loads(stored) if isinstance(stored, str) else None
    except json.JSONDecodeError:
        metadata = None
    if not isinstance(metadata, dict):
        warnings.warn(f"{path}: the attribute {KEY} is not a JSON object and is left out", PictureWarning, stacklevel=3)
        return {}
    return metadata
