"""What a PNG file says of how it was made, and of how its numbers were made from light, which is obeyed.

The chunks are those of ISO/IEC 15948 (https://www.w3.org/TR/png-3, 11.3.2); a text of our own, which others pass over,
tells the course's truncation from rounding.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from typing import Any, get_args

from raytrace_jax._version import __version__
from raytrace_jax.images.colour_spaces import REC_709, Chromaticities, ColourSpace, power, srgb_to_linear, to_rec_709
from raytrace_jax.images.icc import read_profile
from raytrace_jax.images.metadata import KEY
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png_chunks import png_chunk

KEYWORD = b"raytrace-jax transfer"

SRGB_GAMMA = 45455
"""The number of `gAMA`, in 1/100000, that stands for sRGB to programs which do not know the chunk `sRGB`."""

CURVES = {1: srgb_to_linear, 4: power(1 / 2.2), 5: power(1 / 2.8), 8: power(1.0), 13: srgb_to_linear}
"""Curves by their code in `cICP` (ITU-T H.273). BT.709's code (1) is read as sRGB, for which cameras write it."""

PRIMARIES: dict[int, Chromaticities] = {
    1: REC_709,
    2: REC_709,
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
}
"""Primaries by their code in `cICP`; those that are not said (2) are taken for the usual ones."""


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


def stated_metadata(chunks: Mapping[bytes, bytes]) -> dict[str, Any]:
    """What `metadata_chunk` has said of how the picture was made; empty if nothing did."""
    _, start, text = chunks.get(b"iTXt", b"").partition(KEY.encode() + b"\0\0\0\0\0")
    try:
        found, _ = json.JSONDecoder().raw_decode(text.decode(errors="replace")) if start else ({}, 0)
    except json.JSONDecodeError:
        return {}
    return found if isinstance(found, dict) else {}


def stated_maker(chunks: Mapping[bytes, bytes]) -> str:
    """The program that is said to have rendered the picture, in the text `generatedBy`; empty if nothing says it."""
    _, _, text = chunks.get(b"tEXt", b"").partition(b"generatedBy\0")
    return text.partition(b"\0")[0].decode("latin-1")


def stated_transfer(chunks: Mapping[bytes, bytes]) -> Transfer | ColourSpace | None:
    """What the chunks of a PNG file say of its numbers: a transfer, another space of colours, or nothing.

    Where several chunks say something, ours goes first and then they have the order of the standard: `cICP`, `iCCP`,
    `sRGB`, `gAMA` with `cHRM`.

    Raises:
        ValueError: they say something that is not known; the text completes "FILE: ".
    """
    for transfer in get_args(Transfer):
        if KEYWORD + b"\0" + transfer.encode() in chunks.get(b"tEXt", b""):
            return transfer
    if len(chunks.get(b"cICP", b"")) == 4:
        return _by_codes(*chunks[b"cICP"][:2])
    if b"iCCP" in chunks:
        return _by_profile(chunks[b"iCCP"])
    if b"sRGB" in chunks:
        return "srgb"
    gamma = int.from_bytes(chunks.get(b"gAMA", b""), "big")
    if gamma <= 0:
        return None
    matrix = None
    if len(chunks.get(b"cHRM", b"")) == 32:
        x, y, *primaries = (number / 100_000 for number in struct.unpack(">8I", chunks[b"cHRM"]))
        matrix = to_rec_709((*primaries, x, y))
    if gamma == SRGB_GAMMA and matrix is None:
        return "srgb"
    curve = srgb_to_linear if gamma == SRGB_GAMMA else power(gamma / 100_000)
    return ColourSpace("by cHRM", curve, matrix)


def _by_codes(primaries: int, transfer: int) -> Transfer | ColourSpace:
    """What `cICP` says."""
    if primaries not in PRIMARIES or transfer not in CURVES:
        raise ValueError(
            f"says by cICP that its primaries are {primaries} and its transfer is {transfer} (ITU-T H.273), which are "
            "not read: convert the picture to sRGB, or say what its numbers are (--transfer)"
        )
    matrix, curve = to_rec_709(PRIMARIES[primaries]), CURVES[transfer]
    if matrix is None and curve is srgb_to_linear:
        return "srgb"
    return ColourSpace("by cICP", curve, matrix)


def _by_profile(content: bytes) -> Transfer | ColourSpace:
    """What `iCCP` says: a name, a zero, the method of compression, the profile."""
    try:
        # At most 16 MiB are unpacked: a small file must not fill the memory.
        profile = zlib.decompressobj().decompress(content.partition(b"\0")[2][1:], 16 << 20)
    except zlib.error:
        profile = b""
    return read_profile(profile) or "srgb"
