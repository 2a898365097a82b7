"""OpenEXR files: scene-linear float channels by name, the picture that they make, and our metadata, exact, as one text.

Arrays are "height width" with the top row first, as the file has them. Channel names are layers:
`ViewLayer.Combined.R` is the component `R` of the layer `ViewLayer.Combined`.
"""

import contextlib
import io
import json
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from jax.typing import ArrayLike

from ..errors import PictureError, RaytraceWarning
from ..util.files import StrPath, atomic_write, read_bytes
from ..util.numerics import on_host, real_numbers
from ..util.text import did_you_mean
from . import Transfer
from .picture_file import KEY, MEMORY, PictureFile, PictureOrigin, refuse_beyond_memory, to_json
from .transfer import LINEAR_SPACES, NEARLY, REC_709, Chromaticities, ColourSpace, linear_space

MAGIC = b"\x76\x2f\x31\x01"
"""The first four bytes of every OpenEXR file."""

RGB = ("R", "G", "B")

Header = Mapping[str, Any]
"""What a part of a file says of itself, by the names of attributes."""

# Compressions by the floats that they change: PXR24 drops bits of 32-bit floats only, B44 those of halfs.
_LOSSY = {**dict.fromkeys(("DWAA", "DWAB", "LJ2K"), ("f2", "f4")), "B44": ("f2",), "B44A": ("f2",), "PXR24": ("f4",)}


@dataclass(frozen=True, eq=False)
class ExrPicture:
    """What an OpenEXR file holds."""

    channels: dict[str, np.ndarray]  # "height width" by their full names, float32 (a half is exact in it) or uint32.
    metadata: dict[str, object]  # What `write_exr` was given; empty for the files of other programs.
    compression: str  # Of the first part, such as `ZIP`.
    attributes: dict[str, dict[str, Any]]
    """The header of each channel's part, by the channel's name; the first part's header fills what that leaves out."""


