"""Radiance HDR and PPM are read here, for no library at hand reads all of their files right (`test_own_readers.py`).

OpenImageIO refuses runs of pixels in an HDR, and puts pixels of most orientations where they do not belong; of a PPM it
passes over numbers beyond the largest and signs, and scales numbers of any largest to 8 or 16 bits, as Pillow does.
"""

import os
import re
import sys
from functools import cached_property

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.picture_file import PictureFile
from raytrace_jax.images.transfer import ENCODERS, REC_709, ColourSpace, linear_space
from raytrace_jax.util.files import atomic_write, read_bytes
from raytrace_jax.util.session import free_memory

HDR_MAGIC = b"#?"
"""What every Radiance HDR starts with; the name of a program follows, mostly RADIANCE or RGBE."""

FORMAT = b"32-bit_rle_rgbe"
"""The only format that is read. The other one, of XYZ, would need a choice of primaries."""

RUN_WIDTHS = range(8, 0x8000)
"""Scan lines of these lengths may be coded channel by channel."""

HDR_HEADER = re.compile(rb"(#\?.*?)\n\r?\n([^\n]*)\n", re.DOTALL)
"""Lines up to an empty one, and the line of the size."""

RESOLUTION = re.compile(rb"([+-])([XY]) +(\d+) +([+-])([XY]) +(\d+) *")

FACTORS = {
    b"EXPOSURE": (1, "a positive number is"),
    b"COLORCORR": (3, "three positive numbers are"),
    b"PIXASPECT": (1, "a positive number is"),
    b"GAMMA": (1, "a positive number is"),
}
"""What a header states as factors, and how many numbers each has; several of a name are multiplied."""

SCALES = np.where(np.arange(256) == 0, 0.0, np.ldexp(1.0, np.arange(256) - 136))
"""What a mantissa is multiplied by, for each exponent."""

TRUNCATED, BROKEN = "is a truncated Radiance HDR file", "is a broken Radiance HDR file"

PPM_HEADER = re.compile(rb"P[36]" + 3 * rb"(?:\s|#[^\n\r]*[\n\r])+(\d{1,9})" + rb"(?:#[^\n\r]*[\n\r])?\s")
"""Width, height and the largest number, with spaces or comments before each; one space, or a line's end, after it."""

COMMENT = re.compile(rb"#[^\n\r]*")


