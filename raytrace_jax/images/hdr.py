"""Radiance HDR pictures (.hdr, .pic): three mantissas and a common exponent a pixel, plain or in runs, read only.

The format is Greg Ward's (https://radsite.lbl.gov/radiance/refer/Notes/picture_format.html). Errors within are
ValueErrors that complete "FILE: ...".
"""

import os
import re
import sys
from dataclasses import dataclass

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.util.files import read_bytes
from raytrace_jax.util.session import free_memory

MAGIC = b"#?"
"""What every file starts with; the name of a program follows, mostly RADIANCE or RGBE."""

FORMAT = b"32-bit_rle_rgbe"
"""The only format that is read. The other one, of XYZ, would need a choice of primaries."""

RUN_WIDTHS = range(8, 0x8000)
"""Scan lines of these lengths may be coded channel by channel."""

_RESOLUTION = re.compile(rb"([+-])([XY]) +(\d+) +([+-])([XY]) +(\d+) *")
_SCALES = np.where(np.arange(256) == 0, 0.0, np.ldexp(1.0, np.arange(256) - 136))


@dataclass(frozen=True)
class _Header:
    """How the scan lines lie in the picture, and where they begin in the file."""

    lines: int
    length: int
    columns: bool  # Scan lines are columns.
    backward: tuple[bool, bool]  # From the bottom up or from the right; of the lines, and along them.
    multipliers: np.ndarray  # Of red, green and blue: what the stored numbers were multiplied by.
    end: int