def write_exr(
    path: StrPath,
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
        reached = np.abs(on_host(array)).max()
        raise PictureError(f"{where}: channel {name} reaches {reached:g}, and half ends at 65504, float at 3.4e38")
    return stored


def refuse_not_finite(where: str, name: str, array: np.ndarray) -> None:
    """Raise PictureError if a channel has NaN or infinite pixels; `where` begins the sentence."""
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        first = f"the first in row {bad[0, 0]}, column {bad[0, 1]}"
        raise PictureError(f"{where}: channel {name} has {len(bad)} pixels that are NaN, infinite or masked, {first}")


def read_exr(path: StrPath, *, layer: str | None = None) -> ExrPicture:
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
    compressions = [part.compression().name.removesuffix("_COMPRESSION") for part in parts]
    lossy: set[str] = set()
    for part, compression in zip(parts, compressions, strict=True):
        prefix = f"{part.name()}." if any(counts[name] > 1 for name in part.channels) else ""
        for name, channel in part.channels.items():
            channels[prefix + name] = in_display_window(path, channel.pixels, part.header)
            attributes[prefix + name] = parts[0].header | part.header
            if channel.pixels.dtype.str[1:] in _LOSSY.get(compression, ()):
                lossy.add(compression)
    if lossy:
        words = f"{path}: was stored with the lossy compression {' and '.join(lossy)}; its pixels are not exact"
        warnings.warn(words, RaytraceWarning, stacklevel=2)
    if layer is not None:
        prefix = find_layer(channels, layer, str(path))
        channels = {name: array for name, array in channels.items() if name.rpartition(".")[0] == prefix}
    attributes = {name: attributes[name] for name in channels}
    return ExrPicture(channels, read_metadata(path, parts[0].header), compressions[0], attributes)


def opened(path: StrPath, **how: bool) -> OpenEXR.File:
    """What OpenEXR reads of a file: as a stream, since a name need not be UTF-8, and OpenEXR's have to."""
    with Path(path).open("rb") as file:
        return OpenEXR.File(file, **how)


def _load_parts(path: StrPath) -> list[OpenEXR.Part]:
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


def _window(header: Header, name: str) -> tuple[np.ndarray, np.ndarray]:
    """The (row, column) of a window's first pixel, and of the one behind its last."""
    # The header has (x, y), and the last itself.
    first, last = (np.array(corner, np.int64)[::-1] for corner in header[name])
    return first, last + 1


def in_display_window(path: StrPath, pixels: np.ndarray, header: Header) -> np.ndarray:
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


def stored_pixels(path: StrPath, header: Header) -> np.ndarray:
    """Which pixels of the display window the data window has, "height width"."""
    first, end = _window(header, "dataWindow")
    return in_display_window(path, np.ones(end - first, bool), header)


def read_metadata(path: StrPath, header: Header) -> dict[str, object]:
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


class ExrFile(PictureFile):
    """The picture in an OpenEXR file. An alpha is left out: colours are premultiplied, that is, already over black."""

    format = "OpenEXR"

    def __init__(self, path: StrPath, layer: str | None = None) -> None:
        super().__init__(path)
        self.layer = layer

    @cached_property
    def picture(self) -> ExrPicture:
        return read_exr(self.path)

    @cached_property
    def names(self) -> tuple[str, str, str]:
        """The three channel names that make the picture, R, G and B; a grey `Y` comes three times.

        Without a layer, the picture is the channels without a layer if they have a colour, else the only layer
        with a colour, else the only one called `Combined`, as Blender has it.
        """
        components = by_layer(self.picture.channels)
        # A Y beside an X is a vector's second component (`normal.X normal.Y normal.Z`), not a grey picture, and beside
        # RY and BY it is a luminance with chroma.
        is_grey = {name: "Y" in has and has.isdisjoint(("X", "RY", "BY")) for name, has in components.items()}
        coloured = [name for name, has in components.items() if has.issuperset(RGB) or is_grey[name]]
        if self.layer is not None:
            layer = find_layer(self.picture.channels, self.layer, str(self.path))
            chosen = [name for name in coloured if name == layer]
        else:
            combined = [name for name in coloured if name.rpartition(".")[2] == "Combined"]
            chosen = [""] if "" in coloured else coloured if len(coloured) == 1 else combined
        if len(chosen) != 1:
            layers = "; ".join(f"{name!r} ({', '.join(sorted(has))})" for name, has in components.items())
            wanted = "one layer with the channels R, G, B or a grey Y is wanted"
            raise self.error(f"{wanted}: name it; its layers are {layers}")
        prefix = f"{chosen[0]}." if chosen[0] else ""
        red, green, blue = RGB if components[chosen[0]].issuperset(RGB) else ("Y", "Y", "Y")
        return prefix + red, prefix + green, prefix + blue

    @cached_property
    def primaries(self) -> tuple[str, Chromaticities]:
        """What states the primaries, and these; a name of `LINEAR_SPACES` where it is an id of the Color Interop Forum.

        An id goes before chromaticities, which programs pass on when they are no longer right, and what is said to be a
        file of ACES before both (the Forum's "Identifying the Color Space of OpenEXR Files").
        """
        said = self.picture.attributes[self.names[0]]
        chromaticities = tuple(map(float, said.get("chromaticities", REC_709)))
        is_of_aces = said.get("acesImageContainerFlag") == 1
        space = "lin_ap0_scene" if is_of_aces else str(said.get("colorInteropID", "unknown"))
        if space == "data":
            return space, REC_709
        if space == "unknown":
            return "by chromaticities", chromaticities
        if space not in LINEAR_SPACES:
            raise self.error(
                f"says that its colours are {space!r} (colorInteropID), and linear light of a known space is wanted: "
                f"{', '.join(LINEAR_SPACES)}; oiiotool --colorconvert converts it"
            )
        primaries = LINEAR_SPACES[space]
        if "chromaticities" in said and not np.allclose(primaries, chromaticities, atol=NEARLY):
            self.tell(f"says that its colours are {space}, and has the chromaticities of others: it is read as said.")
        return space, primaries

    def numbers(self) -> np.ndarray:
        """The channels of the layer, a grey one three times."""
        height, width = self.picture.channels[self.names[0]].shape
        refuse_beyond_memory(self.path, "display window", width, height, bytes_per_pixel=MEMORY)
        for name in self.names:
            refuse_not_finite(f"{self.path}: cannot be used as a picture", name, self.picture.channels[name])
        stored = np.stack([self.picture.channels[name] for name in self.names], axis=-1)
        return stored.astype(np.float32, copy=False)

    def stated(self) -> ColourSpace | None:
        """The space of its primaries, where these are not Rec. 709's and it has colours."""
        name, primaries = self.primaries
        # A grey picture has one channel three times.
        return None if len(set(self.names)) == 1 else linear_space(name, primaries, adapts=name in LINEAR_SPACES)

    def pixel_aspect(self) -> float:
        return float(self.picture.attributes[self.names[0]].get("pixelAspectRatio", 1.0))

    def light(self, transfer: Transfer | None = None) -> np.ndarray:
        light = super().light()  # No transfer changes floats.
        headers = (self.picture.attributes[name] for name in self.names)
        absent = ~np.all([stored_pixels(self.path, header) for header in headers], axis=0)
        return np.ma.array(light, mask=np.broadcast_to(absent, light.shape)) if absent.any() else light

    def origin(self) -> PictureOrigin:
        """The metadata of `write_exr`, and the attribute `generatedBy`."""
        try:
            header = opened(self.path, header_only=True).parts[0].header
        except (RuntimeError, ValueError, IndexError) as cause:
            raise self.error(f"is a truncated or broken OpenEXR file: {cause}") from cause
        return PictureOrigin(read_metadata(self.path, header), str(header.get("generatedBy", "")))
