"""What a PNG file says of how it was made, and of how its numbers were made from light, which is obeyed.

The chunks are those of ISO/IEC 15948 (https://www.w3.org/TR/png-3, 11.3.2); a text of our own, which others pass over,
tells the course's truncation from rounding. Pillow, like most programs, shows the numbers as they are.
"""

import struct
from collections.abc import Mapping
from typing import get_args

from raytrace_jax._version import __version__
from raytrace_jax.images.metadata import KEY
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png_chunks import png_chunk

KEYWORD = b"raytrace-jax transfer"

SRGB_GAMMA = 45455
"""Of `gAMA`, in 1/100000: what stands for sRGB where the chunk `sRGB` is not known."""

LINEAR_TRANSFER, SRGB_TRANSFERS = 8, (1, 13)
"""Codes of `cICP` (ITU-T H.273): linear; BT.709's curve as cameras write it for sRGB, and sRGB."""


def transfer_chunks(transfer: Transfer) -> bytes:
    """The chunks that say how the numbers of a PNG file were made; they belong behind its header."""
    said = KEYWORD + b"\0" + transfer.encode()
    software = b"Software\0" + f"raytrace-jax {__version__}".encode()
    gamma = struct.pack(">I", SRGB_GAMMA if transfer == "srgb" else 100_000)
    srgb = png_chunk(b"sRGB", b"\0") if transfer == "srgb" else b""
    return srgb + png_chunk(b"gAMA", gamma) + png_chunk(b"tEXt", said) + png_chunk(b"tEXt", software)


def metadata_chunk(text: str) -> bytes:
    """The chunk that holds a text of how the picture was made, uncompressed."""
    return png_chunk(b"iTXt", KEY.encode() + b"\0" + b"\0\0" + b"\0" + b"\0" + text.encode())


def stated_transfer(chunks: Mapping[bytes, bytes]) -> Transfer | float | None:
    """What the chunks of a PNG file say of its numbers: a transfer, the exponent of another one, or nothing.

    An exponent g is that of `gAMA`: a number is the light to the power of g. Where several chunks say something, ours
    goes first and then they have the order of the standard. A profile (`iCCP`) counts as sRGB: those of cameras and
    screens have its curve or one that is near.
    """
    for transfer in get_args(Transfer):
        if KEYWORD + b"\0" + transfer.encode() in chunks.get(b"tEXt", b""):
            return transfer
    code = int.from_bytes(chunks.get(b"cICP", b"")[1:2], "big")
    if code == LINEAR_TRANSFER:
        return 1.0
    if code in SRGB_TRANSFERS or b"iCCP" in chunks or b"sRGB" in chunks:
        return "srgb"
    gamma = int.from_bytes(chunks.get(b"gAMA", b""), "big")
    if gamma == SRGB_GAMMA:
        return "srgb"
    return gamma / 100_000 if gamma > 0 else None
