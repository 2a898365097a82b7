"""PNG files of 8 or 16 bits, and what they say of how their numbers were made from light.

The format is ISO/IEC 15948 (https://www.w3.org/TR/png-3). OpenImageIO reads the pixels. The chunks are read here, for
libraries fill rows that are missing, pass over wrong checksums, and do not tell all that is said of colours (11.3.2).
Of files that are written, a text of our own, which others pass over, tells the course's truncation from rounding.
"""

import json
import math
import struct
import zlib
from collections.abc import Mapping
from functools import cached_property
from typing import get_args

import numpy as np
from jaxtyping import ArrayLike

from .._version import __version__
from ..errors import PictureError
from ..util.files import StrPath, atomic_write, read_bytes
from ..util.numerics import real_numbers
from . import Bits, Transfer
from .icc import read_profile
from .picture_file import KEY, LibraryFile, PictureOrigin, to_json
from .transfer import (
    ENCODERS,
    LINEAR_SPACES,
    REC_709,
    Chromaticities,
    ColourSpace,
    Meaning,
    power_curve,
    srgb_to_linear,
    to_rec_709,
)

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""The first eight bytes of every PNG file."""

KEYWORD = b"raytrace-jax transfer"
SRGB_GAMMA = 45455
"""The number of `gAMA`, in 1/100000, that stands for sRGB to programs which do not know the chunk `sRGB`."""

CURVES = {1: srgb_to_linear, 4: power_curve(1 / 2.2), 5: power_curve(1 / 2.8), 8: power_curve(1.0), 13: srgb_to_linear}
"""Curves by their code in `cICP` (ITU-T H.273). BT.709's code (1) is read as sRGB, for which cameras write it."""

PRIMARIES: dict[int, Chromaticities] = {
    1: REC_709,
    2: REC_709,
    9: LINEAR_SPACES["lin_rec2020_scene"],
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: LINEAR_SPACES["lin_p3d65_scene"],
}
"""Primaries by their code in `cICP`; those that are not said (2) are taken for the usual ones."""

# The passes of an interlaced picture: first column, first row, step between columns, step between rows.
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def write_png(
    path: StrPath,
    rgb: ArrayLike | Mapping[str, ArrayLike],
    *,
    transfer: Transfer = "course",
    bits: Bits = 8,
    metadata: Mapping[str, object] | None = None,
) -> None:
    """Write an RGB picture; the file appears only when it is whole.

    Args:
        path: missing folders are made.
        rgb: "3 height width", scene-linear, top row first, clamped to [0, 1]; or channels, of which R, G and B count.
        transfer: `course` or `srgb`.
        bits: 8 or 16 a sample.
        metadata: how the picture was made, as for `write_exr`; a text of JSON in the file.

    Raises:
        PictureError: the shape is wrong, a colour is NaN or infinite, the transfer or the number of bits does
            not exist, the metadata is not JSON, the file cannot be written.
    """
    where = f"{path}: cannot be written"
    if transfer not in ENCODERS or bits not in get_args(Bits):
        wanted = f"the transfers {' and '.join(ENCODERS)}, with 8 and 16 bits"
        raise PictureError(f"{where}: there is no transfer {transfer!r} with {bits} bits; there are {wanted}")
    if isinstance(rgb, Mapping):
        if not {"R", "G", "B"} <= rgb.keys():
            raise PictureError(f"{where}: the channels R, G and B are wanted, not {', '.join(map(str, rgb))}")
        if len({np.shape(rgb[name]) for name in "RGB"}) > 1:
            shapes = ", ".join(f"{name} has {np.shape(rgb[name])}" for name in "RGB")
            raise PictureError(f"{where}: the channels are of one shape, (height, width), and {shapes}")
        rgb = np.ma.stack([rgb[name] for name in "RGB"])
    try:
        colours = real_numbers(rgb)
    except ValueError as reason:
        raise PictureError(f"{where}: the picture {reason}") from None
    if colours.ndim != 3 or colours.shape[0] != 3 or colours.size == 0:
        raise PictureError(f"{where}: its shape is {colours.shape}, and (3, height, width) is wanted")
    if not np.isfinite(colours).all():
        raise PictureError(f"{where}: {(~np.isfinite(colours)).sum()} of its numbers are NaN, infinite or masked")
    samples = np.moveaxis(ENCODERS[transfer](colours, bits=bits), 0, -1)
    height, width, _ = samples.shape
    rows = samples.reshape(height, -1).astype(f">u{bits // 8}", order="C").view(np.uint8)
    # The filter "up" (2): each row is stored as the difference from the one above.
    filtered = np.insert(np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1])), 0, 2, axis=1)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0))]
    chunks += [(b"sRGB", b"\0")] if transfer == "srgb" else []
    chunks += [(b"gAMA", struct.pack(">I", SRGB_GAMMA if transfer == "srgb" else 100_000))]
    chunks += [(b"tEXt", KEYWORD + b"\0" + transfer.encode())]
    chunks += [(b"tEXt", b"Software\0" + f"raytrace-jax {__version__}".encode())]
    chunks += [(b"iTXt", KEY.encode() + b"\0\0\0\0\0" + to_json(path, metadata).encode())] if metadata else []
    chunks += [(b"IDAT", zlib.compress(filtered.tobytes())), (b"IEND", b"")]
    with atomic_write(path, error=PictureError) as temporary:
        temporary.write_bytes(SIGNATURE + b"".join(png_chunk(*chunk) for chunk in chunks))


def png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