def read_hdr(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a Radiance HDR picture as scene-linear float32 "3 height width", top row first.

    A mantissa m with the exponent e is m 2^(e - 136), as Mitsuba, OpenCV and stb_image have it; Radiance, and Blender
    where it reads by code of its own, add half a step to m. What the header says the numbers were multiplied by,
    EXPOSURE and COLORCORR, is divided out. Primaries are taken as those of the scene.

    Args:
        path: the file; scan lines plain, in the old runs of pixels or in the new ones of channels, in any orientation.

    Raises:
        PictureError: the file is missing, truncated or broken, is of XYZ colours, or larger than the memory.
    """
    data = read_bytes(path, error=PictureError)
    try:
        header = _read_header(data)
        return _colours(_read_pixels(data, header), header)
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause


def _read_header(data: bytes) -> _Header:
    if not data.startswith(MAGIC):
        raise ValueError("is not a Radiance HDR file (it does not start with #?)")
    multipliers = np.ones(3)
    position = 0
    while True:
        line, position = _next_line(data, position)
        if not line:
            break
        name, _, value = line.partition(b"=")
        if name == b"FORMAT" and value.strip() != FORMAT:
            raise ValueError(f"its format is {_shown(value)}, and {_shown(FORMAT)} is wanted")
        if name in (b"EXPOSURE", b"COLORCORR"):
            multipliers = multipliers * _multipliers(name, value)
    line, end = _next_line(data, position)
    found = _RESOLUTION.fullmatch(line)
    if found is None or found[2] == found[5]:
        raise ValueError(f"is a broken Radiance HDR file: a size such as '-Y 480 +X 640' is wanted, not {_shown(line)}")
    lines, length = int(found[3][:20]), int(found[6][:20])
    if lines == 0 or length == 0:
        raise ValueError(f"is a broken Radiance HDR file: it has no pixels ({_shown(line)})")
    # The y axis points up, so that +Y is from the bottom; the x axis points right.
    backward = tuple(sign + axis in (b"+Y", b"-X") for sign, axis in (found.group(1, 2), found.group(4, 5)))
    return _Header(lines, length, found[2] == b"X", (backward[0], backward[1]), multipliers, end)


def _next_line(data: bytes, start: int) -> tuple[bytes, int]:
    end = data.find(b"\n", start)
    if end < 0:
        raise ValueError("is a truncated or broken Radiance HDR file: its header does not end")
    return data[start:end].rstrip(b"\r"), end + 1


def _multipliers(name: bytes, value: bytes) -> np.ndarray:
    try:
        numbers = np.array([float(word) for word in value.split()])
    except ValueError:
        numbers = np.zeros(0)
    wanted = 3 if name == b"COLORCORR" else 1
    if len(numbers) != wanted or not (np.isfinite(numbers) & (numbers > 0)).all():
        how_many = "three positive numbers are" if wanted == 3 else "a positive number is"
        raise ValueError(f"is a broken Radiance HDR file: {name.decode()} is {_shown(value)}, and {how_many} wanted")
    return numbers


def _read_pixels(data: bytes, header: _Header) -> np.ndarray:
    """Return the stored bytes, "lines length 4"."""
    # A scan line of any kind has at least one pixel or the four bytes that begin the new runs.
    if 4 * header.lines > len(data) - header.end:
        raise ValueError(f"is a truncated Radiance HDR file: {header.lines} scan lines are wanted")
    # Reading takes 32 bytes a pixel at its peak: four stored bytes, three floats, and what is between them.
    needed, free = 32 * header.lines * header.length, free_memory()
    if needed > (sys.maxsize if free is None else free):
        what = f"{header.lines} scan lines of {header.length} pixels need about {needed / 1e9:.3g} GB of memory"
        raise ValueError(what + ("" if free is None else f", and {free / 1e9:.3g} GB are free"))
    pixels = np.empty((header.lines, header.length, 4), np.uint8)
    position = header.end
    for number, line in enumerate(pixels):
        try:
            start = data[position : position + 4]
            if header.length in RUN_WIDTHS and start[:2] == b"\2\2" and len(start) == 4 and start[2] < 128:
                position = _read_channel_runs(data, position, line)
            else:
                position = _read_pixel_runs(data, position, line)
        except ValueError as cause:
            raise ValueError(f"{cause} (scan line {number + 1} of {header.lines})") from cause
    return pixels


def _read_channel_runs(data: bytes, position: int, line: np.ndarray) -> int:
    """Read a scan line in the new runs: channel after channel, runs of one byte and stretches of bytes as they are."""
    length = len(line)
    stated = 256 * data[position + 2] + data[position + 3]
    if stated != length:
        raise ValueError(f"is a broken Radiance HDR file: {length} pixels are wanted, not {stated}")
    position += 4
    decoded = bytearray()
    for channel in range(1, 5):
        while len(decoded) < channel * length:
            # Slices, which are short at the end of the file and do not raise.
            code = data[position : position + 1]
            count = code[0] if code else 0
            if count > 128:
                decoded += data[position + 1 : position + 2] * (count - 128)
                position += 2
            elif count:
                decoded += data[position + 1 : position + 1 + count]
                position += 1 + count
            elif code:
                raise ValueError("is a broken Radiance HDR file: it has a run of no pixels")
            if position > len(data) or not code:
                raise ValueError("is a truncated Radiance HDR file")
        if len(decoded) != channel * length:
            raise ValueError("is a broken Radiance HDR file: a run goes beyond its scan line")
    line[...] = np.frombuffer(decoded, np.uint8).reshape(4, length).T
    return position


def _read_pixel_runs(data: bytes, position: int, line: np.ndarray) -> int:
    """Read a scan line of plain pixels, or in the old runs: 1 1 1 n repeats the pixel before it n times.

    What is directly after such a pixel and of the same kind counts 256 times as much. No pixel is stored as 1 1 1,
    since the largest mantissa is at least 128.
    """
    length = len(line)
    count = min(length, (len(data) - position) // 4)
    stored = np.frombuffer(data, np.uint8, 4 * count, position).reshape(count, 4)
    repeats = (stored[:, :3] == 1).all(axis=1)
    if count == length and not repeats.any():
        line[...] = stored
        return position + 4 * length
    if count == 0 or repeats[0]:
        raise ValueError(
            "is a truncated Radiance HDR file"
            if count == 0
            else "is a broken Radiance HDR file: it repeats a pixel before there is one"
        )
    index = np.arange(count)
    pixel = np.maximum.accumulate(np.where(repeats, -1, index))
    digit = np.minimum(index - pixel - 1, 4)
    times = np.where(repeats, stored[:, 3].astype(np.int64) << (8 * np.maximum(digit, 0)), 1)
    # Without the limit a broken file could overflow the sum.
    ends = np.cumsum(np.minimum(times, length + 1))
    used = int(np.searchsorted(ends, length)) + 1
    if used > count:
        raise ValueError("is a truncated Radiance HDR file")
    if ends[used - 1] != length:
        raise ValueError("is a broken Radiance HDR file: a run goes beyond its scan line")
    line[...] = np.repeat(stored[pixel[:used]], times[:used], axis=0)
    return position + 4 * used


def _colours(pixels: np.ndarray, header: _Header) -> np.ndarray:
    """Return float32 "3 height width" of the stored bytes."""
    colours = np.empty((3, *pixels.shape[:2]), np.float32)
    with np.errstate(over="ignore"):
        for channel, multiplier in enumerate(header.multipliers):
            scales = (_SCALES / multiplier).astype(np.float32)
            np.multiply(pixels[..., channel], scales[pixels[..., 3]], out=colours[channel])
    if not np.isfinite(colours).all():
        raise ValueError(f"its colours, divided by {header.multipliers.tolist()}, do not fit into 32-bit floats")
    line_axis, along_axis = header.backward
    colours = colours[:, :: -1 if line_axis else 1, :: -1 if along_axis else 1]
    return np.ascontiguousarray(colours.swapaxes(1, 2) if header.columns else colours)


def _shown(text: bytes) -> str:
    return repr(text[:60].decode("latin-1").strip())
