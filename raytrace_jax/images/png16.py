"""PNG with 16 bits a sample, which Pillow cuts to 8 bits on reading and cannot write; and the file's integrity.

The format is ISO/IEC 15948 (https://www.w3.org/TR/png-3). Errors are ValueErrors that complete "FILE: ...".
"""

import math
import struct
import sys
import zlib
from dataclasses import dataclass

import numpy as np

HEADER_END = 33
"""Where the header chunk, the first one, ends in every PNG file."""

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""The first eight bytes of every PNG file."""

# Samples a pixel and the bits a sample may have, by the colour type: grey, RGB, palette, grey + alpha, RGB + alpha.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_BITS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
# The passes of a picture: first column, first row, step between columns, step between rows.
_ONE_PASS = ((0, 0, 1, 1),)
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_COLOUR_TYPE_RGB = 2
_FILTER_UP = 2


@dataclass(frozen=True)
class Png:
    """A PNG file whose structure and checksums are right and whose pixels are all there.

    Args:
        width: in pixels.
        height: in pixels.
        bits: bits a sample.
        samples: samples a pixel: grey 1, grey and alpha 2, RGB 3, RGB and alpha 4, an index into a palette 1.
        interlaced: whether the pixels come in the seven passes of Adam7.
        has_transparent_colour: whether a `tRNS` chunk makes one colour, or palette entries, transparent.
        rows: the decompressed rows, each with its filter's number in front.
        chunks: the contents of all chunks but the pixels, by their kind; those of one kind are joined.
    """

    width: int
    height: int
    bits: int
    samples: int
    interlaced: bool
    has_transparent_colour: bool
    rows: bytes
    chunks: dict[bytes, bytes]


def parse_png(data: bytes) -> Png:
    """Check a PNG file from its signature to its end, of which Pillow lets much pass (it fills missing rows).

    Raises:
        ValueError: the file is not a PNG, is truncated, or a checksum is wrong.
    """
    chunks = _read_chunks(data)
    if len(chunks.get(b"IHDR", b"")) != 13:
        raise ValueError("is a broken PNG file: it has no header")
    width, height, bits, colour_type, _, _, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if width == 0 or height == 0 or bits not in _BITS.get(colour_type, ()):
        what = f"{width} x {height} pixels of colour type {colour_type} with {bits} bits a sample"
        raise ValueError(f"is a broken PNG file: {what}")
    samples = _SAMPLES[colour_type]
    size = sum(
        # The number of rows of the pass, each with its filter's number and its pixels in whole bytes.
        -((y - height) // y_step) * (1 + math.ceil(-((x - width) // x_step) * samples * bits / 8))
        for x, y, x_step, y_step in (_ADAM7 if interlace else _ONE_PASS)
        if x < width and y < height
    )
    try:
        # The limit keeps a small file from filling the memory; what follows the pixels does not matter.
        rows = zlib.decompressobj().decompress(chunks.get(b"IDAT", b""), min(size, sys.maxsize))
    except zlib.error as cause:
        raise ValueError("is a broken PNG file: its pixels cannot be decompressed") from cause
    if len(rows) != size:
        raise ValueError("is a truncated PNG file: some of its pixels are missing")
    others = {kind: bytes(content) for kind, content in chunks.items() if kind != b"IDAT"}
    return Png(width, height, bits, samples, interlace != 0, b"tRNS" in chunks, rows, others)


def _read_chunks(data: bytes) -> dict[bytes, bytearray]:
    """Return the contents of the chunks by their kind; those of one kind are joined."""
    if not data.startswith(SIGNATURE):
        raise ValueError("is not a PNG file (its first bytes differ)")
    chunks: dict[bytes, bytearray] = {}
    position = len(SIGNATURE)
    while b"IEND" not in chunks:
        if position + 12 > len(data):
            raise ValueError("is a truncated PNG file")
        length, kind = struct.unpack_from(">I4s", data, position)
        end = position + 8 + length
        if end + 4 > len(data):
            raise ValueError("is a truncated PNG file")
        content = data[position + 8 : end]
        if struct.unpack_from(">I", data, end)[0] != zlib.crc32(kind + content):
            raise ValueError(f"is a broken PNG file: the checksum of its {kind.decode('latin-1')!r} chunk is wrong")
        chunks.setdefault(kind, bytearray()).extend(content)
        position = end + 4
    return chunks


def decode_samples(png: Png) -> np.ndarray:
    """Return the samples of a PNG with 8 or 16 bits a sample, uint8 or uint16 "height width samples".

    Raises:
        ValueError: the pixels are interlaced, or a row filter does not exist.
    """
    if png.interlaced:
        raise ValueError("is an interlaced 16-bit PNG file; save it without interlacing")
    pixel_bytes = png.samples * png.bits // 8
    rows = np.frombuffer(png.rows, np.uint8).reshape(png.height, -1)
    filters = rows[:, 0]
    if filters.max() > 4:
        raise ValueError(f"is a broken PNG file: {filters.max()} is not a row filter")
    pixels = _undo_filters(filters, rows[:, 1:].reshape(png.height, png.width, pixel_bytes))
    return np.ascontiguousarray(pixels).view(f">u{png.bits // 8}").astype(f"u{png.bits // 8}")


def encode_rgb16(samples: np.ndarray) -> bytes:
    """Return a PNG file of uint16 "height width 3"."""
    height, width, _ = samples.shape
    rows = samples.astype(">u2").view(np.uint8).reshape(height, -1)
    # Every row is stored as its difference to the row above, which compresses well in rendered pictures.
    differences = np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1]))
    filtered = np.insert(differences, 0, _FILTER_UP, axis=1)
    header = struct.pack(">IIBBBBB", width, height, 16, _COLOUR_TYPE_RGB, 0, 0, 0)
    return (
        SIGNATURE
        + png_chunk(b"IHDR", header)
        + png_chunk(b"IDAT", zlib.compress(filtered.tobytes()))
        + png_chunk(b"IEND", b"")
    )


def png_chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file as it stands there."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _undo_filters(filters: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Return the bytes "height width bytes" from their differences to the prediction of each row's filter.

    A pixel is predicted from its left, upper and upper left neighbours, so that all pixels of a diagonal
    (x + y constant) can be done at once, whatever the filters of their rows are.
    """
    height, width, pixel_bytes = residuals.shape
    # The border of zeros stands for the neighbours outside; 16 bits keep sums of two bytes.
    known = np.zeros((height + 1, width + 1, pixel_bytes), np.int16)
    for diagonal in range(height + width - 1):
        y = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        x = diagonal - y
        left, up, upper_left = known[y + 1, x], known[y, x + 1], known[y, x]
        average = (left + up) // 2
        predictions = np.stack([np.zeros_like(left), left, up, average, _paeth(left, up, upper_left)])
        known[y + 1, x + 1] = (residuals[y, x] + predictions[filters[y], np.arange(y.size)]) % 256
    return known[1:, 1:].astype(np.uint8)


def _paeth(left: np.ndarray, up: np.ndarray, upper_left: np.ndarray) -> np.ndarray:
    """Return the neighbour nearest to left + up - upper_left; left wins a tie, then up."""
    to_left, to_up, to_upper_left = (
        np.abs(up - upper_left),
        np.abs(left - upper_left),
        np.abs(left + up - 2 * upper_left),
    )
    nearest_of_upper = np.where(to_up <= to_upper_left, up, upper_left)
    return np.where((to_left <= to_up) & (to_left <= to_upper_left), left, nearest_of_upper)
