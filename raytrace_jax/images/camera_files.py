"""JPEG and TIFF files of cameras and scanners: how they lay out numbers, and which are raw files.

What is undone here is what OpenImageIO leaves, or what programs disagree on (TIFF 6.0, 3, 8 and 14).
"""

import contextlib
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL.ExifTags import Base

from ..util.files import StrPath, read_bytes
from . import Transfer
from .exif import BROKEN, directories, exif_of
from .icc import read_profile
from .picture_file import LibraryFile
from .transfer import REC_709, ColourSpace, Curve, Meaning, power_curve, srgb_to_linear, to_rec_709

RAW = "is a raw file of a camera: develop it (docs/photograph.md says how)"

RAW_STARTS = (
    b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FUJIFILMCCD-RAW", b"FOVb", b"\0MRM", b"II\x1a\0\0\0HEAPCCDR",
    b"II*\0\x10\0\0\0CR", b"II*\0\x08\0\0\0IIII", b"MM\0*\0\0\0\x08MMMM",
)  # fmt: skip
"""Raw files that are no plain TIFFs: of Olympus, Panasonic and Leica, Fujifilm, Sigma, Minolta, Canon and Phase One."""

RAW_SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".kdc", ".mef", ".mos", ".nef", ".nrw",
    ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw",
)  # fmt: skip

# Tags of TIFF/EP and DNG, and values of others, that only raw files have.
MOSAIC_OR_DNG = {33421, 33422, 50706}
RAW_PHOTOMETRIC, RAW_COMPRESSION = {32803, 34892}, {32767, 32769, 32770, 34713, 65000, 65535}
COLOURS = {8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*", 32844: "LogL", 32845: "LogLuv"}
"""Photometric interpretations that are not light or sRGB."""

MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]", re.DOTALL)
"""A marker of a JPEG that is followed by a length, or the end; others stand amid the picture's bits."""
START_OF_SCAN, END_OF_IMAGE, PROGRESSIVE_FRAMES = 0xDA, 0xD9, (0xC2, 0xC6, 0xCA, 0xCE)


class CameraFile(LibraryFile):
    """A JPEG or a TIFF, which says by an ICC profile what its numbers mean, or by EXIF that it does not say."""

    def stated(self) -> Meaning:
        """What the ICC profile says, else the tags that TIFF and EXIF share; None where neither says anything."""
        profile = self.spec.getattribute("ICCProfile")
        if profile is not None:
            return read_profile(np.asarray(profile, np.uint8).tobytes()) or "srgb"
        return _space(exif_of(self.path), power_curve(1.0) if self.bits() == 0 else srgb_to_linear)

    def light(self, transfer: Transfer | None = None) -> np.ndarray:
        light = super().light(transfer)
        # EXIF knows sRGB, which is 1, and `uncalibrated`.
        if self.spec.get_int_attribute("Exif:ColorSpace", 1) != 1 and not (transfer or CameraFile.stated(self)):
            self.tell("its EXIF says that its colours are not sRGB, and not what they are: they are read as sRGB.")
        return light


class JpegFile(CameraFile):
    """A JPEG: 8 bits, sRGB unless a profile says otherwise."""

    format, suffixes = "JPEG", (".jpg", ".jpeg", ".jpe")

    def stated(self) -> Transfer | ColourSpace:
        return super().stated() or "srgb"

    def stored(self) -> np.ndarray:
        """As of any file, if all of it is there: libraries fill what a progressive one lacks from what is there."""
        stored = super().stored()
        if lacks_scans(read_bytes(self.path)):
            raise self.error("is truncated: some of its picture is missing")
        return stored

    def weights(self) -> np.ndarray:
        """As of any file, without the faint traces that compression leaves around what was painted."""
        weights = super().weights()
        return np.where(weights < 1 / 16, 0.0, weights)