class PngFile(LibraryFile):
    """A PNG of any kind whose structure and checksums are right and whose pixels are all there."""

    format, suffixes, usual = "PNG", (".png",), "course"

    @cached_property
    def chunks(self) -> dict[bytes, bytes]:
        """The contents of the chunks by their kind; those of one kind are joined, and a zero ends each text."""
        data = read_bytes(self.path, error=PictureError)
        if not data.startswith(SIGNATURE):
            raise self.error("is empty" if not data else "is not a PNG file (its first bytes differ)")
        chunks: dict[bytes, bytearray] = {}
        position = len(SIGNATURE)
        while b"IEND" not in chunks:
            start, kind = position + 8, data[position + 4 : position + 8]
            end = start + int.from_bytes(data[position : position + 4])
            content, position = data[start:end], end + 4
            if position > len(data):
                raise self.error("is a truncated PNG file")
            if data[end:position] != zlib.crc32(kind + content).to_bytes(4):
                raise self.error(f"is a broken PNG file: the checksum of its {kind.decode('latin-1')!r} chunk is wrong")
            chunks.setdefault(kind, bytearray()).extend(content + b"\0" * (kind in (b"tEXt", b"iTXt")))
        if len(chunks.get(b"IHDR", b"")) != 13:
            raise self.error("is a broken PNG file: it has no header")
        return {kind: bytes(content) for kind, content in chunks.items()}

    def bits(self) -> int:
        return 16 if self.chunks[b"IHDR"][8] == 16 else 8

    def size(self) -> tuple[int, int]:
        return struct.unpack_from(">II", self.chunks[b"IHDR"])

    def stored(self) -> np.ndarray:
        """As of any file, if it is whole and of the full range; a warning tells of an animation: its first is read."""
        width, height, bits, colour_type, _, _, interlace = struct.unpack(">IIBBBBB", self.chunks[b"IHDR"])
        _ = self.spec  # A header that cannot be is refused, and a picture that does not fit into memory.
        samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour_type]  # Grey, RGB, palette, grey + alpha, RGB + alpha.
        size = sum(
            # The number of rows of the pass, each with its filter's number and its pixels in whole bytes.
            -((y - height) // y_step) * (1 + math.ceil(-((x - width) // x_step) * samples * bits / 8))
            for x, y, x_step, y_step in (_ADAM7 if interlace else ((0, 0, 1, 1),))
            if x < width and y < height
        )
        try:
            # What follows the pixels does not matter.
            rows = zlib.decompressobj().decompress(self.chunks.get(b"IDAT", b""), size)
        except zlib.error as cause:
            raise self.error("is a broken PNG file: its pixels cannot be decompressed") from cause
        if len(rows) != size:
            raise self.error("is a truncated PNG file: some of its pixels are missing")
        if self.bits() == 16 and b"tRNS" in self.chunks:
            raise self.error("makes one of its colours transparent, and an opaque picture is wanted")
        cicp = self.chunks.get(b"cICP")
        if cicp is not None and tuple(cicp[2:]) != (0, 1):
            wanted = "RGB of the full range, which end in 0, 1 (ITU-T H.273), are wanted: convert the picture to sRGB"
            raise self.error(f"says by cICP that its numbers are {tuple(cicp)}, and {wanted}")
        if b"acTL" in self.chunks:
            self.tell("is animated, and only its first picture is read.")
        return super().stored()

    def stated(self) -> Meaning:
        """What our own chunk says, else the first in the standard's order: `cICP`, `iCCP`, `sRGB`, `gAMA`, `cHRM`."""
        for transfer in get_args(Transfer):
            if KEYWORD + b"\0" + transfer.encode() in self.chunks.get(b"tEXt", b""):
                return transfer
        if len(self.chunks.get(b"cICP", b"")) == 4:
            primaries, code = self.chunks[b"cICP"][:2]
            if primaries not in PRIMARIES or code not in CURVES:
                said = f"says by cICP that its primaries are {primaries} and its transfer is {code} (ITU-T H.273)"
                raise ValueError(f"{said}, which are not read: convert it to sRGB, or say what it is (--transfer)")
            return _space("by cICP", CURVES[code], PRIMARIES[primaries])
        if b"iCCP" in self.chunks:
            # A name, a zero, the method of compression, the profile, of which at most 16 MiB are unpacked.
            try:
                profile = zlib.decompressobj().decompress(self.chunks[b"iCCP"].partition(b"\0")[2][1:], 16 << 20)
            except zlib.error:
                profile = b""
            return read_profile(profile) or "srgb"
        if b"sRGB" in self.chunks:
            return "srgb"
        gamma = int.from_bytes(self.chunks.get(b"gAMA", b""))
        if gamma <= 0:
            return None
        white_first = struct.unpack(">8I", self.chunks[b"cHRM"]) if len(self.chunks.get(b"cHRM", b"")) == 32 else ()
        primaries = tuple(number / 100_000 for number in (*white_first[2:], *white_first[:2])) or REC_709
        return _space("by cHRM", srgb_to_linear if gamma == SRGB_GAMMA else power_curve(gamma / 100_000), primaries)

    def origin(self) -> PictureOrigin:
        """What `write_png` was given as metadata, and what a text `generatedBy` says."""
        _, start, text = self.chunks.get(b"iTXt", b"").partition(KEY.encode() + b"\0\0\0\0\0")
        try:
            found, _ = json.JSONDecoder().raw_decode(text.decode(errors="replace")) if start else ({}, 0)
        except json.JSONDecodeError:
            found = {}
        _, _, maker = self.chunks.get(b"tEXt", b"").partition(b"generatedBy\0")
        return PictureOrigin(found if isinstance(found, dict) else {}, maker.partition(b"\0")[0].decode("latin-1"))


def _space(name: str, curve, primaries: Chromaticities) -> Transfer | ColourSpace:
    matrix = to_rec_709(primaries)
    return "srgb" if matrix is None and curve is srgb_to_linear else ColourSpace(name, curve, matrix)