class PpmFile(PictureFile):
    """A PPM, plain (P3) or raw (P6), as courses write them (netpbm's manual, `ppm`); it says nothing of its numbers."""

    format, usual = "PPM", "course"

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(path)
        self.data = read_bytes(path, error=PictureError)
        self.head = PPM_HEADER.match(self.data)
        self.maximum = int(self.head[3]) if self.head else 255

    def bits(self) -> int:
        """Of its integers."""
        return 16 if (self.maximum or 0) > 255 else 8

    def numbers(self) -> np.ndarray:
        """Integers up to its `maximum`."""
        if self.head is None:
            raise self.error("is a broken PPM picture: its head has no width, height and largest number.")
        width, height, maximum = map(int, self.head.groups())
        if not (width and height and 0 < maximum < 2**16):
            raise self.error(
                f"is a broken PPM picture of {width} x {height} pixels with numbers up to {maximum}; they may go to "
                f"{2**16 - 1}."
            )
        body, size = self.data[self.head.end() :], self.bits() // 8
        if self.data.startswith(b"P6"):
            numbers = np.frombuffer(body[: len(body) // size * size], f">u{size}").astype(np.int64)
        else:
            words = COMMENT.sub(b"", body).split()
            bad = next((word for word in words if not (word.isdigit() and len(word) < 10)), None)
            if bad is not None:
                raise self.error(f"has {bad[:20].decode(errors='replace')!r} where a whole number is wanted.")
            numbers = np.array(words, np.int64)
        wanted = 3 * width * height
        if len(numbers) != wanted:
            what = "is truncated" if len(numbers) < wanted else "has more behind its picture"
            raise self.error(f"{what}: {len(numbers)} numbers, and 3 x {width} x {height} are wanted.")
        if numbers.max() > maximum:
            raise self.error(f"has the number {numbers.max()}, and says that {maximum} is the largest.")
        return numbers.reshape(height, width, 3)


def write_ppm(path: str | os.PathLike[str], rgb: np.ndarray, *, transfer: Transfer = "course") -> None:
    """Write a raw PPM of 8 bits, which does not say its transfer; the file appears only when it is whole.

    The colours are "3 height width", scene-linear and finite, top row first; they are clamped to [0, 1]. Raises
    PictureError if the file cannot be written.
    """
    numbers = np.moveaxis(ENCODERS[transfer](rgb), 0, -1)
    height, width, _ = numbers.shape
    with atomic_write(path, error=PictureError) as temporary:
        temporary.write_bytes(b"P6\n%d %d\n255\n" % (width, height) + np.ascontiguousarray(numbers).tobytes())


class HdrFile(PictureFile):
    """A Radiance HDR (.hdr, .pic): three mantissas and a common exponent a pixel, plain or in runs, in any orientation.

    The format is Greg Ward's (https://radsite.lbl.gov/radiance/refer/Notes/picture_format.html). A mantissa m with the
    exponent e is m 2^(e - 136), as Mitsuba, OpenCV and stb_image have it; Radiance, and Blender where it reads by code
    of its own, add half a step to m. What the header says the numbers were multiplied by, EXPOSURE and COLORCORR, is
    divided out. Without PRIMARIES colours are taken as those of the scene.
    """

    format = "Radiance HDR"

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(path)
        self.data = read_bytes(path, error=PictureError)

    @cached_property
    def head(self) -> re.Match[bytes]:
        """What comes before the pixels."""
        if not self.data.startswith(HDR_MAGIC):
            raise self.error("is not a Radiance HDR file (it does not start with #?)")
        head = HDR_HEADER.match(self.data)
        if head is None:
            raise self.error("is a truncated or broken Radiance HDR file: its header does not end")
        return head

    @cached_property
    def stated(self) -> dict[bytes, np.ndarray]:
        """What the header states in numbers, by its names."""
        try:
            return _stated(self.head[1])
        except ValueError as cause:
            raise self.error(str(cause)) from cause

    def numbers(self) -> np.ndarray:
        """Floats; refused are also XYZ colours, and a picture larger than the memory."""
        try:
            return _hdr_numbers(self.data, self.head, self.stated[b"EXPOSURE"] * self.stated[b"COLORCORR"])
        except ValueError as cause:
            raise self.error(str(cause)) from cause

    def meaning(self) -> ColourSpace | None:
        """The space of its primaries, where these are not Rec. 709's."""
        try:
            return linear_space("by PRIMARIES", tuple(self.stated[b"PRIMARIES"].tolist()))
        except ValueError as cause:
            raise self.error(str(cause)) from cause

    def pixel_aspect(self) -> float:
        """As of any file; PIXASPECT is the height of a pixel over its width."""
        return 1 / self.stated[b"PIXASPECT"].item()


def _hdr_numbers(data: bytes, head: re.Match[bytes], multipliers: np.ndarray) -> np.ndarray:
    """The colours "height width 3" of a Radiance HDR. The ValueErrors from here on complete "FILE: "."""
    size = RESOLUTION.fullmatch(head[2].rstrip(b"\r"))
    if size is None or size[2] == size[5]:
        raise ValueError(f"{BROKEN}: a size such as '-Y 480 +X 640' is wanted, not {_shown(head[2])}")
    lines, length = int(size[3][:20]), int(size[6][:20])
    if lines == 0 or length == 0:
        raise ValueError(f"{BROKEN}: it has no pixels ({_shown(head[2])})")
    stored = _scan_lines(data, head.end(), lines, length)
    colours = np.empty((lines, length, 3), np.float32)
    with np.errstate(over="ignore"):
        for channel, multiplier in enumerate(multipliers):
            scales = (SCALES / multiplier).astype(np.float32)
            np.multiply(stored[..., channel], scales[stored[..., 3]], out=colours[..., channel])
    if not np.isfinite(colours).all():
        raise ValueError(f"its colours, divided by {multipliers.tolist()}, do not fit into 32-bit floats")
    # The y axis points up, so that +Y is from the bottom; the x axis points right.
    down, right = (-1 if size[k] + size[k + 1] in (b"+Y", b"-X") else 1 for k in (1, 4))
    colours = colours[::down, ::right]
    return colours.swapaxes(0, 1) if size[2] == b"X" else colours


def _stated(head: bytes) -> dict[bytes, np.ndarray]:
    """What a header states: its factors, and the primaries. It is refused if it is not of linear light."""
    stated = {name: np.ones(count) for name, (count, _) in FACTORS.items()} | {b"PRIMARIES": np.array(REC_709)}
    for name, _, value in (line.partition(b"=") for line in head.split(b"\n")):
        if name == b"FORMAT" and value.strip() != FORMAT:
            raise ValueError(f"its format is {_shown(value)}, and {_shown(FORMAT)} is wanted")
        if name not in stated:
            continue
        try:
            numbers = np.array(value.split(), float)
        except ValueError:
            numbers = np.zeros(0)
        is_factor = name in FACTORS
        count, wanted = FACTORS.get(name, (8, "eight numbers are"))
        if len(numbers) != count or not (np.isfinite(numbers).all() and (not is_factor or (numbers > 0).all())):
            raise ValueError(f"{BROKEN}: {name.decode()} is {_shown(value)}, and {wanted} wanted")
        if is_factor:
            stated[name] = stated[name] * numbers
        elif numbers.any():  # Photoshop writes eight zeros, which say nothing.
            stated[name] = numbers
    if stated[b"GAMMA"] != 1:
        raise ValueError(f"says that its GAMMA is {stated[b'GAMMA'].item():g}, and linear light is wanted")
    return stated


def _scan_lines(data: bytes, position: int, lines: int, length: int) -> np.ndarray:
    """The stored bytes, "lines length 4"."""
    # A scan line of any kind has at least one pixel or the four bytes that begin the new runs.
    if 4 * lines > len(data) - position:
        raise ValueError(f"{TRUNCATED}: {lines} scan lines are wanted")
    # Reading takes 32 bytes a pixel at its peak: four stored bytes, three floats, and what is between them.
    needed, free = 32 * lines * length, free_memory()
    if needed > (sys.maxsize if free is None else free):
        what = f"{lines} scan lines of {length} pixels need about {needed / 1e9:.3g} GB of memory"
        raise ValueError(what + ("" if free is None else f", and {free / 1e9:.3g} GB are free"))
    stored = np.empty((lines, length, 4), np.uint8)
    for number, line in enumerate(stored, start=1):
        start = data[position : position + 4]
        is_by_channel = length in RUN_WIDTHS and start[:2] == b"\2\2" and len(start) == 4 and start[2] < 128
        try:
            position = (_read_channel_runs if is_by_channel else _read_pixel_runs)(data, position, line)
        except ValueError as cause:
            raise ValueError(f"{cause} (scan line {number} of {lines})") from cause
    return stored


def _read_channel_runs(data: bytes, position: int, line: np.ndarray) -> int:
    """Read a scan line in the new runs: channel after channel, runs of one byte and stretches of bytes as they are."""
    length = len(line)
    stated = 256 * data[position + 2] + data[position + 3]
    if stated != length:
        raise ValueError(f"{BROKEN}: {length} pixels are wanted, not {stated}")
    position += 4
    decoded = bytearray()
    for channel in range(1, 5):
        while len(decoded) < channel * length:
            # Slices, which are short at the end of the file and do not raise.
            code = data[position : position + 1]
            if code == b"\0":
                raise ValueError(f"{BROKEN}: it has a run of no pixels")
            count = code[0] if code else 0
            if count > 128:
                decoded += data[position + 1 : position + 2] * (count - 128)
                position += 2
            else:
                decoded += data[position + 1 : position + 1 + count]
                position += 1 + count
            if position > len(data):
                raise ValueError(TRUNCATED)
        if len(decoded) != channel * length:
            raise ValueError(f"{BROKEN}: a run goes beyond its scan line")
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
    if count == 0:
        raise ValueError(TRUNCATED)
    if repeats[0]:
        raise ValueError(f"{BROKEN}: it repeats a pixel before there is one")
    index = np.arange(count)
    pixel = np.maximum.accumulate(np.where(repeats, -1, index))
    digit = np.minimum(index - pixel - 1, 4)
    times = np.where(repeats, stored[:, 3].astype(np.int64) << (8 * np.maximum(digit, 0)), 1)
    # Without the limit a broken file could overflow the sum.
    ends = np.cumsum(np.minimum(times, length + 1))
    used = int(np.searchsorted(ends, length)) + 1
    if used > count:
        raise ValueError(TRUNCATED)
    if ends[used - 1] != length:
        raise ValueError(f"{BROKEN}: a run goes beyond its scan line")
    line[...] = np.repeat(stored[pixel[:used]], times[:used], axis=0)
    return position + 4 * used


def _shown(text: bytes) -> str:
    return repr(text[:60].decode("latin-1").strip())
