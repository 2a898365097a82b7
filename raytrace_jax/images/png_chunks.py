"""The chunks of a PNG file, and its integrity, of which libraries let much pass (they fill missing rows).

The format is ISO/IEC 15948 (https://www.w3.org/TR/png-3). Errors are ValueErrors that complete "FILE: ...".
"""

import math
import struct
import sys
import zlib
from dataclasses import dataclass

HEADER_END = 33
"""Where the header chunk, the first one, ends in every PNG file."""

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""The first eight bytes of every PNG file."""

TEXTS = (b"tEXt", b"iTXt")

# Samples a pixel and the bits a sample may have, by the colour type: grey, RGB, palette, grey + alpha, RGB + alpha.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_BITS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
# The passes of a picture: first column, first row, step between columns, step between rows.
_ONE_PASS = ((0, 0, 1, 1),)
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


@dataclass(frozen=True)
class Png:
    """A PNG file whose structure and checksums are right and whose pixels are all there.

    Args:
        bits: bits a sample.
        has_transparent_colour: whether a `tRNS` chunk makes one colour, or palette entries, transparent.
        chunks: the contents of all chunks but the pixels, by their kind; those of one kind are joined, and a zero ends
            each text.
    """

    bits: int
    has_transparent_colour: bool
    chunks: dict[bytes, bytes]


def parse_png(data: bytes) -> Png:
    """Check a PNG file from its signature to its end.

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
    return Png(bits, b"tRNS" in chunks, others)


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
        chunks.setdefault(kind, bytearray()).extend(content + b"\0" * (kind in TEXTS))
        position = end + 4
    return chunks


def pixels_alone(data: bytes) -> bytes:
    """A PNG file, whose pixels have no palette, with nothing but its header and its pixels."""
    chunks = _read_chunks(data)
    parts = (b"IHDR", b"IDAT", b"IEND")
    return SIGNATURE + b"".join(png_chunk(kind, bytes(chunks[kind])) for kind in parts)


def png_chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file as it stands there."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