class TiffFile(CameraFile):
    """A TIFF of integers of any number of bits, scaled to the largest, or of floats; not a raw file."""

    format, suffixes = "TIFF", (".tif", ".tiff")

    def __init__(self, path: StrPath) -> None:
        super().__init__(path)
        if _is_raw(path):
            raise self.error(RAW)

    def stored(self) -> np.ndarray:
        """As of any file, with black at zero and scaled to the largest number exactly, if it can be read in one way."""
        stored, tags = super().stored(), next(directories(self.path))
        bits = int(np.max(tags.get(Base.BitsPerSample, 1)))
        colours = COLOURS.get(int(tags.get(Base.PhotometricInterpretation, 1)))
        if colours is not None:
            raise self.error(f"its colours are {colours}; RGB is wanted")
        if tags.get(Base.Predictor, 1) in (2, 3) and tags.get(Base.Compression, 1) == 1:
            raise self.error("has a predictor without compression, which programs read differently: save it without")
        levels, largest = np.ravel(tags.get(Base.ReferenceBlackWhite, ())).tolist(), 2**bits - 1
        if levels and levels not in ([0, largest] * 3, [0, largest, *(2 ** (bits - 1), largest) * 2]):
            raise self.error(f"has a ReferenceBlackWhite of {levels}; 0 and {largest} are wanted, the full range")
        is_white_zero = tags.get(Base.PhotometricInterpretation) == 0
        if stored.dtype.kind != "u":
            if is_white_zero:
                raise self.error("has floats of which white is zero, which are no light")
            return stored
        if bits < 16 and bits != 8:
            # Scaled by copying bits: in the code's own steps they are exact.
            codes = np.round(stored * (largest / np.iinfo(stored.dtype).max))
            stored = np.round(codes * (65535 / largest)).astype(np.uint16)
        # OpenImageIO turns numbers of which white is zero, but only up to 8 bits.
        return np.iinfo(stored.dtype).max - stored if is_white_zero and bits > 8 else stored


def _space(tags: Mapping[int, Any], usual: Curve) -> ColourSpace | None:
    """What the tags of TIFF 6.0 (20), which EXIF has too, say of primaries; None where it is nothing new.

    `usual` is the curve of the numbers. Raises ValueError where it cannot be; the text completes "FILE: ".
    """
    if Base.TransferFunction in tags:
        raise ValueError("has a TransferFunction, which is not read: convert it to sRGB or say --transfer srgb")
    try:
        kinds = (Base.WhitePoint, Base.PrimaryChromaticities)
        white, primaries = (np.ravel(tags.get(tag, ())).astype(float) for tag in kinds)
    except (TypeError, ValueError) as cause:
        raise ValueError("has a WhitePoint or PrimaryChromaticities that are no numbers") from cause
    matrix = to_rec_709((*(primaries if primaries.size else REC_709[:6]), *(white if white.size else REC_709[6:])))
    return None if matrix is None else ColourSpace("by PrimaryChromaticities", usual, matrix)


def _is_raw(path: StrPath) -> bool:
    """Whether a TIFF is a raw file, whose first picture may be a preview: by its name, or the tags of its pictures."""
    if Path(path).suffix.lower() in RAW_SUFFIXES:
        return True
    with warnings.catch_warnings(), contextlib.suppress(*BROKEN):
        warnings.simplefilter("ignore")  # What Pillow says of broken tags, of which OpenImageIO will speak.
        for number, tags in enumerate(directories(path)):
            is_raw = tags.get(Base.PhotometricInterpretation) in RAW_PHOTOMETRIC or not MOSAIC_OR_DNG.isdisjoint(tags)
            # A first picture that is a smaller copy (1) stands before the one that was taken.
            is_preview = number == 0 and tags.get(Base.NewSubfileType) == 1 and Base.SubIFDs in tags
            if is_raw or is_preview or tags.get(Base.Compression) in RAW_COMPRESSION:
                return True
    return False


def lacks_scans(data: bytes) -> bool:
    """Whether a progressive JPEG ends before all bits of all coefficients came (ISO/IEC 10918-1, B.2 and G.1.1)."""
    # For each component, by its number, and each coefficient: how many bits are left to come.
    left, components, position = np.full((256, 64), 16), [], 2
    while (found := MARKER.search(data, position)) is not None and (kind := found[0][1]) != END_OF_IMAGE:
        start = found.end() + 2
        position = start - 2 + max(2, int.from_bytes(data[start - 2 : start]))
        segment = data[start:position]
        if kind == START_OF_SCAN and segment and len(segment) >= 4 + 2 * segment[0]:
            first, last, bits = segment[1 + 2 * segment[0] :][:3]
            left[list(segment[1 : 1 + 2 * segment[0] : 2]), first : last + 1] = bits & 15
        elif kind in PROGRESSIVE_FRAMES:
            components = list(segment[6::3])
    return bool(left[components].any())
