"""Files of pictures as other programs write them, and pictures to store, for tests."""

import io
import struct
import zlib

import numpy as np
import OpenImageIO as oiio
from PIL import Image

BT_2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
"""Chromaticities of red, green, blue and white."""

RED, GREEN, BLUE, DEPTH = np.random.default_rng(0).random((4, 9, 13), np.float32)
CLEAN = {"R": RED, "G": GREEN, "B": BLUE}

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_END = 33
"""Where the header chunk, the first one, ends in every PNG file."""


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_bytes(width, height, bits, colour_type, rows, *, interlace=0, extra=b"", raw=None):
    """A PNG file made by hand; `rows` are (filter, bytes)."""
    header = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, interlace)
    raw = b"".join(bytes([kind]) + content for kind, content in rows) if raw is None else raw
    data = chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    return SIGNATURE + data


def jpeg(pixels, **options):
    stored = io.BytesIO()
    Image.fromarray(pixels).save(stored, "JPEG", **{"quality": 98, "subsampling": 0, **options})
    return stored.getvalue()


def write_tiff(path, pixels, *, names=None):
    height, width, channels = pixels.shape
    kind = {"float32": "float", "float16": "half"}.get(str(pixels.dtype), str(pixels.dtype))
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names:
        spec.channelnames = names
        spec.alpha_channel = names.index("A") if "A" in names else -1
        spec.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()


def photo(path, size=(48, 32), **exif):
    spec = oiio.ImageSpec(*size, 3, oiio.UINT8)
    for name, value in exif.items():
        spec.attribute("Orientation" if name == "Orientation" else f"Exif:{name}", value)
    file = oiio.ImageOutput.create(str(path))
    pixels = np.random.default_rng(0).integers(50, 200, (size[1], size[0], 3)).astype(np.uint8)
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()
    return path
